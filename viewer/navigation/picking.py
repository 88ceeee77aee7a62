"""Which splat is under the cursor: the visible surface, found by the image model itself.

All splats that reach the pixel are composited front to back in float64, as `reference` does; the
surface is where half of the light is gone. A cheap bound, float32 over all splats, picks the few that
can reach the pixel, so that half a million splats take tens of milliseconds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import SceneEdits, bake, shown
from splatview.scene.lens import distort, distortion_jacobians
from splatview.scene.projection import project, sigmoid
from splatview.scene.reference import alphas

SURFACE = 0.5
"""Transmittance at which a pixel's surface is taken to lie."""

FAINTEST = 0.02
"""A pixel that lets more than 1 - this through shows no surface worth turning about."""

SAMPLES = 24
"""A side, of the rays at which a lens is looked at."""

SAMPLES_SLACK = 1.5
"""Between samples a lens may magnify more; a bound that is too wide costs a few splats more."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Pick:
    """The surface under a pixel."""

    index: int
    """Of the splat in the scene at which transmittance falls through `SURFACE`, or, in front of haze
    that never does, of the splat that adds most to the pixel."""
    depth: float
    """t.z of that splat's mean, world units."""
    point: np.ndarray
    """(3,) float64 world: on the ray through the pixel, at that depth."""


def pick(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings,
    x: float,
    y: float,
    *,
    edits: SceneEdits | None = None,
) -> Pick | None:
    """The surface at (x, y) px of the picture that `camera`, `settings` and `edits` make; None on
    background."""
    if edits is not None and edits.in_force:
        # Colours tell nothing here; without them a copy of the edited scene is a quarter of the size.
        plain = replace(gaussians, sh=gaussians.sh[:, :1], extras={})
        found = pick(bake(plain, edits), camera, replace(settings, sh_degree=None), x, y)
        kept = np.flatnonzero(shown(gaussians, edits))
        return None if found is None else replace(found, index=int(kept[found.index]))
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
    return Pick(
        index=int(candidates[footprints.indices[hit]]),
        depth=depth,
        point=camera.eye + camera.R_world_camera @ camera.points_at((x, y), depth),
    )


def may_reach(
    gaussians: Gaussians, camera: Camera, settings: RenderSettings, x: float, y: float
) -> np.ndarray:
    """Indices (C,) int64, ascending, of all splats that can reach (x, y) px, and few others.

    A footprint's half extent is at most reach·sqrt(|J|²·s² + blur) with s the largest scale,
    reach² = 2·ln(opacity / cut), and |J|² <= (f/z)²·(1 + u² + v²), u and v as the
    Jacobian has them (clamped to within the margin), times the most that a lens magnifies; with
    parallel rays |J| = f.
    """
    model = settings.model
    if not model.alpha_cut > 0:
        return np.arange(len(gaussians))
    focal = max(camera.fx, camera.fy) * _largest_magnification(camera, model.jacobian_margin)
    with np.errstate(all="ignore"):
        offsets = (gaussians.means - camera.eye).astype(np.float32)
        t = offsets @ camera.R_camera_world.T.astype(np.float32)
        z = t[:, 2]
        away = np.float32(1) if camera.orthographic else z
        u, v = t[:, 0] / away, t[:, 1] / away
        slant = np.float32(1)
        if not camera.orthographic:
            u_min, v_min, u_max, v_max = camera.slope_limits(model.jacobian_margin)
            slant = 1 + np.clip(u, u_min, u_max) ** 2 + np.clip(v, v_min, v_max) ** 2
        reach = np.sqrt(np.maximum(2 * np.log(sigmoid(gaussians.opacity_logits) / model.alpha_cut), 0))
        size = np.exp(gaussians.log_scales.max(axis=1)) * focal / away
        # 1 px and 1 % of slack for float32.
        radius = reach * np.sqrt(size * size * slant + model.blur) * np.float32(1.01) + 1
        hidden = z < model.near
        if camera.lens is not None:
            hidden |= u * u + v * v >= camera.lens.form.valid_radius_squared
            u, v = distort(np.stack([u, v], axis=1), camera.lens).T
        dx = u * np.float32(camera.fx) + np.float32(camera.cx - x)
        dy = v * np.float32(camera.fy) + np.float32(camera.cy - y)
        # Positive tests would drop a splat whose bound overflowed to NaN: here that means "maybe".
        hidden |= (np.abs(dx) > radius) | (np.abs(dy) > radius)
    return np.flatnonzero(~hidden)


def _largest_magnification(camera: Camera, margin: float | None) -> float:
    """How much larger than a pinhole's its Jacobian is anywhere that it is taken; inf where unknown."""
    if camera.lens is None:
        return 1.0
    if margin is None:
        return math.inf
    # By angle: even steps of the slope crowd where a fisheye has nothing.
    u_min, v_min, u_max, v_max = np.arctan(camera.slope_limits(margin))
    angles = np.meshgrid(np.linspace(u_min, u_max, SAMPLES), np.linspace(v_min, v_max, SAMPLES))
    rays = np.tan(np.stack(angles, axis=-1))
    return SAMPLES_SLACK * float(np.linalg.norm(distortion_jacobians(rays, camera.lens), axis=(-2, -1)).max())
