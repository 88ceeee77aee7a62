"""From points, directions and colours to Gaussians: discs that tile a surface, needles, soft balls."""

from __future__ import annotations

import numpy as np

from ..gaussians import Gaussians
from ..sh import rgb_to_sh

DISC_SIGMA = 0.60
"""Standard deviation of a disc in units of the spacing: smaller shows holes, larger blurs."""

DISC_THICKNESS = 0.08
"""A disc's third axis in units of its spacing: flat, but no sheet that vanishes edge-on."""


def discs(
    points: np.ndarray,
    normals: np.ndarray,
    spacing: np.ndarray,
    sh: np.ndarray,
    *,
    opacity: float | np.ndarray = 0.97,
    tangents: np.ndarray | None = None,
    stretch: float | np.ndarray = 1.0,
) -> Gaussians:
    """Flat splats in a surface: `points`, unit `normals` (N, 3), `spacing` (N,) world units.

    `sh` is (N, K, 3), or (N, 3) display colours. `stretch` lengthens the discs along `tangents` (N, 3),
    unit and at right angles to the normals.
    """
    sigma = DISC_SIGMA * spacing
    quats = turning_z_to(normals)
    if tangents is not None:
        quats = spun(quats, tangents)
    scales = np.stack([sigma * stretch, sigma, DISC_THICKNESS * spacing], axis=1)
    return pack(points, quats, scales, sh, opacity)


def needles(
    feet: np.ndarray,
    tips: np.ndarray,
    width: float | np.ndarray,
    sh: np.ndarray,
    *,
    opacity: float | np.ndarray = 0.9,
) -> Gaussians:
    """Thin splats from `feet` to `tips` (N, 3), `width` their thin standard deviations, world units."""
    along = tips - feet
    length = np.linalg.norm(along, axis=1)
    thin = np.broadcast_to(width, length.shape)
    # Two standard deviations reach the ends: there alpha has fallen to an eighth.
    scales = np.stack([thin, thin, length / 4], axis=1)
    return pack((feet + tips) / 2, turning_z_to(along / length[:, None]), scales, sh, opacity)


def balls(
    points: np.ndarray, scales: np.ndarray, sh: np.ndarray, *, opacity: float | np.ndarray
) -> Gaussians:
    """Axis-aligned splats with standard deviations `scales` (N, 3): mist, leaves far away."""
    quats = np.tile((1.0, 0.0, 0.0, 0.0), (len(points), 1))
    return pack(points, quats, scales, sh, opacity)


def pack(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    sh: np.ndarray,
    opacity: float | np.ndarray,
) -> Gaussians:
    """Gaussians from means, quats (wxyz), scales, opacity in (0, 1) and SH (N, K, 3) or RGB (N, 3)."""
    opacities = np.broadcast_to(opacity, len(means))
    coefficients = rgb_to_sh(sh)[:, None, :] if sh.ndim == 2 else sh
    return Gaussians(
        means=means.astype(np.float32),
        quats=quats.astype(np.float32),
        log_scales=np.log(scales).astype(np.float32),
        opacity_logits=np.log(opacities / (1 - opacities)).astype(np.float32),
        sh=coefficients.astype(np.float32),
    )


def turning_z_to(directions: np.ndarray) -> np.ndarray:
    """Quaternions (N, 4) wxyz of the shortest rotations from +z to unit `directions` (N, 3)."""
    x, y, z = directions.T
    quats = np.stack([1 + z, -y, x, np.zeros_like(x)], axis=1)
    quats[z < -1 + 1e-9] = (0, 1, 0, 0)
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def spun(quats: np.ndarray, tangents: np.ndarray) -> np.ndarray:
    """`quats` turned about their own z axes until their x axes are `tangents` (N, 3)."""
    w, x, y, z = quats.T
    x_axis = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    y_axis = np.stack([2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)], axis=1)
    angle = np.arctan2((tangents * y_axis).sum(1), (tangents * x_axis).sum(1))
    c, s = np.cos(angle / 2), np.sin(angle / 2)
    return np.stack([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s], axis=1)


def sunflower(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Ranks (N,) in (0, 1) and angles (N,): radius = sqrt(rank) fills a disc evenly (Vogel 1979).

    Any smooth, increasing radius of the rank gives even local spacing at the density it implies.
    """
    i = np.arange(count) + 0.5
    return i / max(count, 1), i * np.pi * (3 - np.sqrt(5))


def sphere_points(count: int) -> np.ndarray:
    """(N, 3) unit vectors, evenly spread (a sunflower wound round the sphere)."""
    rank, angle = sunflower(count)
    y = 1 - 2 * rank
    r = np.sqrt(1 - y * y)
    return np.stack([r * np.cos(angle), y, r * np.sin(angle)], axis=1)


def unit(vectors: np.ndarray) -> np.ndarray:
    """(..., 3) scaled to length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
