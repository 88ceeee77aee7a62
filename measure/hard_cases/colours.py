"""Spherical harmonics that leave the range of colours, or of numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import MappingProxyType

import numpy as np

from splatview.measure.hard_cases.case import (
    FRONT,
    ONLY_PLAIN,
    PLAIN,
    TURNED,
    HardCase,
    among_neighbours,
    camera,
    neighbours,
    splats,
)
from splatview.scene import Gaussians, RenderSettings

THEME = "colours"
AROUND = (FRONT, TURNED, camera(eye=(2.8, 0.0, 1.0), turn=-60.0))
DEGREES = MappingProxyType({f"SH {degree}": replace(PLAIN, sh_degree=degree) for degree in range(4)})
GLARE = MappingProxyType({"glaring background": RenderSettings(background=(2.0, -1.0, 0.5))})


def coloured(fill: Callable[[np.ndarray], None], *, degree: int = 3) -> Gaussians:
    """One splat whose coefficients `fill` writes into (K, 3), before the others."""
    special = splats([(0.0, 0.0, 2.0)], scale=0.4, degree=degree)
    fill(special.sh[0])
    return among_neighbours(special, degree=degree)


def constant(value: float) -> Callable[[np.ndarray], None]:
    def fill(sh: np.ndarray) -> None:
        sh[0] = value

    return fill


def everywhere(value: float) -> Callable[[np.ndarray], None]:
    def fill(sh: np.ndarray) -> None:
        sh[:] = value

    return fill


def coefficient(index: int, value: float) -> Callable[[np.ndarray], None]:
    def fill(sh: np.ndarray) -> None:
        sh[index, 1] = value

    return fill


def cancelling(sh: np.ndarray) -> None:
    """Bands that are huge and nearly cancel along +z, where the constant band is left."""
    sh[0] = 0.4
    sh[2], sh[6] = 1e4, -1e4


def mixed_signs(sh: np.ndarray) -> None:
    sh[0] = (-30.0, 30.0, 0.4)


def coloured_near() -> Gaussians:
    near = splats([(0.001, 0.0, 0.0101)], scale=0.001, degree=3)
    near.sh[0, 1:4] = 0.5
    return among_neighbours(near, degree=3)


def vivid() -> Gaussians:
    lively = neighbours(3, count=40, seed=9)
    lively.sh[:, 1:] *= 6
    return lively


case = partial(HardCase, theme=THEME, cameras=AROUND, settings=ONLY_PLAIN)

CASES = (
    case(
        "SH far below 0",
        "Black, and it covers what is behind.",
        lambda: coloured(constant(-1e4)),
        visible=(0,),
    ),
    case(
        "SH far above 1",
        "A colour of 300 is blended as it is.",
        lambda: coloured(constant(1e3)),
        visible=(0,),
    ),
    case(
        "SH of 1e6",
        "More than float16 holds: no infinity may come of it.",
        lambda: coloured(constant(1e6)),
        visible=(0,),
    ),
    case(
        "SH of 1e30",
        "Near the end of float32.",
        lambda: coloured(constant(1e30)),
        visible=(0,),
        # In float16 it is the largest number there is, of which what stands before it from the third camera
        # lets 0.657 through; a colour without end would still be more than can be told.
        bound_float16=1 - 0.657 + 4 / 255,
    ),
    case("SH of -1e30", "As black as -1.", lambda: coloured(constant(-1e30)), visible=(0,)),
    case(
        "SH sum beyond float32",
        "Finite coefficients, an infinite colour.",
        lambda: coloured(everywhere(3e38)),
        cameras=(FRONT,),
        culled=(0,),
    ),
    case(
        "SH that cancel",
        "Bands of 10⁴ that leave little.",
        lambda: coloured(cancelling),
        cameras=(FRONT,),
        visible=(0,),
    ),
    case(
        "SH of both signs",
        "Each channel is cut at 0 for itself.",
        lambda: coloured(mixed_signs),
        visible=(0,),
    ),
    case("vivid SH at every degree", "Strong bands, of which fewer are asked for.", vivid, settings=DEGREES),
    case(
        "NaN in a band that is not asked for",
        "What is not used does no harm.",
        lambda: coloured(coefficient(15, np.nan)),
        settings={f"SH {degree}": DEGREES[f"SH {degree}"] for degree in (0, 1, 2)},
        visible=(0,),
        trains=False,
    ),
    case(
        "NaN in the last coefficient",
        "... and does where it is.",
        lambda: coloured(coefficient(15, np.nan)),
        culled=(0,),
    ),
    case(
        "infinity in the first band",
        "The splat is left out, whichever way it is seen.",
        lambda: coloured(coefficient(2, -np.inf)),
        culled=(0,),
    ),
    case("background beyond 0 and 1", "Blended like any other number.", vivid, settings=GLARE),
    case(
        "splat at the eye's side",
        "Its direction comes from a tiny offset.",
        cameras=(FRONT,),
        build=coloured_near,
        visible=(0,),
    ),
)
