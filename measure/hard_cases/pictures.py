"""Odd pictures: sizes, principal points, fields of view, footprints on the edges of tiles."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    BOTH,
    FRONT,
    ONLY_PLAIN,
    PLAIN,
    HardCase,
    camera,
    neighbours,
    splats,
)
from splatview.measure.hard_cases.opacities import logit
from splatview.scene import TEXTBOOK, Camera, Gaussians, RenderSettings

THEME = "pictures"
BARE = {"textbook": RenderSettings(model=TEXTBOOK)}


def case(name: str, what: str, *cameras: Camera, build=None, settings=ONLY_PLAIN, **statement) -> HardCase:
    build = build or partial(neighbours, 1, count=30, seed=5)
    statement = {"most_excluded": 3, **statement}
    return HardCase(name, what, build, theme=THEME, cameras=cameras, settings=settings, **statement)


def at_pixels(pixels: list[tuple[float, float]], *, log_scale: float, opacity: float) -> Gaussians:
    """Splats whose means fall on these image points (px) of FRONT exactly: at a depth of its focal length."""
    means = [(x - FRONT.cx, y - FRONT.cy, FRONT.fx) for x, y in pixels]
    return splats(means, log_scales=(log_scale,) * 3, logits=logit(opacity), rgb=(1.0, 0.8, 0.6))


EDGES = [
    (15.5, 15.5),
    (16.5, 15.5),
    (15.5, 16.5),
    (16.5, 16.5),
    (31.5, 0.5),
    (32.5, 29.5),
    (0.5, 0.5),
    (39.5, 29.5),
]
"""Centres of the pixels on both sides of edges of tiles and picture."""

CORNERS = [(16.0, 16.0), (32.0, 16.0), (16.0, 0.0), (0.0, 16.0), (40.0, 30.0), (0.0, 0.0)]
"""Between pixels, where tiles meet or the picture ends."""

OUTSIDE = [(-0.6, 15.0), (40.6, 15.0), (20.0, -0.6), (20.0, 30.6), (-2.0, -2.0), (42.0, 32.0)]
"""Just beside the picture; their footprints reach in."""


def bars() -> Gaussians:
    """Long footprints along and across the edges of tiles."""
    means = [(x - FRONT.cx, y - FRONT.cy, FRONT.fx) for x, y in [(20.0, 16.0), (16.0, 15.0), (32.0, 15.0)]]
    scales = np.log([(12.0, 0.3, 0.3), (0.3, 12.0, 0.3), (0.3, 12.0, 0.3)])
    return splats(means, log_scales=scales, logits=1.0, rgb=[(1, 0, 0), (0, 1, 0), (0, 0, 1)])


TILED = partial(at_pixels, log_scale=-20.0, opacity=1.01 / 255)

CASES = (
    case("1x1 picture", "One pixel, one tile.", camera(1, 1, focal=2.0), trains=False),
    case("one row", "Higher than nothing by one.", camera(70, 1, cy=0.3), trains=False),
    case("one column", "Wider than nothing by one.", camera(1, 50, cx=0.3), trains=False),
    case("17x9 picture", "One column more than a tile.", camera(17, 9, focal=12.0), trains=False),
    case("16x16 picture", "Exactly one tile.", camera(16, 16, focal=12.0)),
    case("15x31 picture", "One less than tiles.", camera(15, 31, focal=14.0)),
    case("33x47 picture", "One more, and one less.", camera(33, 47)),
    case("1080 rows", "67.5 tiles: the last half tile is drawn.", camera(5, 1080, cy=1076.0), trains=False),
    case(
        "principal point in a corner",
        "The clamp's margins differ by side.",
        camera(cx=0.0, cy=30.0),
        settings=BOTH,
    ),
    case(
        "principal point outside",
        "A crop of a larger picture.",
        camera(cx=-25.0, cy=60.0, focal=50.0),
        camera(cx=70.0, cy=-20.0, focal=50.0),
        settings=BOTH,
    ),
    case("pixels that are not square", "fy is a third of fx.", camera(focal=60.0, aspect=1 / 3)),
    case(
        "field of view of 170°", "Tangents of 11 at the border.", camera(focal=20 / np.tan(np.radians(85.0)))
    ),
    case(
        "field of view of 179.9°",
        "Focal lengths of a fiftieth of a pixel.",
        camera(focal=20 / np.tan(np.radians(89.95))),
    ),
    case(
        "field of view of 0.01°",
        "Focal lengths of 200,000 px: giant footprints.",
        camera(focal=20 / np.tan(np.radians(0.005))),
    ),
    case(
        "centred beside edges of tiles",
        "Each shows at one pixel only (LichtFeld pull 1755).",
        FRONT,
        build=partial(TILED, EDGES),
        visible=tuple(range(len(EDGES))),
        visible_by=2e-3,
        most_excluded=0,
    ),
    case(
        "centred on edges of tiles",
        "A quarter in each of four tiles.",
        FRONT,
        settings=BOTH,
        build=partial(at_pixels, CORNERS, log_scale=0.0, opacity=0.8),
        visible=tuple(range(len(CORNERS))),
    ),
    case(
        "bars along edges of tiles",
        "Rows of tiles with a pixel of the footprint each.",
        FRONT,
        build=bars,
        settings=BOTH,
        visible=(0, 1, 2),
    ),
    case(
        "just outside the picture",
        "Means outside, footprints inside.",
        FRONT,
        build=partial(at_pixels, OUTSIDE, log_scale=0.5, opacity=0.9),
        visible=tuple(range(len(OUTSIDE))),
    ),
    case(
        "the textbook's model",
        "No blur, no cut, no cap: every splat at every pixel.",
        camera(24, 20, focal=20.0),
        settings=BARE,
        trains=False,
    ),
    case(
        "another near plane, cut and blur",
        "Nothing is built into the code.",
        FRONT,
        settings={
            "own model": replace(
                PLAIN, model=replace(PLAIN.model, near=2.9, alpha_cut=0.05, blur=1.0, max_alpha=0.7)
            )
        },
    ),
)
