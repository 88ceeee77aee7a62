"""Rays that are no pinhole's: lenses that fold back or have poles, edges of fisheyes, parallel rays."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import ONLY_PLAIN, HardCase, camera, neighbours, splats
from splatview.scene import Camera, Gaussians, Lens, concatenate

THEME = "rays"


def through(model: str, *parameters: float, focal: float = 15.0, turn: float = 0.0) -> Camera:
    return replace(camera(focal=focal, turn=turn), lens=Lens(model=model, parameters=parameters))


FOLDING = through("SIMPLE_RADIAL", -0.3)
"""r(1 - 0.3 r²) turns back at r = 1.054 and is 0 again at 1.826."""
POLE = through("FULL_OPENCV", 0.0, 0.0, 0.0, 0.0, 0.0, -0.25, 0.0, 0.0, focal=5.0)
"""1 / (1 - 0.25 r²) is infinite at r = 2."""
FISHEYE = through("OPENCV_FISHEYE", 0.02, -0.004, 0.0, 0.0, focal=11.0)
"""90 degrees from the axis are 18 px from the middle."""
SKEWED = through("THIN_PRISM_FISHEYE", 0.03, 0.01, 0.05, -0.04, 0.0, 0.01, 0.05, -0.04, focal=16.0, turn=7.0)
PARALLEL = replace(camera(focal=9.0), orthographic=True)
PARALLEL_TURNED = replace(camera(focal=9.0, eye=(0.7, -0.2, 0.1), turn=-9.0), orthographic=True)


def at_slopes(slopes: list[float], depth: float = 2.0, scale: float = 0.08) -> Gaussians:
    """One for each r of a ray, each in a direction of its own, before ordinary ones."""
    directions = np.array([(math.cos(0.3 * i), math.sin(0.3 * i)) for i in range(len(slopes))])
    means = np.column_stack([directions * np.array(slopes)[:, None], np.ones(len(slopes))]) * depth
    return concatenate([splats(means, scale=scale), neighbours()])


def at_angles(degrees: list[float]) -> Gaussians:
    """In one distance from the eye, at angles from the axis, each in another direction."""
    means = []
    for i, angle in enumerate(np.radians(degrees)):
        means.append(
            (2 * math.sin(angle) * math.cos(i), 2 * math.sin(angle) * math.sin(i), 2 * math.cos(angle))
        )
    return splats(means, scale=0.15, rgb=np.random.default_rng(2).uniform(size=(len(means), 3)))


def on_the_axis() -> Gaussians:
    """Exactly, and by less than float32 tells squares apart."""
    means = [(0, 0, 2), (1e-20, 0, 2.2), (0, -1e-9, 2.4), (1e-4, 1e-4, 2.6)]
    return splats(means, scale=(0.3, 0.05, 0.1), rgb=np.eye(4, 3), logits=0.0)


def needles_and_giants() -> Gaussians:
    means = [(0.8, 0.4, 1.5), (-1.0, 0.2, 1.5), (0.1, -0.6, 2.0), (2.5, 0.5, 2.0), (0, 0, 60.0)]
    scales = np.log(
        [(3.0, 1e-5, 1e-5), (1e-5, 0.5, 1e-5), (0.4, 0.4, 1e-8), (0.3, 0.3, 0.3), (30.0, 30.0, 30.0)]
    )
    quats = np.random.default_rng(3).normal(size=(5, 4))
    return splats(
        means, log_scales=scales, quats=quats, logits=0.5, rgb=np.random.default_rng(4).uniform(size=(5, 3))
    )


def near_and_far() -> Gaussians:
    """Before and behind the plane of the eye, and 10⁶ away: equally large."""
    means = [(-1, 0, 0.02), (-0.4, 0.2, 5.0), (0.4, 0.3, 1e6), (1, 0.2, -0.02), (1.2, 0.2, -3.0)]
    return splats(means, scale=0.2, rgb=np.random.default_rng(5).uniform(size=(5, 3)))


def along_the_rays() -> Gaussians:
    """Needles that are seen end on, discs that are seen edge on, and a giant around the eye."""
    scales = np.log([(1e-4, 1e-4, 5.0), (0.5, 1e-7, 0.5), (1e-6, 0.4, 0.4), (20.0, 20.0, 20.0)])
    means = [(0.2, 0.1, 6.0), (-0.5, -0.3, 2.0), (0.7, 0.4, 3.0), (0, 0, 5.0)]
    return splats(means, log_scales=scales, logits=1.0, rgb=np.eye(4, 3))


def case(name: str, what: str, build: Callable[[], Gaussians], *cameras: Camera, **options) -> HardCase:
    return HardCase(name, what, build, theme=THEME, cameras=cameras, **options)


CASES = (
    case(
        "a lens that folds back",
        "Beyond its reach a polynomial shows splats again inside the picture.",
        partial(at_slopes, [0.3, 0.9, 1.06, 1.3, 1.7, 1.826, 2.2, 40.0]),
        FOLDING,
        visible=(0, 1),
        culled=(2, 3, 4, 5, 6, 7),
    ),
    case(
        "just within a lens's reach",
        "The lens's derivative is all but 0 along the radius, and its inverse without bounds.",
        partial(at_slopes, [1.0, 1.04, 1.0535]),
        FOLDING,
        settings=ONLY_PLAIN,
        visible=(0, 1, 2),
    ),
    case(
        "the pole of a rational lens",
        "Beyond it the other side of the scene comes in, turned over.",
        partial(at_slopes, [0.5, 1.2, 2.001, 3.0, 50.0]),
        POLE,
        visible=(0, 1),
        culled=(2, 3, 4),
    ),
    case(
        "the edge of a fisheye",
        "Slopes of 57 and 570 are seen, what is beside the eye or behind it is not.",
        partial(at_angles, [60.0, 80.0, 89.0, 89.65, 89.96, 90.0, 95.0, 170.0]),
        FISHEYE,
        visible=(0, 1, 2, 3),
        culled=(4, 5, 6, 7),
    ),
    case(
        "on a fisheye's axis",
        "The angle divided by the radius, where both are 0.",
        on_the_axis,
        FISHEYE,
        SKEWED,
        visible=(0, 1, 2, 3),
    ),
    case(
        "needles and giants through a skewed lens",
        "Footprints that the lens turns and shears.",
        needles_and_giants,
        SKEWED,
        settings=ONLY_PLAIN,
        visible=(0, 4),
    ),
    case(
        "parallel rays near and far",
        "The near plane cuts, and depth changes no size.",
        near_and_far,
        PARALLEL,
        visible=(0, 1, 2),
        culled=(3, 4),
    ),
    case(
        "along parallel rays",
        "Needles end on, discs edge on, and the eye inside a giant.",
        along_the_rays,
        PARALLEL,
        PARALLEL_TURNED,
        settings=ONLY_PLAIN,
        visible=(1, 2, 3),
    ),
)
