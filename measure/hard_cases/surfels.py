"""Flat splats drawn as planar discs: from the side, from far, from within, and with axes of no length."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    FRONT,
    PLAIN,
    TURNED,
    HardCase,
    about_axis,
    among_neighbours,
    camera,
    splats,
)
from splatview.scene import Gaussians, ImageModel, RenderSettings

THEME = "discs"
DISCS = replace(PLAIN, model=ImageModel().with_footprint("disc"))
AHEAD = (0.05, 0.02, 2.0)

PARALLEL = replace(camera(focal=15.0, turn=12.0), orthographic=True)

SLOWLY = tuple(camera(turn=0.25 * step) for step in range(-3, 4))
"""Views a quarter of a degree apart, about a disc that is seen edge-on."""


case = partial(HardCase, theme=THEME, cameras=(FRONT, TURNED), settings={"discs": DISCS}, trains=False)


def one(scales, *, quat=(1.0, 0.0, 0.0, 0.0), mean=AHEAD, logit: float = 3.0, **more) -> Gaussians:
    return among_neighbours(splats([mean], scale=scales, quats=quat, logits=logit, **more))


def many(count: int = 60) -> Gaussians:
    """Discs of all sizes and directions, some about the eye."""
    rng = np.random.default_rng(12)
    scales = rng.normal(-1.5, 1.2, (count, 3))
    scales[:, 2] -= 8
    return splats(
        rng.uniform((-1.5, -1.0, -0.3), (1.5, 1.0, 4.0), (count, 3)),
        log_scales=scales,
        quats=rng.normal(size=(count, 4)),
        logits=rng.normal(1.0, 2.0, count),
        rgb=rng.uniform(0, 1, (count, 3)),
    )


def fan() -> Gaussians:
    """Seen from face-on to edge-on, two degrees apart."""
    angles = np.arange(0, 91, 2.0)
    means = [(0.9 * math.cos(2.4 * a), 0.6 * math.sin(2.4 * a), 2 + 0.03 * k) for k, a in enumerate(angles)]
    quats = [about_axis((0.3, 1, 0), angle) for angle in angles]
    return splats(means, scale=(0.3, 0.15, 0.0), quats=quats, logits=1.0)


def floor(height: float) -> Gaussians:
    """A plane below the eye, to a horizon."""
    return among_neighbours(splats([(0.0, height, 3.0)], scale=(50, 50, 0), quats=about_axis((1, 0, 0), 90)))


CASES = (
    case("discs of all kinds", "Some of them about the eye.", many, cameras=(FRONT, TURNED, PARALLEL)),
    case("disc facing the eye", "Its plane is met at the same depth everywhere.", lambda: one((0.4, 0.3, 0))),
    case("fan of discs", "Every slope from face-on to edge-on.", fan, cameras=(FRONT, TURNED, PARALLEL)),
    case(
        "disc edge-on, as a dot",
        "No ray meets its plane; one dot of a pixel is left.",
        lambda: one((0.3, 0.3, 0), quat=about_axis((0, 1, 0), 90), mean=(0.0, 0.0, 2.0), logit=5.0),
        cameras=(FRONT,),
        visible=(0,),
    ),
    case(
        "disc edge-on along a column",
        "Its plane goes through pixel centres: each ray in it meets it everywhere, or nowhere.",
        lambda: one((0.3, 0.3, 0), quat=about_axis((0, 1, 0), 90), mean=(0.0, 0.0, 2.0), logit=5.0),
        cameras=(camera(cx=20.5, cy=15.5), camera(cx=20.5, cy=15.5, focal=900.0)),
        visible=(0,),
    ),
    case(
        "disc that turns through edge-on",
        "The slope that its plane is met with changes sign.",
        lambda: one((0.6, 0.6, 0), quat=about_axis((0.1, 1, 0), 90), mean=(0.0, 0.0, 2.0)),
        cameras=SLOWLY,
        visible=(0,),
    ),
    case(
        "disc that parallel rays graze",
        "Slope 0 at every pixel at once.",
        lambda: one((0.6, 0.4, 0), quat=about_axis((0, 1, 0), 89.97), mean=(0.0, 0.0, 2.0)),
        cameras=tuple(replace(camera(focal=15.0, turn=0.03 * k), orthographic=True) for k in range(-2, 3)),
    ),
    case(
        "needle of a disc",
        "One axis a millionth of the other: a line that pixel centres miss.",
        lambda: one((1.0, 1e-6, 0), quat=about_axis((0, 0, 1), 33)),
        visible=(0,),
        visible_by=0.02,
    ),
    case(
        "needle of a disc along a row",
        "A line through pixel centres.",
        lambda: one((1.0, 1e-6, 0), mean=(0.0, 0.0, 2.0)),
        cameras=(camera(cx=20.5, cy=15.5),),
        visible=(0,),
    ),
    case(
        "disc without axes",
        "Two scales of 0, or three: a dot all the same.",
        lambda: among_neighbours(
            splats(
                [(0.1, 0, 2), (-0.3, 0.1, 2)], log_scales=[(-1, -np.inf, -np.inf), [-np.inf] * 3], logits=5
            )
        ),
        visible=(0, 1),
    ),
    case(
        "which axis is the normal",
        "Equal scales: the last axis is.",
        lambda: one((0.3, 0.3, 0.3), quat=about_axis((1, 2, 0.5), 50)),
        visible=(0,),
    ),
    case(
        "endless plane",
        "A disc of 1e13 world units, to its horizon.",
        lambda: one((math.exp(30), math.exp(30), 0), quat=about_axis((1, 0.2, 0), 80), mean=(0, 0.5, 3.0)),
        visible=(0,),
    ),
    case(
        "largest disc",
        "Scales just below what float32 holds.",
        lambda: among_neighbours(
            splats([(0, 0.5, 3.0)], log_scales=(88, 88, -30), quats=about_axis((1, 0.2, 0), 80))
        ),
        cameras=(FRONT, TURNED, PARALLEL),
        visible=(0,),
    ),
    case("disc beyond float32", "exp(100) is infinite.", lambda: one((math.inf, 1.0, 0)), culled=(0,)),
    case(
        "floor",
        "Its mean is in front, its edge behind the eye, its horizon in the picture.",
        lambda: floor(0.4),
        cameras=(FRONT, TURNED, camera(turn=170)),
    ),
    case("floor at the eye's height", "Seen from its side all over.", lambda: floor(1e-4), cameras=(FRONT,)),
    case(
        "disc through the near plane",
        "A part of it is nearer than that, in the middle of the picture.",
        lambda: one((0.6, 0.6, 0), quat=about_axis((1, 0, 0), 80), mean=(0, 0.05, 0.3)),
        settings={"near 1/8": replace(DISCS, model=replace(DISCS.model, near=0.125))},
        visible=(0,),
    ),
    case(
        "disc through the eye",
        "The eye is on its plane but for a hair.",
        lambda: one((2.0, 2.0, 0), quat=about_axis((1, 0.1, 0), 90), mean=(0.3, 1e-3, 0.5)),
        cameras=(FRONT, camera(eye=(0, -1e-3, 0)), camera(eye=(0, 0.02, 0))),
    ),
    case(
        "disc far beside the picture",
        "Its mean is 14,000 px away, its plane in the middle.",
        lambda: one((4.0, 4.0, 0), quat=about_axis((0, 1, 0), 75), mean=(5.0, 0.1, 0.0107)),
    ),
    case(
        "disc far away",
        "A hundred kilometres, seen through a telescope.",
        lambda: among_neighbours(
            splats([(3.0, 2.0, 1e5)], scale=(4.0, 2.0, 0), quats=about_axis((1, 2, 0), 60))
        ),
        cameras=(camera(focal=2e5), camera(focal=2e5, turn=0.002)),
        visible=(0,),
    ),
    case(
        "discs without blur",
        "The dot is a point: what is edge-on is gone.",
        fan,
        settings={"no blur": replace(DISCS, model=replace(DISCS.model, blur=0.0))},
        cameras=(FRONT, TURNED, PARALLEL),
    ),
    case(
        "discs without a cut",
        "Every disc reaches every pixel, but not from behind.",
        lambda: many(12),
        settings={"no cut": RenderSettings(model=replace(DISCS.model, alpha_cut=0.0))},
        cameras=(FRONT, TURNED, PARALLEL),
    ),
    case(
        "discs, antialiased",
        "A flag that says nothing of discs.",
        fan,
        settings={"antialiased": replace(DISCS, model=replace(DISCS.model, antialiased=True))},
    ),
    case(
        "disc invalid in every value",
        "NaN and infinity, where a normal is to be chosen.",
        lambda: among_neighbours(
            splats(
                [AHEAD] * 6,
                log_scales=[
                    (np.nan, 0, -9),
                    (0, np.nan, -9),
                    (0, -1, np.nan),
                    (np.inf, 0, -9),
                    (-1, -1, np.inf),
                    (0, 0, -9),
                ],
                quats=[(1.0, 0, 0, 0)] * 5 + [(0.0, 0, 0, 0)],
            )
        ),
        culled=(0, 1, 2, 3, 4, 5),
    ),
)
