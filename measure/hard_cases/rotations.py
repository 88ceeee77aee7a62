"""Quaternions of every length."""

from __future__ import annotations

from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import FRONT, TURNED, HardCase, about_axis, among_neighbours, splats
from splatview.scene import Gaussians

THEME = "rotations"
TURN = about_axis((0.2, 0.3, 1.0), 40.0)
LONG = (0.6, 0.06, 0.06)
"""Standard deviations that show which way a splat is turned."""


def of_lengths(*lengths: float) -> Gaussians:
    """A splat turned by TURN for each length of its quaternion, side by side in front of the others."""
    x = np.linspace(-0.6, 0.6, len(lengths)) if len(lengths) > 1 else np.zeros(1)
    means = np.stack([x, 0.4 * x, np.full_like(x, 2.0)], axis=1)
    with np.errstate(over="ignore"):
        quats = (TURN * np.array(lengths)[:, None]).astype(np.float32)
    return among_neighbours(splats(means, scale=LONG, quats=quats))


def case(name: str, what: str, *lengths: float, **statement) -> HardCase:
    return HardCase(
        name, what, partial(of_lengths, *lengths), theme=THEME, cameras=(FRONT, TURNED), **statement
    )


def one_component() -> Gaussians:
    """(0, 0, 0, q) turns by half a circle about z, whatever q."""
    quats = np.zeros((3, 4))
    quats[:, 3] = 2e-30, 1.0, -3e38
    means = [(-0.6, 0, 2), (0, 0.3, 2), (0.6, 0, 2)]
    return among_neighbours(splats(means, scale=(0.4, 0.1, 0.05), quats=quats))


def extremes_in_one() -> Gaussians:
    """Components of 1e38 beside ones of 1e-38: the small ones count for nothing."""
    quats = np.array([[1e38, 1e-38, 0, 1e-30], [1e-38, 1e-30, 3e38, 3e38]])
    return among_neighbours(splats([(-0.4, 0, 2), (0.4, 0, 2)], scale=LONG, quats=quats))


CASES = (
    case("zero quaternion", "A rotation of all zeros has no direction.", 0.0, culled=(0,)),
    case("quaternion of -0", "Zeros with a sign are zeros.", -0.0, culled=(0,)),
    case("subnormal quaternion", "GPUs flush 1e-40 to 0, other machines do not.", 1e-40, culled=(0,)),
    case("quaternion below the least", "Shorter than 1e-30 counts as zero everywhere.", 0.9e-30, culled=(0,)),
    case(
        "quaternion above the least", "Its square underflows, its direction does not.", 1.2e-30, visible=(0,)
    ),
    case("tiny quaternion", "The square of 1e-25 is 0 in float32.", 1e-25, visible=(0,)),
    case("huge quaternion", "The square of 3e38 is infinite in float32.", 3e38, visible=(0,)),
    case(
        "quaternions of all lengths",
        "Files hold what training left, not unit quaternions.",
        *(10.0**power for power in (-29, -20, -10, -1, 1, 10, 20, 38)),
        visible=tuple(range(8)),
    ),
    case("negated quaternions", "q and -q are one rotation.", 1.0, -1.0, -7.0, visible=(0, 1, 2)),
    HardCase(
        name="half turns of any length",
        theme=THEME,
        what="Quaternions with a single component, from 2e-30 to 3e38.",
        build=one_component,
        cameras=(FRONT, TURNED),
        visible=(0, 1, 2),
    ),
    HardCase(
        name="huge and tiny in one quaternion",
        theme=THEME,
        what="Components 76 powers of ten apart.",
        build=extremes_in_one,
        cameras=(FRONT, TURNED),
        visible=(0, 1),
    ),
)
