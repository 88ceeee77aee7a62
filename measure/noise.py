"""How far a measured ratio of times may be off by chance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

LEAST_PAIRS = 3
"""Fewer tell nothing of a scatter."""

LEAST_NOISE = 0.01
"""No one should read more into times of a shared machine."""


def noise_floor(ratios: Sequence[float], pairs: int | None = None) -> float:
    """Half width of the interval in which the median of so many equal pairs lies 19 times out of 20, as a
    share of the median.

    `pairs`: of how many pairs the median is; None: of `ratios`, which the scatter is taken from. The median
    of n ratios scatters 1.25 times as much as a mean: 1.96·1.25·sd/sqrt(n), sd from the quartiles so that
    one stall does not decide. Never below LEAST_NOISE. inf where there are too few pairs to tell.
    """
    pairs = len(ratios) if pairs is None else pairs
    if min(len(ratios), pairs) < LEAST_PAIRS:
        return math.inf
    low, middle, high = np.percentile(ratios, [25, 50, 75])
    deviation = (high - low) / 1.349 / middle
    return max(LEAST_NOISE, 1.96 * 1.2533 * deviation / math.sqrt(pairs))


def floor_of_self(ratios: Sequence[float]) -> float:
    """The noise floor by `ratios` of something to itself, which should be 1."""
    floor = noise_floor(ratios)
    return max(floor, abs(float(np.median(ratios)) - 1)) if ratios else floor


def noise_of(ratios: Sequence[float], selves: Sequence[float]) -> float:
    """How far the median of `ratios` may be off: by their own scatter, or by that of `selves`, ratios of the
    baseline to itself, for so many pairs, whichever is more: few pairs may be alike by chance."""
    return max(noise_floor(ratios), noise_floor(selves, len(ratios)), floor_of_self(selves))
