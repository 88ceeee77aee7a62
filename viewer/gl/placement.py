"""Where a scene lies: what its positions are kept relative to, and how far it reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FAR_FROM_ORIGIN = 4.0
"""Positions are stored relative to a centre once it lies this many scene radii from the origin; nearer
scenes keep their float32 values to the bit."""

SAMPLE = 100_000
"""Splats that are looked at, at least, where there are so many."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Placement:
    centre: np.ndarray
    """(3,) float64, world units: what positions are relative to."""
    median: np.ndarray
    """(3,) float64: median of the finite means."""
    radius: float
    """World units: half the splats lie within it of `median`; for colour ranges, not for culling."""


def sample_step(count: int) -> int:
    """Every so-manieth splat is enough to place `count` of them."""
    return max(1, count // SAMPLE)


def placement_of(means: np.ndarray) -> Placement:
    """Of splats at `means` (N, 3)."""
    with np.errstate(invalid="ignore", over="ignore"):
        sample = means[:: sample_step(len(means))].astype(np.float64)
        sample = sample[np.isfinite(sample).all(axis=1)]
        if not len(sample):
            return Placement(centre=np.zeros(3), median=np.zeros(3), radius=1.0)
        median = np.median(sample, axis=0)
        radius = float(np.median(np.linalg.norm(sample - median, axis=1)))
    far = not np.abs(median).max() <= FAR_FROM_ORIGIN * radius
    # On a coarse grid of float32 numbers, what lies near the centre keeps its digits relative to it.
    step = 2.0 ** np.floor(np.log2(radius)) if 0 < radius < np.inf else 0.0
    centre = np.round(median / step) * step if step > 0 else median
    return Placement(centre=centre if far else np.zeros(3), median=median, radius=radius or 1.0)
