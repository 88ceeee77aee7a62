"""The truth: the image model in float64, brute force. Slow on purpose, short enough to check by eye."""

from __future__ import annotations

import numpy as np

from splatview.scene.background import background_colours
from splatview.scene.camera import Camera
from splatview.scene.gaussians import Gaussians
from splatview.scene.image_model import RenderSettings
from splatview.scene.projection import Footprints, project
from splatview.scene.surfels import squared_distances

BLOCK = 16
"""Pixels are worked on in blocks of this side, only so that a block's alphas fit in memory."""

CHUNK = 4096
"""Splats evaluated at once in a block, likewise."""


def render(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    dtype: type[np.floating] = np.float64,
) -> np.ndarray:
    """The picture (H, W, 4) in `dtype`: RGB over the background, alpha = 1 - T. Image model: all steps."""
    settings = settings or RenderSettings()
    footprints = project(gaussians, camera, settings, dtype=dtype)
    image = np.empty((camera.height, camera.width, 4), dtype=dtype)
    behind = np.broadcast_to(
        background_colours(settings.background, camera, dtype), (camera.height, camera.width, 3)
    )
    for top in range(0, camera.height, BLOCK):
        for left in range(0, camera.width, BLOCK):
            block = image[top : top + BLOCK, left : left + BLOCK]
            x, y = np.meshgrid(
                np.arange(left, left + block.shape[1], dtype=dtype) + dtype(0.5),
                np.arange(top, top + block.shape[0], dtype=dtype) + dtype(0.5),
            )
            reaching = splats_reaching(footprints, x.min(), x.max(), y.min(), y.max())
            colour, transmittance = composite(footprints, reaching, x.ravel(), y.ravel(), settings)
            here = behind[top : top + BLOCK, left : left + BLOCK].reshape(-1, 3)
            colour += transmittance[:, None] * here
            block[..., :3] = colour.reshape(*block.shape[:2], 3)
            block[..., 3] = 1 - transmittance.reshape(block.shape[:2])
    return image


def splats_reaching(
    footprints: Footprints, x_min: float, x_max: float, y_min: float, y_max: float
) -> np.ndarray:
    """Splats whose boxes touch a block of pixel centres: indices (R,) into `footprints`, front to back."""
    (x, y), (rx, ry) = footprints.means2d.T, footprints.half_extents.T
    # A pixel of slack: the cut itself is made in `composite`, this only saves work.
    touches = (x + rx >= x_min - 1) & (x - rx <= x_max + 1) & (y + ry >= y_min - 1) & (y - ry <= y_max + 1)
    return np.flatnonzero(touches)


def alphas(footprints: Footprints, which: np.ndarray, x: np.ndarray, y: np.ndarray, settings: RenderSettings):
    """Alpha of splats `which` (R,) at pixel centres x, y (P,) px -> (R, P). Image model: step 4 or 4d."""
    dx = x - footprints.means2d[which, 0:1]
    dy = y - footprints.means2d[which, 1:2]
    if footprints.surfels is not None:
        q = squared_distances(footprints.surfels, which, np.stack([dx, dy], axis=-1), settings.model.blur)
    else:
        a, b, c = (footprints.conic_factors[which, i : i + 1] for i in range(3))
        # Far outside a tiny splat the square overflows to inf: exp gives the right 0.
        with np.errstate(over="ignore"):
            q = (a * dx + b * dy) ** 2 + (c * dy) ** 2
    # guard: cap of alpha := alpha = footprints.opacities[which, None] * np.exp(-q / 2)
    alpha = np.minimum(settings.model.max_alpha, footprints.opacities[which, None] * np.exp(-q / 2))
    return np.where(alpha >= settings.model.alpha_cut, alpha, 0)


def composite(
    footprints: Footprints, which: np.ndarray, x: np.ndarray, y: np.ndarray, settings: RenderSettings
) -> tuple[np.ndarray, np.ndarray]:
    """Colours (P, 3) and transmittances (P,) at x, y (P,) px. Image model: step 7 but the background."""
    colour = np.zeros((len(x), 3), dtype=x.dtype)
    transmittance = np.ones(len(x), dtype=x.dtype)
    for start in range(0, len(which), CHUNK):
        chunk = which[start : start + CHUNK]
        alpha = alphas(footprints, chunk, x, y, settings)
        after = transmittance * np.cumprod(1 - alpha, axis=0)
        before = np.vstack([transmittance[None], after[:-1]])
        colour += (alpha * before).T @ footprints.colours[chunk]
        transmittance = after[-1]
    return colour, transmittance
