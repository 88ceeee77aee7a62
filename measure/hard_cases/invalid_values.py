"""NaN and infinity in each attribute, component by component."""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    BOTH,
    FRONT,
    ONLY_PLAIN,
    TURNED,
    HardCase,
    among_neighbours,
    neighbours,
    splats,
)
from splatview.scene import Gaussians, concatenate

THEME = "invalid values"
PAYLOADS = (0x7FC00000, 0xFFC00000, 0x7F800001, 0xFFFFFFFF, 0x7FFFFFFF, 0x7FABCDEF)
"""NaN of both signs, quiet and signalling, as float32 bits."""


def healthy(count: int) -> Gaussians:
    """Large and opaque, before everything else: whoever draws them ruins the picture."""
    means = [(0.02 * k, 0.0, 1.5 + 0.01 * k) for k in range(count)]
    return splats(means, scale=0.8, logits=4.0, degree=1)


def with_slots(name: str, *values: float) -> Gaussians:
    """A splat for each component of an attribute and each value, which stands there."""
    size = int(np.prod(getattr(healthy(1), name).shape[1:], dtype=int))
    broken = healthy(size * len(values))
    array = getattr(broken, name).reshape(len(broken), -1)
    for row, (component, value) in enumerate(itertools.product(range(size), values)):
        array[row, component] = value
    return among_neighbours(broken, degree=1)


def slots(name: str, values: int) -> tuple[int, ...]:
    size = {"means": 3, "quats": 4, "log_scales": 3, "opacity_logits": 1, "sh": 12}[name]
    return tuple(range(size * values))


def payloads() -> Gaussians:
    """NaN of every kind in every attribute."""
    bits = np.array(PAYLOADS, np.uint32).view(np.float32)
    parts = []
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        broken = healthy(len(bits))
        getattr(broken, name).reshape(len(bits), -1)[:, 0] = bits
        parts.append(broken)
    return among_neighbours(*parts, degree=1)


def nothing_right() -> Gaussians:
    """Not one good number in the scene."""
    broken = neighbours(1)
    for array in (broken.means, broken.quats, broken.log_scales, broken.opacity_logits, broken.sh):
        array[:] = np.nan
    return broken


def crowd() -> Gaussians:
    """Many invalid splats between good ones: a compacted index is not the splat's own (LichtFeld pull
    2057)."""
    good = neighbours(1, count=120, seed=5)
    good.means[::2, 0] = np.nan
    good.quats[1::6] = 0
    return good


case = partial(HardCase, theme=THEME, cameras=(FRONT, TURNED), settings=ONLY_PLAIN)


def in_attribute(title: str, name: str, what: str, *values: float, **options) -> HardCase:
    return case(title, what, lambda: with_slots(name, *values), culled=slots(name, len(values)), **options)


INF, NAN = np.inf, np.nan

CASES = (
    in_attribute("NaN means", "means", "No place at all.", NAN, settings=BOTH),
    in_attribute("infinite means", "means", "In front, behind and beside.", INF, -INF),
    in_attribute("NaN quaternions", "quats", "One NaN spoils the whole rotation.", NAN, settings=BOTH),
    in_attribute("infinite quaternions", "quats", "Infinity by itself is no direction.", INF, -INF),
    in_attribute("NaN log-scales", "log_scales", "Even if the other two are good.", NAN, settings=BOTH),
    in_attribute("infinite log-scales", "log_scales", "exp(inf); -inf would be a valid 0.", INF),
    in_attribute(
        "NaN opacity logits", "opacity_logits", "Neither visible nor invisible.", NAN, settings=BOTH
    ),
    in_attribute("NaN SH", "sh", "A colour with one NaN, in any band.", NAN),
    in_attribute("infinite SH", "sh", "A colour with one infinity, in any band.", INF, -INF),
    case(
        "NaN of every kind", "Quiet, signalling, negative, with payloads.", payloads, culled=tuple(range(30))
    ),
    case(
        "nothing but NaN",
        "The picture is the background.",
        nothing_right,
        culled=tuple(range(12)),
        trains=False,
    ),
    case(
        "invalid splats between valid ones",
        "Two of three are left out: lists must stay aligned.",
        crowd,
        culled=(0, 1, 2, 4, 6, 7, 8, 10),
    ),
    case(
        "all kinds at once",
        "NaN before everything must not spread by blending.",
        culled=tuple(range(8)),
        build=lambda: concatenate(
            [
                with_slots("means", NAN).take(np.arange(3)),
                with_slots("opacity_logits", NAN).take(np.arange(1)),
                with_slots("quats", NAN).take(np.arange(4)),
                neighbours(1),
            ]
        ),
    ),
)
