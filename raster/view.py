"""Camera and image model as the kernels take them: one flat tuple of float64 numbers."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..scene import Camera, RenderSettings

TILE = 16
"""Side of a tile in pixels."""

HALF_LOG2_E = 0.5 * math.log2(math.e)
"""exp(-q/2) = 2^(-q·HALF_LOG2_E)."""

NO_SHARE = -1e30
"""A logarithm of 0 for kernels that take all numbers to be finite."""


class View(NamedTuple):
    """Lengths in px or world units as the name says; what each does is told in `scene.image_model`."""

    rotation: np.ndarray
    """(3, 3) float64, world axes to camera axes."""
    eye: np.ndarray
    """(3,) float64, world."""
    fx: float
    fy: float
    cx: float
    cy: float
    min_u: float
    """Clamp of t.x/t.z in the Jacobian; -inf where there is none."""
    max_u: float
    min_v: float
    max_v: float
    width: int
    height: int
    near: float
    blur: float
    antialiased: bool
    alpha_cut: float
    """As the model has it; may be 0."""
    log2_cut: float
    """log2 of the cut that the kernels use: never below the smallest normal power of two."""
    log2_share: float
    """log2 of the share of its opacity below which a splat's alpha is 0; NO_SHARE where there is none."""
    max_alpha: float
    tiles_x: int
    tiles_y: int


def make_view(camera: Camera, settings: RenderSettings, dtype: np.dtype) -> View:
    """`dtype` is that of the pictures; it decides what a cut of 0 means (the smallest normal number)."""
    model = settings.model
    min_u, min_v, max_u, max_v = camera.slope_limits(model.jacobian_margin)
    smallest = float(np.finfo(dtype).minexp)
    return View(
        rotation=np.ascontiguousarray(camera.R_camera_world),
        eye=np.ascontiguousarray(camera.eye),
        fx=float(camera.fx),
        fy=float(camera.fy),
        cx=float(camera.cx),
        cy=float(camera.cy),
        min_u=min_u,
        max_u=max_u,
        min_v=min_v,
        max_v=max_v,
        width=int(camera.width),
        height=int(camera.height),
        near=float(model.near),
        blur=float(model.blur),
        antialiased=bool(model.antialiased),
        alpha_cut=float(model.alpha_cut),
        log2_cut=max(math.log2(model.alpha_cut), smallest) if model.alpha_cut > 0 else smallest,
        log2_share=NO_SHARE if settings.sigma_cut is None else -HALF_LOG2_E * settings.sigma_cut**2,
        max_alpha=float(model.max_alpha),
        tiles_x=-(-camera.width // TILE),
        tiles_y=-(-camera.height // TILE),
    )
