"""Opacity at its limits, alphas at the cut, and light that runs out."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    FADED_FLOAT16,
    FRONT,
    ONLY_PLAIN,
    PLAIN,
    HardCase,
    among_neighbours,
    camera,
    neighbours,
    splats,
)
from splatview.scene import Gaussians, RenderSettings
from splatview.scene.image_model import ALPHA_CUT

THEME = "opacities"
BRIGHT = {"bright background": RenderSettings(background=(1.0, 1.0, 1.0))}


def logit(opacity: float) -> float:
    return math.log(opacity / (1 - opacity))


def of_logit(*logits: float) -> Gaussians:
    means = [(0.3 * k, 0.1, 2.0 + 0.01 * k) for k in range(len(logits))]
    return among_neighbours(splats(means, scale=0.4, logits=logits))


def at_cut(factor: float) -> Gaussians:
    """A grid of faint splats, each centred on a pixel: their peaks are `factor` cuts high."""
    x, y = np.meshgrid(np.arange(2.5, 38, 5.0), np.arange(2.5, 28, 5.0))
    means = np.stack([(x.ravel() - 20) / 30 * 2, (y.ravel() - 15) / 30 * 2, np.full(x.size, 2.0)], axis=1)
    return splats(means, log_scales=(-6.0,) * 3, logits=logit(ALPHA_CUT * factor), rgb=(60.0, 60.0, 60.0))


def layers(count: int, opacity_logit: float, *, scale: float = 3.0) -> Gaussians:
    rng = np.random.default_rng(3)
    means = [(0, 0, 2 + 0.01 * k) for k in range(count)]
    return splats(means, scale=scale, logits=opacity_logit, rgb=rng.uniform(0, 1, (count, 3)))


def all_invisible() -> Gaussians:
    faint = neighbours()
    faint.opacity_logits[:] = -7.0
    return faint


case = partial(HardCase, theme=THEME, cameras=(FRONT,), settings=ONLY_PLAIN)

CASES = (
    case(
        "opacity logit +inf",
        "An opacity of exactly 1, capped at 0.99.",
        lambda: of_logit(np.inf),
        visible=(0,),
    ),
    case("opacity logit -inf", "An opacity of exactly 0.", lambda: of_logit(-np.inf), culled=(0,)),
    case("opacity logit +100", "exp(-100) beside 1.", lambda: of_logit(100.0), visible=(0,)),
    case(
        "opacity logit -100",
        "exp(100) overflows where the sigmoid is written badly.",
        lambda: of_logit(-100.0),
        culled=(0,),
    ),
    case(
        "opacity logits at exp's limits",
        "exp(88.7) is the last that float32 holds.",
        lambda: of_logit(88.7, -88.7, 3e38, -3e38),
        visible=(0, 2),
        culled=(1, 3),
    ),
    case(
        "opacity logit of -0 and subnormal",
        "Half opaque, all three.",
        lambda: of_logit(-0.0, 1e-40, -1e-40),
        visible=(0, 1, 2),
    ),
    case(
        "peaks just above the cut",
        "Each splat shows at one pixel only.",
        lambda: at_cut(1 + 1e-3),
        visible=(0,),
        visible_by=0.1,
    ),
    case(
        "peaks just below the cut",
        "None of them shows.",
        lambda: at_cut(1 - 1e-3),
        culled=tuple(range(48)),
        trains=False,
    ),
    case(
        "peaks on the cut",
        "Rounding decides, and nothing else may happen.",
        lambda: at_cut(1.0),
        most_excluded=48,
        trains=False,
    ),
    case("all invisible", "Nothing is left to draw.", all_invisible, culled=tuple(range(12)), trains=False),
    case(
        "capped alpha",
        "An opaque splat lets 1 % of the light through.",
        lambda: layers(1, 30.0),
        settings=BRIGHT,
        visible=(0,),
    ),
    case(
        "transmittance underflows",
        "0.01 to the power 300 is 0 in every precision.",
        lambda: layers(300, 30.0),
    ),
    case(
        "transmittance fades",
        "Thousands of faint layers: sums of many small numbers.",
        lambda: layers(2500, logit(1.5 * ALPHA_CUT)),
        settings=BRIGHT,
        bound_float16=FADED_FLOAT16,
    ),
    case(
        "opaque walls",
        "Light that is nearly gone must not come back.",
        lambda: layers(40, 2.0),
        settings=BRIGHT,
    ),
    case(
        "faint and bright",
        "Alphas of 1/200 with colours of 100.",
        lambda: splats(
            [(0.1 * k, 0, 2 + 0.1 * k) for k in range(8)],
            scale=0.5,
            logits=logit(1 / 200),
            rgb=(100.0, 50.0, 0.0),
        ),
        visible=(0,),
    ),
    case(
        "dark on bright",
        "A black splat takes light away.",
        lambda: splats([(0, 0, 2)], scale=0.4, logits=4.0, rgb=(0, 0, 0)),
        settings={**BRIGHT, "plain": PLAIN},
        visible=(0,),
    ),
    case(
        "one faint splat in a long picture",
        "Its footprint is a pixel, its tile one of many.",
        lambda: splats([(0, 0, 2)], log_scales=(-6.0,) * 3, logits=logit(0.3), rgb=(1.0, 1.0, 1.0)),
        cameras=(camera(130, 17, cx=70.5, cy=8.5),),
        visible=(0,),
    ),
)
