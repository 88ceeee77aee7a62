"""EWA projection of Gaussians to image footprints, in any float precision.

This is the readable version beside the fast ones (GLSL in `shaders/`, numba in `raster/`), and the
one that `reference` uses in float64.

Two forms keep float32 accurate where the textbook's do not, and the fast paths share them:

- det S' is not taken as S'xx·S'yy - S'xy², which loses every digit on a needle. With m0, m1 the rows
  of M (S' = M·Mᵀ + blur·I), det S' = |m0 x m1|² + blur·(|m0|² + |m1|²) + blur²: a sum of positives.
- The quadratic form is evaluated through the Cholesky factor of the conic, q = (a·dx + b·dy)² + (c·dy)²,
  a sum of squares, rather than as A·dx² + 2B·dx·dy + C·dy², whose terms cancel along a needle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.gaussians import Gaussians
from splatview.scene.image_model import MIN_QUAT_COMPONENT, RenderSettings
from splatview.scene.lens import distort, distortion_jacobians
from splatview.scene.sh import sh_colours
from splatview.scene.surfels import Surfels, check_surfels, project_surfels

FLOAT32_MAX = float(np.finfo(np.float32).max)


@dataclass(frozen=True, eq=False, kw_only=True)
class Footprints:
    """The V visible splats of a scene as the image sees them, sorted front to back."""

    indices: np.ndarray
    """(V,) int64: which splats of the scene, by depth, ties by index."""
    depths: np.ndarray
    """(V,) t.z of the means, world units."""
    means2d: np.ndarray
    """(V, 2) px."""
    covariances: np.ndarray
    """(V, 3) px²: S'xx, S'xy, S'yy, blur included. Of discs it is an ellipse around what is seen of them."""
    conic_factors: np.ndarray
    """(V, 3) 1/px: a, b, c with q = (a·dx + b·dy)² + (c·dy)² = dᵀ S'⁻¹ d."""
    opacities: np.ndarray
    """(V,) after the antialiasing factor."""
    colours: np.ndarray
    """(V, 3) RGB, at least 0."""
    half_extents: np.ndarray
    """(V, 2) px: beyond mean ± this, alpha is below the cut; inf where there is no cut."""
    surfels: Surfels | None = None
    """Where the image model has discs, what decides alpha; the conic is around it."""


def rotation_matrices(quats: np.ndarray) -> np.ndarray:
    """(N, 4) wxyz of any length but zero -> (N, 3, 3) in the same float dtype. Zero gives NaN."""
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        # By the largest component first: the squares of 1e-25 or 1e25 leave float32's range.
        # guard: largest component first := scaled = quats
        scaled = quats / np.abs(quats).max(axis=1, keepdims=True)
        w, x, y, z = (scaled / np.linalg.norm(scaled, axis=1, keepdims=True)).T
        return np.stack(
            [
                np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], axis=-1),
                np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], axis=-1),
                np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], axis=-1),
            ],
            axis=1,
        )


