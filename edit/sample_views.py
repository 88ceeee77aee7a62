"""Views of a scene without cameras: an orbit around the shown splats."""

from __future__ import annotations

import math

import numpy as np

from splatview.edit.kernels.marks import positions_of
from splatview.scene import Camera, Gaussians, look_at
from splatview.scene.edits import SceneEdits, shown
from splatview.scene.framing import WORLD_UP, robust_bounds
from splatview.scene.image_model import NEAR

SIZE = 512
"""Width and height, px: a splat too small to show at this size hardly shows at any."""

FOV = 50.0
"""Field of view, degrees."""

LOWEST, HIGHEST = -5.0, 65.0
"""Range of the eyes' elevations, degrees above the horizon: few look at a scene from below."""

GOLDEN_TURN = math.pi * (3 - math.sqrt(5))
"""Angle from one eye to the next, radians: any number of them is spread evenly around the scene."""


def sample_cameras(
    gaussians: Gaussians, edits: SceneEdits, count: int = 16, *, size: int = SIZE
) -> list[Camera]:
    """`count` square views from around the bulk of the shown splats, with -y up.

    Every second one is from half the distance, where small things show. They look at a scene from outside: a
    room needs the cameras that it was made with.

    Raises:
        ValueError: `count` or `size` is below 1.
    """
    if not (count >= 1 and size >= 1):
        raise ValueError(f"count and size must be at least 1, got {count} and {size}")
    positions = positions_of(gaussians, edits)[shown(gaussians, edits)]
    centre, radius = robust_bounds(positions)
    distance = max(radius / math.sin(math.radians(FOV) / 2), radius + 2 * NEAR, 1e-9 * np.abs(centre).max())
    up = -np.array(WORLD_UP)[1]
    cameras = []
    for i in range(count):
        height = math.radians(LOWEST + (HIGHEST - LOWEST) * ((i * 0.6180339887498949 + 0.5) % 1))
        turn = i * GOLDEN_TURN
        offset = np.array(
            (math.cos(height) * math.sin(turn), -up * math.sin(height), -math.cos(height) * math.cos(turn))
        )
        eye = centre + offset * distance * (1.0 if i % 2 == 0 else 0.5)
        cameras.append(look_at(eye, centre, up=WORLD_UP, fov_y=FOV, width=size, height=size))
    return cameras
