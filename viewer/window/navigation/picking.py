"""Which splat is under the cursor: the visible surface, found by the image model itself.

All splats that reach the pixel are composited front to back in float64, as `reference` does; the
surface is where half of the light is gone. A cheap bound, float32 over all splats, picks the few that
can reach the pixel, so that half a million splats take tens of milliseconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....scene import Camera, Gaussians, RenderSettings
from ....scene.projection import project, sigmoid
from ....scene.reference import alphas

SURFACE = 0.5
"""Transmittance at which a pixel's surface is taken to lie."""

FAINTEST = 0.02
"""A pixel that lets more than 1 - this through shows no surface worth turning about."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Pick:
    """What is under a pixel."""

    index: int
    """Of the splat in the scene at which transmittance falls through `SURFACE`, or, in front of haze
    that never does, of the splat that adds most to the pixel."""
    depth: float
    """t.z of that splat's mean, world units."""
    point: np.ndarray
    """(3,) float64 world: on the ray through the pixel, at that depth."""


def pick(gaussians: Gaussians, camera: Camera, settings: RenderSettings, x: float, y: float) -> Pick | None:
    """The surface at (x, y) px of the picture that `camera` and `settings` make; None on background."""
    candidates = may_reach(gaussians, camera, settings, x, y)
    footprints = project(gaussians.take(candidates), camera, settings)
    if not len(footprints.indices):
        return None
    which = np.arange(len(footprints.indices))
    alpha = alphas(footprints, which, np.array([x]), np.array([y]), settings)[:, 0]
    after = np.cumprod(1 - alpha)
    if not after[-1] <= 1 - FAINTEST:
        return None
    if after[-1] <= SURFACE:
        hit = int(np.argmax(after <= SURFACE))
    else:
        hit = int(np.argmax(alpha * np.concatenate([[1.0], after[:-1]])))
    depth = float(footprints.depths[hit])
    ray = np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
    return Pick(
        index=int(candidates[footprints.indices[hit]]),
        depth=depth,
        point=camera.eye + depth * ray @ camera.R_camera_world,
    )


def may_reach(
    gaussians: Gaussians, camera: Camera, settings: RenderSettings, x: float, y: float
) -> np.ndarray:
    """Indices (C,) int64, ascending, of all splats that can reach (x, y) px, and few others.

    A footprint's half extent is at most reach·sqrt(|J|²·s² + blur) with s the largest scale,
    reach² = 2·ln(opacity / cut), and |J|² <= (f/z)²·(1 + u² + v²), u and v as the
    Jacobian has them (clamped to within the margin).
    """
    model = settings.model
    if not model.alpha_cut > 0:
        return np.arange(len(gaussians))
    focal = max(camera.fx, camera.fy)
    with np.errstate(all="ignore"):
        offsets = (gaussians.means - camera.eye).astype(np.float32)
        t = offsets @ camera.R_camera_world.T.astype(np.float32)
        z = t[:, 2]
        u, v = t[:, 0] / z, t[:, 1] / z
        if model.jacobian_margin is None:
            slant = 1 + u * u + v * v
        else:
            widest = [
                (max(abs(c), abs(size - c)) + model.jacobian_margin * size / 2) / f
                for c, size, f in (
                    (camera.cx, camera.width, camera.fx),
                    (camera.cy, camera.height, camera.fy),
                )
            ]
            slant = 1 + np.minimum(np.abs(u), widest[0]) ** 2 + np.minimum(np.abs(v), widest[1]) ** 2
        reach = np.sqrt(np.maximum(2 * np.log(sigmoid(gaussians.opacity_logits) / model.alpha_cut), 0))
        size = np.exp(gaussians.log_scales.max(axis=1)) * focal / z
        # 1 px and 1 % of slack for float32.
        radius = reach * np.sqrt(size * size * slant + model.blur) * np.float32(1.01) + 1
        dx = u * np.float32(camera.fx) + np.float32(camera.cx - x)
        dy = v * np.float32(camera.fy) + np.float32(camera.cy - y)
        # Positive tests would drop a splat whose bound overflowed to NaN: here that means "maybe".
        away = (z < model.near) | (np.abs(dx) > radius) | (np.abs(dy) > radius)
    return np.flatnonzero(~away)