def covariances_3d(quats: np.ndarray, log_scales: np.ndarray) -> np.ndarray:
    """S = R·diag(s)²·Rᵀ: (N, 4) wxyz, (N, 3) -> (N, 3, 3), same float dtype (Kerbl et al. 2023, eq. 6)."""
    axes = rotation_matrices(quats) * np.exp(log_scales)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-x)) without overflow; ±inf give exactly 1 and 0."""
    with np.errstate(over="ignore"):
        decay = np.exp(-np.abs(logits))
    return np.where(logits >= 0, 1, decay) / (1 + decay)


def _finite(values: np.ndarray) -> np.ndarray:
    """(N, ...) -> (N,) bool: every value of the row is finite in float32."""
    with np.errstate(invalid="ignore"):
        flat = np.abs(values).reshape(len(values), math.prod(values.shape[1:]))
    return np.all(flat <= FLOAT32_MAX, axis=1)


def project(
    gaussians: Gaussians, camera: Camera, settings: RenderSettings, *, dtype: type[np.floating] = np.float64
) -> Footprints:
    """Projects a scene by the table in `image_model`, steps 1 to 3 or 2d and 3d, 5 and 6.

    `dtype` float64 defines truth; float32 shows what the same formulas lose in single precision.
    Positions are taken relative to the eye in float64 in both, as all renderers do, so that scenes far
    from the origin do not lose digits.

    Raises:
        InputError: the model has discs and the camera a lens.
    """
    model = settings.model
    check_surfels(camera, model)
    degree = min(gaussians.sh_degree, 3 if settings.sh_degree is None else settings.sh_degree)
    used_sh = gaussians.sh[:, : (degree + 1) ** 2]

    with np.errstate(over="ignore", invalid="ignore"):
        offsets = (gaussians.means.astype(np.float64) - camera.eye).astype(dtype)
        t = offsets @ camera.R_camera_world.T.astype(dtype)
        quats = gaussians.quats.astype(dtype)
        scales = np.exp(gaussians.log_scales.astype(dtype))
        opacities = sigmoid(gaussians.opacity_logits.astype(dtype))
        keep = t[:, 2] >= model.near  # guard: near plane := keep = t[:, 2] > -np.inf
        if camera.lens is not None:
            with np.errstate(divide="ignore"):
                # guard: fold of the lens := pass
                keep &= ((t[:, :2] / t[:, 2:]) ** 2).sum(axis=1) < camera.lens.form.valid_radius_squared
        keep &= np.abs(quats).max(axis=1) >= MIN_QUAT_COMPONENT  # guard: zero quaternions
        # guard: finite SH := for values in (offsets, t, quats, scales, opacities[:, None]):
        for values in (offsets, t, quats, scales, opacities[:, None], used_sh):
            keep &= _finite(values)
        keep &= opacities > 0 if model.alpha_cut == 0 else opacities >= model.alpha_cut

    indices = np.flatnonzero(keep)
    # guard: order of ties := indices = indices[np.argsort(t[indices, 2], kind="stable")[::-1]]
    indices = indices[np.argsort(t[indices, 2], kind="stable")]
    t, offsets, opacities = t[indices], offsets[indices], opacities[indices]

    surfels = None
    if model.footprint == "disc":
        axes = camera.R_camera_world.astype(dtype) @ rotation_matrices(quats[indices])
        with np.errstate(divide="ignore"):
            reach = 2 * np.log(opacities / model.alpha_cut)
        surfels, M = project_surfels(t, axes, scales[indices], reach, camera, model)
    else:
        axes_world = rotation_matrices(quats[indices]) * scales[indices][:, None, :]
        # Scales just within float32's range leave it here; what does is dropped below.
        with np.errstate(over="ignore", invalid="ignore"):
            M = projection_jacobians(t, camera, model.jacobian_margin) @ (
                camera.R_camera_world.astype(dtype) @ axes_world
            )
    covariances, det, det_unblurred, spread = footprint_covariances(M, model.blur)
    if model.antialiased and surfels is None:
        with np.errstate(invalid="ignore", divide="ignore"):
            opacities = opacities * np.sqrt(det_unblurred / det)

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        # Cholesky factor of the conic adj(S') / det: a² = S'yy/det, a·b = -S'xy/det, c² = 1/S'yy
        a = np.sqrt(covariances[:, 2] / det) / spread
        b = -covariances[:, 1] / covariances[:, 2] * a
        c = 1 / (np.sqrt(covariances[:, 2]) * spread)
        conic_factors = np.stack([a, b, c], axis=1)
        means2d = image_points(t, camera)
        real_covariances = covariances * (spread * spread)[:, None]
        if model.alpha_cut > 0:
            reach = 2 * np.log(opacities / model.alpha_cut)
            half_extents = np.sqrt(np.maximum(reach, 0)[:, None] * covariances[:, ::2]) * spread[:, None]
            drawn = reach >= 0
        else:
            half_extents = np.full((len(indices), 2), np.inf, dtype=dtype)
            drawn = opacities > 0
    drawn &= (det > 0) & _finite(conic_factors) & _finite(means2d)
    drawn &= _finite(real_covariances)  # guard: finite footprints

    directions = viewing_directions(offsets, camera)
    colours = sh_colours(used_sh[indices], directions, degree)
    drawn &= _finite(colours)  # guard: finite colours
    return Footprints(
        indices=indices[drawn],
        depths=t[drawn, 2],
        means2d=means2d[drawn].astype(dtype),
        covariances=real_covariances[drawn],
        conic_factors=conic_factors[drawn],
        opacities=opacities[drawn],
        colours=colours[drawn],
        half_extents=half_extents[drawn],
        surfels=None if surfels is None else surfels.take(drawn),
    )


def image_points(t: np.ndarray, camera: Camera) -> np.ndarray:
    """(N, 2) px: where camera-space points `t` (N, 3) are seen, float64 or float32 as they are."""
    flat = t[:, :2] if camera.orthographic else t[:, :2] / t[:, 2:]
    if camera.lens is not None:
        flat = distort(flat, camera.lens)
    return flat * (camera.fx, camera.fy) + (camera.cx, camera.cy)


def viewing_directions(offsets: np.ndarray, camera: Camera) -> np.ndarray:
    """(N, 3) unit, world axes: how the camera looks at points that are `offsets` (N, 3) from its eye."""
    if camera.orthographic:
        return np.broadcast_to(camera.forward.astype(offsets.dtype), offsets.shape)
    # By the largest component first: the squares of 1e20 leave float32's range.
    # guard: largest offset first := directions = offsets * 1.0
    directions = offsets / np.abs(offsets).max(axis=1, keepdims=True, initial=0)
    return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def projection_jacobians(t: np.ndarray, camera: Camera, margin: float | None) -> np.ndarray:
    """J (N, 2, 3) of the projection at camera-space points `t` (N, 3), in px per world unit.

    `margin` (image model, step 2) keeps the affine approximation tame beside the image. None: no clamp.
    """
    J = np.zeros((len(t), 2, 3), dtype=t.dtype)
    if camera.orthographic:
        J[:, 0, 0], J[:, 1, 1] = camera.fx, camera.fy
        return J
    x, y, z = t.T
    u_min, v_min, u_max, v_max = camera.slope_limits(margin)
    # guard: slope clamp := u, v = x / z, y / z
    u, v = np.clip(x / z, u_min, u_max), np.clip(y / z, v_min, v_max)
    if camera.lens is None:
        J[:, 0, 0] = camera.fx / z
        J[:, 0, 2] = -camera.fx * u / z
        J[:, 1, 1] = camera.fy / z
        J[:, 1, 2] = -camera.fy * v / z
        return J
    bent = distortion_jacobians(np.stack([u, v], axis=1), camera.lens)
    J[:, :, :2] = bent / z[:, None, None]
    J[:, :, 2] = -(bent @ np.stack([u, v], axis=1)[:, :, None])[:, :, 0] / z[:, None]
    return J * np.array([camera.fx, camera.fy], dtype=t.dtype)[:, None]


def footprint_covariances(
    M: np.ndarray, blur: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """S' = M·Mᵀ + blur·I of M (N, 2, 3) and its determinant without cancellation.

    All is in units of `spread`² px², spread = max(1, largest |entry| of M), so that float32 does not
    overflow on a splat of 10¹³ world units: returns covariances (N, 3) as xx, xy, yy; det S' (N,);
    det of M·Mᵀ alone (N,); spread (N,) px. Where M is not finite so are they.
    """
    spread = np.maximum(np.abs(M).reshape(len(M), -1).max(axis=1), 1) if len(M) else np.ones(0, M.dtype)
    with np.errstate(invalid="ignore"):
        m0, m1 = M[:, 0] / spread[:, None], M[:, 1] / spread[:, None]
    blur_scaled = (blur / spread / spread).astype(M.dtype)
    xx, xy, yy = (m0 * m0).sum(1), (m0 * m1).sum(1), (m1 * m1).sum(1)
    det_unblurred = (np.cross(m0, m1) ** 2).sum(1)
    det = det_unblurred + blur_scaled * (xx + yy) + blur_scaled * blur_scaled
    return np.stack([xx + blur_scaled, xy, yy + blur_scaled], axis=1), det, det_unblurred, spread
