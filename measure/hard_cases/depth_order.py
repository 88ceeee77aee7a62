"""Depth ties, coincident splats, and scenes of awkward counts."""

from __future__ import annotations

from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    FADED_FLOAT16,
    FRONT,
    ONLY_PLAIN,
    TURNED,
    HardCase,
    about_axis,
    camera,
    neighbours,
    splats,
)
from splatview.scene import Gaussians

THEME = "order and counts"


def tied(*, swapped: bool = False) -> Gaussians:
    """Two opaque splats in one place: the first in the file is in front."""
    pair = splats([(0, 0, 2), (0, 0, 2)], scale=0.4, logits=5.0, rgb=[(1, 0, 0), (0, 0, 1)])
    return pair.take(np.array([1, 0])) if swapped else pair


def wall_of_ties() -> Gaussians:
    """Overlapping splats of one depth, which every machine computes alike for an eye that looks along z."""
    rng = np.random.default_rng(6)
    means = np.concatenate([rng.uniform((-1, -0.7), (1, 0.7), (300, 2)), np.full((300, 1), 2.5)], axis=1)
    return splats(means, scale=0.25, logits=0.5, rgb=rng.uniform(0, 1, (300, 3)))


def coincident(count: int, logit: float) -> Gaussians:
    """One splat over and over, in many colours."""
    colours = np.random.default_rng(6).uniform(0, 1, (count, 3))
    return splats(np.tile((0.05, 0.02, 2.5), (count, 1)), scale=0.4, logits=logit, rgb=colours)


def close_in_depth() -> Gaussians:
    """Neighbours one float32 apart, in the file from back to front."""
    depths = [2.0]
    for _ in range(15):
        depths.append(float(np.nextafter(np.float32(depths[-1]), np.float32(3))))
    colours = np.random.default_rng(6).uniform(0, 1, (16, 3))
    return splats([(0, 0, z) for z in depths[::-1]], scale=0.4, logits=1.0, rgb=colours)


def depths_of_all_sizes() -> Gaussians:
    """From 0.02 to 10⁷: keys of few bits swap what is near (GaussianSplats3D issue 339)."""
    near = [(0, 0, 1.0 + 3e-5 * k) for k in range(12)][::-1]
    far = [(0, 0, 10.0**power) for power in range(1, 8)]
    colours = np.random.default_rng(2).uniform(0, 1, (20, 3))
    scales = np.concatenate([np.full(12, 0.2), 0.2 * 10.0 ** np.arange(1, 8), [0.003]])
    return splats([*near, *far, (0, 0, 0.02)], scale=scales, logits=0.5, rgb=colours)


def through_each_other() -> Gaussians:
    """Two discs that cross: the order is that of their middles, whichever is nearer at a pixel."""
    quats = [about_axis((0, 1, 0), 40), about_axis((0, 1, 0), -40)]
    means = [(0, 0, 2.5), (0, 0, 2.500001)]
    return splats(means, scale=(0.8, 0.5, 0.01), quats=quats, logits=4.0, rgb=[(1, 0, 0), (0, 1, 0)])


def sorted_backwards() -> Gaussians:
    many = neighbours(count=200, seed=3)
    return many.take(np.argsort(-many.means[:, 2]))


def one_in_view() -> Gaussians:
    many = neighbours(count=300, seed=4)
    many.means[:, 2] *= -1
    many.means[299] = 0.1, 0.1, 2.0
    many.opacity_logits[299] = 3.0
    return many


def none_in_view() -> Gaussians:
    many = neighbours(count=2000, seed=4)
    many.means[:, 2] *= -1
    return many


case = partial(HardCase, theme=THEME, cameras=(FRONT,), settings=ONLY_PLAIN)


def of_count(count: int, why: str, **statement) -> HardCase:
    title = {0: "no splat", 1: "one splat"}.get(count, f"{count} splats")
    return case(title, why, lambda: neighbours(count=count, seed=2), cameras=(FRONT, TURNED), **statement)


CASES = (
    case("depth tie", "Equal depths go by index.", tied, visible=(0,), visible_by=0.3),
    case(
        "depth tie, swapped",
        "... whatever their colours.",
        lambda: tied(swapped=True),
        visible=(0,),
        visible_by=0.3,
    ),
    case("wall of depth ties", "300 overlapping splats of one depth.", wall_of_ties),
    case(
        "2000 coincident splats",
        "Faint ones, one place: a long list in few tiles.",
        lambda: coincident(2000, -4.0),
        bound_float16=FADED_FLOAT16,
    ),
    case(
        "2000 opaque coincident splats",
        "The first few hide the others.",
        lambda: coincident(2000, 6.0),
        bound_float16=FADED_FLOAT16,
    ),
    case("depths one float32 apart", "16-bit keys cannot tell them.", close_in_depth),
    case("depths from 0.02 to 10⁷", "Keys by range lose the near ones.", depths_of_all_sizes),
    case("discs through each other", "Their middles decide.", through_each_other),
    case("sorted backwards in the file", "The last is in front.", sorted_backwards, most_excluded=4),
    of_count(0, "A picture of the background.", trains=False),
    of_count(1, "Nothing to sort.", visible=(0,)),
    of_count(255, "One less than a work group.", most_excluded=4),
    of_count(257, "One more than a work group.", most_excluded=4),
    of_count(1025, "One more than a block of the sort.", most_excluded=4, trains=False),
    case(
        "one splat in view of many",
        "All others are behind the eye (gsplat pull 100).",
        visible=(299,),
        build=one_in_view,
        cameras=(FRONT, camera(turn=5)),
    ),
    case(
        "all behind the eye",
        "Thousands of splats, none to draw.",
        none_in_view,
        culled=(0, 1, 2),
        trains=False,
    ),
)
