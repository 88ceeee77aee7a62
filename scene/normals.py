"""Normals of splats: the shortest axis, facing the eye, and the scene coloured by them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.gaussians import Gaussians
from splatview.scene.image_model import Footprint
from splatview.scene.projection import rotation_matrices
from splatview.scene.sh import rgb_to_sh


def view_normals(gaussians: Gaussians, camera: Camera, footprint: Footprint = "ellipsoid") -> np.ndarray:
    """(N, 3) float64 unit, camera axes (right, down, forward): the axis of each splat's smallest scale, of
    discs their plane's, with the sign that faces the eye. NaN where the rotation is none."""
    R = rotation_matrices(gaussians.quats.astype(np.float64))
    with np.errstate(over="ignore", invalid="ignore"):
        shortest = np.exp(gaussians.log_scales).argmin(axis=1)
        if footprint == "disc":
            shortest[:] = 2
        normals = np.take_along_axis(R, shortest[:, None, None], axis=2)[..., 0] @ camera.R_camera_world.T
        t = (gaussians.means - camera.eye) @ camera.R_camera_world.T
        away = normals[:, 2] if camera.orthographic else (normals * t).sum(axis=1)
    return np.where(away[:, None] > 0, -normals, normals)


def normal_colours(normals: np.ndarray) -> np.ndarray:
    """(N, 3) camera axes -> (N, 3) RGB, 0 to 1: red to the right, green up, blue towards the eye."""
    return 0.5 + 0.5 * normals * (1.0, -1.0, -1.0)


def shaded_by_normals(gaussians: Gaussians, camera: Camera, footprint: Footprint = "ellipsoid") -> Gaussians:
    """The scene in the colours of its normals as `camera` sees them. Splats whose own colours are invalid
    stay so, and are culled."""
    colours = normal_colours(view_normals(gaussians, camera, footprint))
    invalid = ~np.isfinite(gaussians.sh).all(axis=(1, 2))
    sh = rgb_to_sh(colours)[:, None]
    sh[invalid] = np.nan
    return replace(gaussians, sh=sh.astype(np.float32))
