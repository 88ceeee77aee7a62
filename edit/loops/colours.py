"""Display colours to Oklab, where equal distances look equally different (Ottosson 2020)."""

from __future__ import annotations

import numpy as np

from .compiling import inline, kernel

_ENTRIES = 4096


def _linear(encoded: np.ndarray) -> np.ndarray:
    """sRGB's transfer function (IEC 61966-2-1), [0, 1] to [0, 1]."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


LINEAR = np.append(_linear(np.linspace(0, 1, _ENTRIES + 1)), 1.0).astype(np.float32)
"""Interpolated between, it is within 1e-7 of the function."""


@inline
def linear(value, table):
    """Light of an encoded value, cut to what a display can show; NaN stays NaN."""
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
"""Stands for 0, whose cube root Halley's formula cannot find; its own is invisible."""


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


@kernel
def oklab(start, stop, rgb, table, lab):
    """lab[start:stop] (N, 3) float32 of rgb (N, 3) float32. Where rgb is NaN, lab is."""
    cones = np.empty((3, stop - start), np.float32)
    for i in range(start, stop):
        r, g, b = linear(rgb[i, 0], table), linear(rgb[i, 1], table), linear(rgb[i, 2], table)
        cones[0, i - start] = max(
            np.float32(0.4122214708) * r + np.float32(0.5363325363) * g + np.float32(0.0514459929) * b,
            SMALLEST,
        )
        cones[1, i - start] = max(
            np.float32(0.2119034982) * r + np.float32(0.6806995451) * g + np.float32(0.1073969566) * b,
            SMALLEST,
        )
        cones[2, i - start] = max(
            np.float32(0.0883024619) * r + np.float32(0.2817188376) * g + np.float32(0.6299787005) * b,
            SMALLEST,
        )
    for row in range(3):
        cube_roots(cones[row])
    for i in range(start, stop):
        long, medium, short = cones[0, i - start], cones[1, i - start], cones[2, i - start]
        if np.isnan(rgb[i, 0] + rgb[i, 1] + rgb[i, 2]):
            long = np.float32(np.nan)
        lab[i, 0] = (
            np.float32(0.2104542553) * long
            + np.float32(0.7936177850) * medium
            - np.float32(0.0040720468) * short
        )
        lab[i, 1] = (
            np.float32(1.9779984951) * long
            - np.float32(2.4285922050) * medium
            + np.float32(0.4505937099) * short
        )
        lab[i, 2] = (
            np.float32(0.0259040371) * long
            + np.float32(0.7827717662) * medium
            - np.float32(0.8086757660) * short
        )
