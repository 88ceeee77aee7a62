"""One number a splat, and how many splats have which: attributes of place, ranges, histograms."""

from __future__ import annotations

import math

import numpy as np

from .compiling import inline, kernel
from .pieces import in_pieces
from .places import Places, place


def column(places: Places, axis: int) -> np.ndarray:
    """(N,) float32: one coordinate of where splats are."""
    values = np.empty(len(places.means), np.float32)
    in_pieces(len(values), lambda start, stop: _column(start, stop, places, axis, values))
    return values


def distances(places: Places, point: tuple[float, float, float]) -> np.ndarray:
    """(N,) float32: from where splats are to `point`."""
    values = np.empty(len(places.means), np.float32)
    to = np.array(point, np.float64)
    in_pieces(len(values), lambda start, stop: _distances(start, stop, places, to, values))
    return values


@kernel
def _column(start, stop, places, axis, values):
    for i in range(start, stop):
        x, y, z = place(places, i)
        values[i] = x if axis == 0 else (y if axis == 1 else z)


@kernel
def _distances(start, stop, places, point, values):
    for i in range(start, stop):
        x, y, z = place(places, i)
        x, y, z = x - point[0], y - point[1], z - point[2]
        values[i] = math.sqrt(x * x + y * y + z * z)


@kernel
def within_range(start, stop, values, low, high, inside):
    """inside[start:stop]: low <= value <= high; NaN is not."""
    for i in range(start, stop):
        inside[i] = (low <= values[i]) & (values[i] <= high)


@kernel
def within_colour(start, stop, lab, seed, tolerance, inside):
    """inside[start:stop]: at most `tolerance` from `seed` (3,); NaN is not."""
    for i in range(start, stop):
        light, a, b = lab[i, 0] - seed[0], lab[i, 1] - seed[1], lab[i, 2] - seed[2]
        inside[i] = light * light + a * a + b * b <= tolerance * tolerance


@inline
def counts(value, log):
    """Whether a histogram can show it: finite, and positive on a logarithmic axis."""
    return (abs(value) < np.inf) & ((not log) | (value > 0))


@kernel
def value_span(values, mask, log):
    """Least and greatest of the values that count; (inf, -inf) if none does."""
    low, high = np.inf, -np.inf
    for i in range(len(values)):
        if mask[i] and counts(values[i], log):
            low, high = min(low, np.float64(values[i])), max(high, np.float64(values[i]))
    return low, high


@kernel
def fill_bins(values, mask, low, high, log, bins):
    """Adds to `bins` (B,) int64 how many values of `mask` are in each of B equal parts of low to high, of
    their logarithms if `log`; returns how many of the mask are in none."""
    number = len(bins)
    outside = 0
    base = np.log(low) if log else low
    span = (np.log(high) if log else high) - base
    scale = number / span if span > 0 else 0.0
    for i in range(len(values)):
        if not mask[i]:
            continue
        value = np.float64(values[i])
        if counts(value, log) & (low <= value) & (value <= high):
            place = ((np.log(value) if log else value) - base) * scale
            bins[min(max(int(place), 0), number - 1)] += 1
        else:
            outside += 1
    return outside
