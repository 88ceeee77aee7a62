"""Gradient noise of any dimension, and sums of it: what makes made things look grown."""

from __future__ import annotations

import itertools

import numpy as np

GRADIENTS = 256
PRIMES = (0x9E3779B1, 0x85EBCA77, 0xC2B2AE3D)
"""Odd multipliers that spread neighbouring lattice cells over the gradients, one an axis."""


def noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Gradient noise at `points` (N, 2 or 3), cells of side 1 -> (N,) float64, roughly in [-1, 1].

    Perlin 2002, with pseudo-random unit gradients.
    """
    dimensions = points.shape[1]
    gradients = np.random.default_rng(seed).normal(size=(GRADIENTS, dimensions))
    gradients /= np.linalg.norm(gradients, axis=1, keepdims=True)
    cells = np.floor(points)
    inside = points - cells
    fade = inside**3 * (inside * (inside * 6 - 15) + 10)
    cells = cells.astype(np.int64)
    total = np.zeros(len(points))
    for corner in itertools.product((0, 1), repeat=dimensions):
        mixed = np.zeros(len(points), dtype=np.int64)
        weight = np.ones(len(points))
        for axis, step in enumerate(corner):
            mixed ^= (cells[:, axis] + step) * PRIMES[axis]
            weight = weight * (fade[:, axis] if step else 1 - fade[:, axis])
        # The low bits of a product know only the low bits of the cell: fold the high ones in.
        gradient = gradients[((mixed >> 15) ^ (mixed >> 7) ^ mixed) % GRADIENTS]
        total += weight * np.einsum("nd,nd->n", gradient, inside - corner)
    return total * 1.6


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
