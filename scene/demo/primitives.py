"""Gradient noise of any dimension, and sums of it: what makes made things look grown."""

from __future__ import annotations

import itertools

import numpy as np

from splatview.scene.gaussians import Gaussians
from splatview.scene.sh import rgb_to_sh

GRADIENTS = 256
CHUNK = 8192
"""Points worked on at once: what a call touches stays in the cache."""

PRIMES = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
"""Odd multipliers that spread neighbouring lattice cells over the gradients, one an axis."""


def noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Gradient noise at `points` (N, 2 or 3), cells of side 1 -> (N,) float64, roughly in [-1, 1].

    Perlin 2002, with pseudo-random unit gradients.
    """
    gradients = np.random.default_rng(seed).normal(size=(points.shape[1], GRADIENTS))
    gradients /= np.linalg.norm(gradients, axis=0)
    total = np.empty(len(points))
    for start in range(0, len(points), CHUNK):
        chunk = slice(start, start + CHUNK)
        total[chunk] = _noise(np.ascontiguousarray(points[chunk].T), gradients)
    return total * 1.6


def _noise(points: np.ndarray, gradients: np.ndarray) -> np.ndarray:
    """Noise at points (D, N), with gradients (D, GRADIENTS)."""
    cells = np.floor(points)
    offsets = points - cells
    fades = offsets**3 * (offsets * (offsets * 6 - 15) + 10)
    hashes = [
        (cell * prime, (cell + 1) * prime)
        for cell, prime in zip(cells.astype(np.int64), PRIMES[: len(points)], strict=True)
    ]
    total = np.zeros(points.shape[1])
    for corner in itertools.product((0, 1), repeat=len(points)):
        mixed = hashes[0][corner[0]]
        for axis in range(1, len(points)):
            mixed = mixed ^ hashes[axis][corner[axis]]
        # The low bits of a product know only the low bits of the cell: fold the high ones in.
        which = ((mixed >> 15) ^ (mixed >> 7) ^ mixed) & (GRADIENTS - 1)
        weight, slope = 1.0, 0.0
        for axis, step in enumerate(corner):
            weight = weight * (fades[axis] if step else 1 - fades[axis])
            slope = slope + gradients[axis].take(which) * (offsets[axis] - step)
        total += weight * slope
    return total


def fbm(points: np.ndarray, seed: int, *, octaves: int = 4, gain: float = 0.5) -> np.ndarray:
    """Octaves of noise, each half as large and `gain` as strong -> (N,), roughly in [-1, 1]."""
    strengths = gain ** np.arange(octaves)
    layers = (strength * noise(points * 2.03**i, seed + i) for i, strength in enumerate(strengths))
    return np.sum(list(layers), axis=0) / strengths.sum()


def ridged(points: np.ndarray, seed: int, *, octaves: int = 5) -> np.ndarray:
    """Sharp crests with smooth valleys -> (N,) in about [0, 1]: mountains.

    Detail is weighted by the octave before it, so that crests are rough and valleys calm (Musgrave 1994).
    """
    total, weight, reach = np.zeros(len(points)), np.ones(len(points)), 0.0
    for i in range(octaves):
        strength = 0.5**i
        layer = np.clip(1 - np.abs(noise(points * 2.07**i, seed + i)), 0, 1) ** 2
        total += strength * layer * weight
        weight = np.clip(layer * 1.5, 0, 1)
        reach += strength
    return total / reach


def smoothstep(low: float, high: float, values: np.ndarray) -> np.ndarray:
    """0 below `low`, 1 above `high`, smooth between; `low` may be the larger."""
    t = np.clip((values - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def mix(a, b, share: np.ndarray) -> np.ndarray:
    """a·(1 - share) + b·share of colours: (3,) or (N, 3) each, share (N,) -> (N, 3)."""
    share = share[:, None]
    return np.asarray(a) * (1 - share) + np.asarray(b) * share


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
