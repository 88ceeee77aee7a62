"""Quaternions of every length, scales from nothing to beyond float32, needles and discs."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    ANTIALIASED,
    BOTH,
    FRONT,
    ONLY_PLAIN,
    TURNED,
    HardCase,
    about_axis,
    among_neighbours,
    camera,
    splats,
)
from splatview.scene import Gaussians, ImageModel, RenderSettings

THEME = "shapes"
LOG_MILLION = math.log(1e6)
AHEAD = (0.05, 0.02, 2.0)


def one(log_scales, *, quat=(1.0, 0.0, 0.0, 0.0), mean=AHEAD, logit: float = 3.0) -> Gaussians:
    return among_neighbours(splats([mean], log_scales=log_scales, quats=quat, logits=logit))


case = partial(HardCase, theme=THEME, cameras=(FRONT, TURNED))


def fan_of_needles() -> Gaussians:
    """Needles of 1:10⁶ at every angle, in the image and in depth."""
    angles = np.arange(0, 180, 7.5)
    quats = [about_axis((0.3 * math.sin(a), 0.5, 1.0), a) for a in angles]
    means = [(0.4 * math.cos(a), 0.4 * math.sin(a), 2 + 0.02 * k) for k, a in enumerate(angles)]
    return splats(means, log_scales=(0.5, 0.5 - LOG_MILLION, 0.5 - LOG_MILLION), quats=quats, logits=1.0)


def thin_diagonals() -> Gaussians:
    """One thin ellipse in each quadrant, each leaning its own way."""
    means = [(-0.5, -0.4, 2), (0.5, -0.4, 2), (-0.5, 0.4, 2), (0.5, 0.4, 2)]
    quats = [about_axis((0, 0, 1), angle) for angle in (30, 60, -30, -60)]
    return splats(means, scale=(0.35, 0.012, 0.012), quats=quats)


def dust() -> Gaussians:
    """Many splats far smaller than a pixel."""
    rng = np.random.default_rng(4)
    means = rng.uniform((-1.2, -0.9, 2), (1.2, 0.9, 3), (600, 3))
    return splats(
        means, log_scales=rng.uniform(-14, -9, (600, 3)), rgb=rng.uniform(0, 1, (600, 3)), logits=1.0
    )


def all_sizes() -> Gaussians:
    """One splat behind the other, each larger."""
    powers = np.arange(-20, 21, 4.0)
    means = [(0.1 * k - 0.5, 0.05 * k - 0.2, 2 + 0.1 * k) for k in range(len(powers))]
    return splats(means, log_scales=np.repeat(powers[:, None], 3, axis=1), logits=-0.5)


SLOWLY = tuple(camera(turn=0.25 * step) for step in range(-3, 4))
"""Views a quarter of a degree apart: what flickers differs from the reference in one of them."""
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


def rotated_case(name: str, what: str, *lengths: float, **statement) -> HardCase:
    return HardCase(
        name, what, partial(of_lengths, *lengths), theme="rotations", cameras=(FRONT, TURNED), **statement
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
    rotated_case("zero quaternion", "A rotation of all zeros has no direction.", 0.0, culled=(0,)),
    rotated_case("quaternion of -0", "Zeros with a sign are zeros.", -0.0, culled=(0,)),
    rotated_case("subnormal quaternion", "GPUs flush 1e-40 to 0, other machines do not.", 1e-40, culled=(0,)),
    rotated_case(
        "quaternion below the least", "Shorter than 1e-30 counts as zero everywhere.", 0.9e-30, culled=(0,)
    ),
    rotated_case(
        "quaternion above the least", "Its square underflows, its direction does not.", 1.2e-30, visible=(0,)
    ),
    rotated_case("tiny quaternion", "The square of 1e-25 is 0 in float32.", 1e-25, visible=(0,)),
    rotated_case("huge quaternion", "The square of 3e38 is infinite in float32.", 3e38, visible=(0,)),
    rotated_case(
        "quaternions of all lengths",
        "Files hold what training left, not unit quaternions.",
        *(10.0**power for power in (-29, -20, -10, -1, 1, 10, 20, 38)),
        visible=tuple(range(8)),
    ),
    rotated_case("negated quaternions", "q and -q are one rotation.", 1.0, -1.0, -7.0, visible=(0, 1, 2)),
    HardCase(
        name="half turns of any length",
        theme="rotations",
        what="Quaternions with a single component, from 2e-30 to 3e38.",
        build=one_component,
        cameras=(FRONT, TURNED),
        visible=(0, 1, 2),
    ),
    HardCase(
        name="huge and tiny in one quaternion",
        theme="rotations",
        what="Components 76 powers of ten apart.",
        build=extremes_in_one,
        cameras=(FRONT, TURNED),
        visible=(0, 1),
    ),
    case(
        "log-scale -30",
        "A point of 1e-13: the blur alone gives it a size.",
        lambda: one((-30, -30, -30)),
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "log-scale -30, antialiased",
        "Its opacity goes with its area: nothing is left.",
        lambda: one((-30, -30, -30)),
        settings={"antialiased": ANTIALIASED},
        culled=(0,),
    ),
    case(
        "log-scale -inf",
        "A size of exactly 0 is a valid point.",
        lambda: one((-np.inf, -np.inf, -np.inf)),
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "log-scale -inf, antialiased",
        "0 divided by a positive number, under a root.",
        lambda: one((-np.inf, -np.inf, -np.inf)),
        settings={"antialiased": ANTIALIASED},
        culled=(0,),
    ),
    case(
        "log-scale +30",
        "A splat of 1e13 world units is a flat wall.",
        lambda: one((30, 30, 30)),
        visible=(0,),
    ),
    case(
        "largest footprint",
        "A variance just below what float32 holds.",
        lambda: one((41, 41, 41)),
        visible=(0,),
    ),
    case(
        "largest footprint, from beside",
        "Its mean is 5e18 px beside the picture; boxes and squares of lengths leave float32's range.",
        lambda: one((41, 41, 41), mean=(-0.5 * math.exp(41), 0.02, 2.0)),
        cameras=(FRONT,),
        settings={**BOTH, "no cut": RenderSettings(model=ImageModel(alpha_cut=0.0))},
        visible=(0,),
    ),
    case(
        "footprint beyond float32",
        "Finite scales whose variance in px² is not.",
        lambda: one((44, 44, 44)),
        culled=(0,),
    ),
    case(
        "log-scale +88", "exp(88) is just finite, its square is not.", lambda: one((88, 88, 88)), culled=(0,)
    ),
    case("log-scale +100", "exp(100) is infinite in float32.", lambda: one((100, 0, 0)), culled=(0,)),
    case("scales from e-30 to e+30", "Both ends in one splat.", lambda: one((30, -30, 0)), visible=(0,)),
    case(
        "needle 1:10⁶",
        "The textbook's determinant loses every digit.",
        lambda: one((0, -LOG_MILLION, -LOG_MILLION), quat=about_axis((0, 0, 1), 33)),
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "needle 1:10⁶, antialiased",
        "The area that antialiasing compares is rounding, if computed badly.",
        lambda: one((0, -LOG_MILLION, -LOG_MILLION), quat=about_axis((0, 0, 1), 33)),
        settings={"antialiased": ANTIALIASED},
        culled=(0,),
    ),
    case(
        "needle towards the eye",
        "Seen from its end, through the Jacobian's cancelling terms.",
        lambda: one((0, -9, -9), quat=about_axis((0, 1, 0), 90.4), mean=(0.02, 0.01, 2.0)),
        cameras=SLOWLY,
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "needle through the eye's plane",
        "It reaches behind the eye; only its middle counts.",
        lambda: one((1.5, -7, -7), quat=about_axis((0.2, 1, 0), 60)),
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "needle of 10⁴ px",
        "Its quad leaves the image far behind on both sides.",
        lambda: one((6.0, -3.5, -8), quat=about_axis((0, 0, 1), 21)),
        visible=(0,),
    ),
    case(
        "fan of needles",
        "All angles: single splats explode at rare ones (UnityGaussianSplatting pull 14).",
        fan_of_needles,
        cameras=SLOWLY[::3],
        settings=ONLY_PLAIN,
    ),
    case(
        "thin diagonals",
        "A quad mirrored against its ellipse cuts it off (UntoldEngine pull 1207).",
        thin_diagonals,
        visible=(0, 1, 2, 3),
    ),
    case("disc face-on", "One scale is 0.", lambda: one((-1, -1, -np.inf)), visible=(0,)),
    case(
        "disc edge-on",
        "A disc without thickness, seen from its side.",
        lambda: one((-1, -1, -np.inf), quat=about_axis((0, 1, 0), 90), mean=(0.0, 0.0, 2.0)),
        cameras=(FRONT,),
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "disc that turns edge-on",
        "Its determinant goes through 0 as the view turns.",
        lambda: one((-0.5, -0.5, -30), quat=about_axis((0.1, 1, 0), 88.6), mean=(0.0, 0.0, 2.0)),
        cameras=SLOWLY,
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case(
        "line of two zero scales",
        "Its footprint has no area at all.",
        lambda: one((-1, -np.inf, -np.inf)),
        settings=ONLY_PLAIN,
        visible=(0,),
    ),
    case("dust", "600 splats below a hundredth of a pixel.", dust, settings=ONLY_PLAIN, most_excluded=12),
    case(
        "dust without blur",
        "Footprints below a thousandth of a pixel between the pixel centres.",
        dust,
        settings={"no blur": RenderSettings(model=ImageModel(blur=0.0))},
        most_excluded=12,
    ),
    case("all sizes", "From e-20 to e+20, one behind the other.", all_sizes, most_excluded=12),
)
