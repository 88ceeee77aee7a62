"""Where a scene lies: what its positions are kept relative to, and how far it reaches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FAR_FROM_ORIGIN = 4.0
"""Positions are stored relative to a centre once it lies this many scene radii from the origin; nearer
scenes keep their float32 values to the bit."""

SAMPLE = 100_000
"""Splats that are looked at, at least, where there are so many."""


REST_OF_SIZE = 5e-4
"""A splat that float32 moves by more than this share of its longest axis, a standard deviation, is drawn
differently by up to 3e-4 of its alpha (the steepest slope of a Gaussian is 0.61 a deviation)..."""

WIDE_SHARE = 0.01
"""... and where so many are, positions keep what float32 leaves over. A few that training lost far away do
not make a scene wide."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Placement:
    centre: np.ndarray
    """(3,) float64, world units: what positions are relative to."""
    median: np.ndarray
    """(3,) float64: median of the finite means."""
    radius: float
    """World units: half the splats lie within it of `median`; for colour ranges, not for culling."""
    wide: bool
    """Whether the scene reaches so far that no one centre keeps its digits in float32."""

    def split(self, means: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """`means` (N, 3) relative to the centre in float32, and what that leaves over, also in float32."""
        return _split(means, self.centre)


def sample_step(count: int) -> int:
    """Every so-manieth splat is enough to place `count` of them."""
    return max(1, count // SAMPLE)


def _split(means: np.ndarray, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    with np.errstate(over="ignore", invalid="ignore"):
        exact = means.astype(np.float64) - centre
        high = exact.astype(np.float32)
        rest = (exact - high).astype(np.float32)
    # What is not finite is culled by its position.
    return high, np.where(np.isfinite(rest), rest, np.float32(0))


def _is_wide(means: np.ndarray, log_scales: np.ndarray, centre: np.ndarray) -> bool:
    _, rest = _split(means, centre)
    if not rest.any():
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(log_scales.astype(np.float64).max(axis=1))
        return bool((np.abs(rest).max(axis=1) > REST_OF_SIZE * sizes).mean() > WIDE_SHARE)


def placement_of(means: np.ndarray, log_scales: np.ndarray | None = None) -> Placement:
    """Of splats at `means` (N, 3); it is wide only where their `log_scales` (N, 3) say so."""
    with np.errstate(invalid="ignore", over="ignore"):
        sample = means[:: sample_step(len(means))].astype(np.float64)
        sample = sample[np.isfinite(sample).all(axis=1)]
        if not len(sample):
            return Placement(centre=np.zeros(3), median=np.zeros(3), radius=1.0, wide=False)
        median = np.median(sample, axis=0)
        radius = float(np.median(np.linalg.norm(sample - median, axis=1)))
    far = not np.abs(median).max() <= FAR_FROM_ORIGIN * radius
    # On a coarse grid of float32 numbers, what lies near the centre keeps its digits relative to it.
    step = 2.0 ** np.floor(np.log2(radius)) if 0 < radius < np.inf else 0.0
    centre = np.round(median / step) * step if step > 0 else median
    centre = centre if far else np.zeros(3)
    wide = False
    if log_scales is not None:
        some = slice(None, None, sample_step(len(means)))
        wide = _is_wide(means[some], log_scales[some], centre)
    return Placement(centre=centre, median=median, radius=radius or 1.0, wide=wide)
