"""What depends on how a scene is looked at: the lens, the order, and whether anything has changed."""

from __future__ import annotations

import math

import numpy as np

from ..camera import Camera
from ..gaussians import Gaussians
from .effect import Effect, Saving

GRID = 17
"""Pixels along each side of a picture where it is looked how far a lens moves them."""

SORT_OPERATIONS = 4 * 3
"""A splat: four passes of a radix sort, each counting, adding up and moving."""


def sorting_effect(gaussians: Gaussians) -> Effect:
    n = len(gaussians)
    return Effect(
        name="sorting",
        on=n > 1,
        why=f"{n:,} splats; they are sorted anew only when camera, scene or settings change",
        saving=Saving(operations=n * SORT_OPERATIONS, bytes=8 * n),
        # One splat over another, each of any colour.
        bound=math.inf if n > 1 else 0.0,
    )


def redrawing_effect(camera: Camera | None, previous: Camera | None) -> Effect:
    """`previous`: the camera of the picture that is on the screen, of the same scene in the same state."""
    same = camera is not None and previous is not None and camera.same_view(previous)
    if camera is None:
        why = "a view that is at rest is neither projected, sorted nor drawn again"
    elif previous is None:
        why = "nothing has been drawn yet"
    else:
        why = "the camera has not moved" if same else "the camera has moved"
    return Effect(
        name="redrawing",
        on=camera is not None and not same,
        why=why,
        saving=Saving(what="the whole picture"),
        bound=math.inf if camera is not None and not same else 0.0,
    )


def lens_effect(camera: Camera | None) -> Effect:
    lens = None if camera is None else camera.lens
    if camera is None:
        why = "there is no camera yet: a pinhole"
    elif lens is None:
        why = "the camera is a pinhole" if not camera.orthographic else "the camera's rays are parallel"
    else:
        why = f"{lens.model}: it moves what is seen by up to {largest_displacement(camera):.3g} px"
    return Effect(
        name="lens distortion",
        on=lens is not None,
        why=why,
        saving=Saving(what="the lens's formula and its derivative, at every splat"),
        bound=math.inf if lens is not None else 0.0,
    )


def largest_displacement(camera: Camera) -> float:
    """How far the lens moves anything that the picture shows from where a pinhole has it, px."""
    x, y = np.meshgrid(np.linspace(0, camera.width, GRID), np.linspace(0, camera.height, GRID))
    pixels = np.stack([x, y], axis=-1)
    pinhole = camera.points_at(pixels, 1.0)[..., :2] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    moved = np.linalg.norm(pinhole - pixels, axis=-1)
    return float(moved[np.isfinite(moved)].max(initial=0.0))
