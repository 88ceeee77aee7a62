"""Kernels of attributes: coordinates, ranges, histograms, opacities, and display colours to Oklab."""

from __future__ import annotations

import math

import numpy as np

from splatview.edit.kernels.compiling import in_pieces, inline, kernel
from splatview.edit.kernels.marks import Places, place
from splatview.scene.edits import PALETTE_SHIFT
from splatview.scene.sh import SH_C0


def column(places: Places, axis: int) -> np.ndarray:
    """(N,) float32: one coordinate of the splats' positions."""
    values = np.empty(len(places.means), np.float32)
    in_pieces(len(values), lambda start, stop: _column(start, stop, places, axis, values))
    return values


def distances(places: Places, point: tuple[float, float, float]) -> np.ndarray:
    """(N,) float32: distances of the splats' positions to `point`."""
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
        lightness, a, b = lab[i, 0] - seed[0], lab[i, 1] - seed[1], lab[i, 2] - seed[2]
        inside[i] = lightness * lightness + a * a + b * b <= tolerance * tolerance


@inline
def counts(value, log):
    """Whether a histogram can show a value: finite, and positive on a logarithmic axis."""
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
    """Adds the number of values of `mask` in each of B equal parts of low to high, of their logarithms if
    `log`, to `bins` (B,) int64; returns the number of those in none."""
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


_ENTRIES = 4096


def _linear(encoded: np.ndarray) -> np.ndarray:
    """sRGB's transfer function (IEC 61966-2-1), [0, 1] to [0, 1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


LINEAR = np.append(_linear(np.linspace(0, 1, _ENTRIES + 1)), 1.0).astype(np.float32)
"""Interpolated between, it is within 1e-7 of the function."""


@inline
def linear(value, table):
    """Linear light of an encoded value clipped to [0, 1]; NaN stays NaN."""
    if value >= 1:
        return np.float32(1)
    if not value > 0:
        return value if np.isnan(value) else np.float32(0)
    place = value * np.float32(_ENTRIES)
    entry = int(place)
    return table[entry] + (place - np.float32(entry)) * (table[entry + 1] - table[entry])


TWO_THIRDS_OF_ONE = 709921077
"""Bits of a float32 are nearly its logarithm: a third of them, and two thirds of those of 1, are nearly the
bits of its cube root."""

SMALLEST = np.float32(1e-30)
"""Replacement for 0, whose cube root Halley's formula cannot find; its own is invisible."""


@inline
def cube_roots(values):
    """In place, of (M,) float32 from SMALLEST to about 1: a guess by its bits, then two steps of Halley's."""
    bits = values.view(np.int32)
    for i in range(len(values)):
        value = values[i]
        bits[i] = np.int32(bits[i] // np.int32(3)) + np.int32(TWO_THIRDS_OF_ONE)
        guess = values[i]
        for _ in range(2):
            cube = guess * guess * guess
            guess = guess * (cube + value + value) / (cube + cube + value)
        values[i] = guess


@inline
def mixed(a, b, c, x, y, z):
    """a·x + b·y + c·z in float32."""
    return np.float32(a) * x + np.float32(b) * y + np.float32(c) * z


@kernel
def oklab(start, stop, rgb, table, lab):
    """lab[start:stop] (N, 3) float32: Oklab (Ottosson 2020) of display colours rgb (N, 3) float32; NaN of
    NaN."""
    cones = np.empty((3, stop - start), np.float32)
    for i in range(start, stop):
        r, g, b = linear(rgb[i, 0], table), linear(rgb[i, 1], table), linear(rgb[i, 2], table)
        k = i - start
        cones[0, k] = max(mixed(0.4122214708, 0.5363325363, 0.0514459929, r, g, b), SMALLEST)
        cones[1, k] = max(mixed(0.2119034982, 0.6806995451, 0.1073969566, r, g, b), SMALLEST)
        cones[2, k] = max(mixed(0.0883024619, 0.2817188376, 0.6299787005, r, g, b), SMALLEST)
    for row in range(3):
        cube_roots(cones[row])
    for i in range(start, stop):
        long, medium, short = cones[0, i - start], cones[1, i - start], cones[2, i - start]
        if np.isnan(rgb[i, 0] + rgb[i, 1] + rgb[i, 2]):
            long = np.float32(np.nan)
        lab[i, 0] = mixed(0.2104542553, 0.7936177850, -0.0040720468, long, medium, short)
        lab[i, 1] = mixed(1.9779984951, -2.4285922050, 0.4505937099, long, medium, short)
        lab[i, 2] = mixed(0.0259040371, 0.7827717662, -0.8086757660, long, medium, short)


@kernel
def opacities(start, stop, logits, marks, maps, values):
    """values[start:stop] of logits (N,); maps (P, 4) float32: gain, offset, low, high by entry. NaN stays."""
    for i in range(start, stop):
        # Where exp overflows to infinity the quotient is the 0 that it should be.
        value = np.float32(1) / (np.float32(1) + np.exp(-logits[i]))
        entry = marks[i] >> PALETTE_SHIFT
        if entry > 0:
            value = maps[entry, 0] * value + maps[entry, 1]
            if not np.isnan(value):
                value = min(max(value, maps[entry, 2]), maps[entry, 3])
        values[i] = value


@kernel
def base_colours(start, stop, sh, marks, maps, rgb):
    """rgb[start:stop] (N, 3) of the constant band of sh (N, K, 3); maps (P, 3, 4) float32 by entry."""
    half = np.float32(0.5)
    for i in range(start, stop):
        r = np.float32(SH_C0) * sh[i, 0, 0] + half
        g = np.float32(SH_C0) * sh[i, 0, 1] + half
        b = np.float32(SH_C0) * sh[i, 0, 2] + half
        entry = marks[i] >> PALETTE_SHIFT
        if entry > 0:
            m = maps[entry]
            r, g, b = (
                m[0, 0] * r + m[0, 1] * g + m[0, 2] * b + m[0, 3],
                m[1, 0] * r + m[1, 1] * g + m[1, 2] * b + m[1, 3],
                m[2, 0] * r + m[2, 1] * g + m[2, 2] * b + m[2, 3],
            )
        rgb[i, 0], rgb[i, 1], rgb[i, 2] = r, g, b
