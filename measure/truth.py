"""Whether a fast float64 picture may stand for the truth: compared with `scene.reference` in sampled blocks.

The reference takes minutes for a large picture of a large scene. A rasteriser in float64 that agrees with
it to the last digits in blocks drawn at random may stand in for it, and the agreement is stated.
"""

from __future__ import annotations

import numpy as np

from ..scene import Camera, Gaussians, RenderSettings
from ..scene.background import seen
from ..scene.projection import project
from ..scene.reference import composite, splats_reaching

SIDE = 8
"""px of a block's sides."""

AGREEMENT = 1e-6
"""Pictures farther apart than this are not the same truth; honest ones differ by some 1e-12, and by no
more than a cut's step where an alpha sits on it to the last digit."""


def disagreement(
    picture: np.ndarray,
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings,
    *,
    blocks: int = 24,
    seed: int = 0,
) -> float:
    """The largest difference of any number of `picture` (H, W, 4) float64 from the reference, in `blocks`
    blocks of SIDE² pixels chosen at random. NaN where either is."""
    footprints = project(gaussians, camera, settings, dtype=np.float64)
    shape = camera.height, camera.width, 3
    behind = np.broadcast_to(seen(settings.background, camera), shape)
    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(blocks):
        left = int(rng.integers(0, max(1, camera.width - SIDE + 1)))
        top = int(rng.integers(0, max(1, camera.height - SIDE + 1)))
        part = picture[top : top + SIDE, left : left + SIDE]
        x, y = np.meshgrid(
            np.arange(left, left + part.shape[1]) + 0.5, np.arange(top, top + part.shape[0]) + 0.5
        )
        reaching = splats_reaching(footprints, x.min(), x.max(), y.min(), y.max())
        colour, light = composite(footprints, reaching, x.ravel(), y.ravel(), settings)
        colour += light[:, None] * behind[top : top + SIDE, left : left + SIDE].reshape(-1, 3)
        true = np.concatenate([colour, 1 - light[:, None]], axis=1).reshape(part.shape)
        worst = float(np.maximum(worst, np.abs(part - true).max()))
    return worst
