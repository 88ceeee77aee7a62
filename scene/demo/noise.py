"""Gradient noise of any dimension, and sums of it: what makes made things look grown."""

from __future__ import annotations

import itertools

import numpy as np

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
    """Of points (D, N), with gradients (D, GRADIENTS)."""
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
