"""Views of a scene that came without cameras: an orbit about what is shown."""

from __future__ import annotations

import math

import numpy as np

from splatview.edit.kernels.marks import positions_of
from splatview.scene import Camera, Gaussians, look_at
from splatview.scene.edits import SceneEdits, shown
from splatview.scene.framing import WORLD_UP, robust_bounds
from splatview.scene.image_model import NEAR

SIZE = 512
"""Pixels a side: a splat too small to be seen at this size hardly shows at any."""

FOV = 50.0
"""Degrees."""

LOWEST, HIGHEST = -5.0, 65.0
"""Degrees above the horizon between which the eyes are: few look at a scene from below."""

GOLDEN_TURN = math.pi * (3 - math.sqrt(5))
"""Radians; after any number of such turns the eyes are spread evenly about the scene."""


def sample_cameras(
    gaussians: Gaussians, edits: SceneEdits, count: int = 16, *, size: int = SIZE
) -> list[Camera]:
    """`count` views, square, from around the bulk of the splats that are shown, with -y up.

    Every second one is from half as far, where small things show. They look at a scene from outside:
    for a room one should have the cameras that it was made with.

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
