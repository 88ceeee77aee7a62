"""The same view with other rays: in parallel, or through a lens."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .camera import Camera
from .lens import Lens, distort

ROOM = 10.0
"""Scene radii before the scene at which the eye of parallel rays stands at least: what is behind it is cut
off, and where it stands changes nothing else."""


def with_parallel_rays(camera: Camera, depth: float) -> Camera:
    """What lies `depth` (> 0, world units) ahead is as large as before; no lens."""
    return replace(camera, lens=None, orthographic=True, fx=camera.fx / depth, fy=camera.fy / depth)


def stepped_back(camera: Camera, centre: np.ndarray, radius: float) -> Camera:
    """An orthographic camera with room before its eye for all of a scene about `centre` (3,), world: the same
    picture, but that nothing of the scene is behind the eye."""
    depth = float((centre - camera.eye) @ camera.forward)
    back = max(ROOM * radius - depth, 0.0)
    matrix = camera.world_to_camera.copy()
    matrix[2, 3] += back
    return replace(camera, world_to_camera=matrix)


def through_lens(camera: Camera, lens: Lens) -> Camera:
    """Through the lens, with the focal length that keeps the vertical angle of view.

    Raises:
        ValueError: the lens does not see that far from its axis.
    """
    slope = camera.height / (2 * camera.fy)
    angle = math.degrees(2 * math.atan(slope))
    if not slope < lens.reach:
        raise ValueError(
            f"the lens {lens} sees at most {math.degrees(2 * math.atan(lens.reach)):.4g} degrees, "
            f"not the {angle:.4g} asked for"
        )
    factor = slope / float(distort(np.array([0.0, slope]), lens)[1])
    return replace(camera, lens=lens, fx=camera.fx * factor, fy=camera.fy * factor)
