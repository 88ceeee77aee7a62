"""Which coefficients of spherical harmonics have to be stored and summed: those that are not zero.

Leaving out zeros changes no picture, not in its last bit, so nobody need be asked. What it saves depends on
the scene. Trained ones have hardly a zero: in `playbot` (500,000 splats, degree 2) and `skull` (94,936,
degree 3) every splat has its highest band, and so in scenes that this program has trained; in `train-1000`
96 % have it, and the rest the constant one alone. Bands that are not zero but together stay below half a
grey level are as rare: 1 % of playbot's splats, 0.1 % of what we trained, none of the others'. So a
threshold above zero, splat by splat, would save nothing there and cost exactness. What has many zeros is
what was merged or padded: a scene of degree 0 among others of degree 3, a file that a tool filled up.
"""

from __future__ import annotations

import numpy as np

from ..gaussians import SH_COEFFICIENTS

SLICE = 1 << 16
"""Splats looked at together, so that what is made of them stays in the caches."""

SAMPLE = 1 << 14
"""Splats by which it is decided whether to look at all of them."""

COEFFICIENT_BYTES = 12
"""Three colours in float32."""

PLACE_BYTES = 4
"""A splat, for where its coefficients begin and how many they are, where splats differ."""

LEAST_SAVING = 0.1
"""Of the bytes of harmonics, from which on each splat has its own degree: less would not repay the detour by
its place."""


def degree_in_use(sh: np.ndarray) -> int:
    """The lowest degree that shows `sh` (N, K, 3) unchanged: bands that are all zero do not count."""
    for degree in range(SH_COEFFICIENTS.index(sh.shape[1]), 0, -1):
        with np.errstate(invalid="ignore"):  # of NaN that signals
            used = sh[:, SH_COEFFICIENTS[degree - 1] :].any()
        if used:
            return degree
    return 0


def sh_degrees(sh: np.ndarray) -> np.ndarray:
    """(N, K, 3) -> (N,) uint8: the same, splat by splat. NaN is not zero."""
    degrees = np.zeros(len(sh), np.uint8)
    for start in range(0, len(sh), SLICE):
        part, found = sh[start : start + SLICE], degrees[start : start + SLICE]
        for degree in range(1, SH_COEFFICIENTS.index(sh.shape[1]) + 1):
            band = part[:, SH_COEFFICIENTS[degree - 1] : SH_COEFFICIENTS[degree]]
            found[(band != 0).any(axis=(1, 2))] = degree
    return degrees


def own_degrees(sh: np.ndarray) -> np.ndarray | None:
    """`sh_degrees` (N,) where it pays that each splat has its own; None where all, or nearly all, are alike.

    A sample decides whether to look further: of what pays too little anyway, a little may be missed.
    """
    sample = sh[:: max(1, len(sh) // SAMPLE)]
    if not pays(degree_counts(sh_degrees(sample))):
        return None
    degrees = sh_degrees(sh)
    return degrees if pays(degree_counts(degrees)) else None


def degree_counts(degrees: np.ndarray) -> np.ndarray:
    """(4,) int64: how many splats have each degree."""
    return np.bincount(degrees, minlength=len(SH_COEFFICIENTS))


def bytes_alike(counts: np.ndarray) -> int:
    """Of float32 coefficients where all splats have the highest degree of any."""
    highest = int(np.flatnonzero(counts).max(initial=0))
    return int(counts.sum()) * SH_COEFFICIENTS[highest] * COEFFICIENT_BYTES


def bytes_by_degree(counts: np.ndarray) -> int:
    """The same where each splat has its own, the places included."""
    coefficients = int((counts * np.array(SH_COEFFICIENTS)).sum())
    return coefficients * COEFFICIENT_BYTES + int(counts.sum()) * PLACE_BYTES


def pays(counts: np.ndarray) -> bool:
    """Whether splats should each have their own degree, counts (4,) having each."""
    return bytes_by_degree(counts) < (1 - LEAST_SAVING) * bytes_alike(counts)
