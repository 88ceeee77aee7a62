"""The near plane, the eye among splats, and footprints that reach in from outside."""

from __future__ import annotations

from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
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

THEME = "near plane"
NEAR = 2.0**-7
"""A near plane that float32 and float64 hold alike: no rounding decides what is on it."""

AT_NEAR = {"plain": RenderSettings(background=(0.1, 0.2, 0.3), model=ImageModel(near=NEAR))}

case = partial(HardCase, theme=THEME, cameras=(FRONT,), settings=BOTH)


def at_depth(depth: float, *, scale: float = 0.002, logit: float = 3.0) -> Gaussians:
    return among_neighbours(splats([(0.0, 0.0, depth)], scale=scale, logits=logit))


def behind() -> Gaussians:
    """At, just behind and far behind the eye, large enough to fill the picture if mirrored."""
    depths = (0.0, -0.0, 1e-30, 1e-6, -1e-6, -0.05, -2.0, -1e6)
    return among_neighbours(splats([(0, 0, z) for z in depths], scale=1.0))


def giants() -> Gaussians:
    """Splats far larger than their distance, in all directions about the eye."""
    rng = np.random.default_rng(7)
    return splats(
        rng.normal(scale=0.6, size=(60, 3)),
        log_scales=rng.normal(0.5, 0.8, (60, 3)),
        quats=rng.normal(size=(60, 4)),
        logits=rng.normal(-2.0, 1.0, 60),
        rgb=rng.uniform(0, 1, (60, 3)),
    )


def inside_a_cloud() -> Gaussians:
    """Trained scenes have splats all around the eye, some within its near plane."""
    rng = np.random.default_rng(8)
    return splats(
        rng.normal(scale=0.15, size=(200, 3)),
        log_scales=rng.normal(-3.5, 0.7, (200, 3)),
        quats=rng.normal(size=(200, 4)),
        logits=rng.normal(0.0, 1.5, 200),
        rgb=rng.uniform(0, 1, (200, 3)),
    )


def stretched_at_the_border() -> Gaussians:
    """Long in depth, at the picture's border: they seem to turn as the view does (Resonite issue 4173)."""
    x = np.array([-2.2, -2.0, -1.2, 1.2, 2.0, 2.2])
    means = np.stack([x, 0.3 * x, np.full(6, 3.0)], axis=1)
    return splats(means, scale=(0.05, 0.05, 1.5), rgb=np.random.default_rng(2).uniform(0, 1, (6, 3)))


def beside(x: float, z: float, scale: float) -> Gaussians:
    return among_neighbours(splats([(x, 0.1, z)], scale=scale))


CASES = (
    case(
        "on the near plane",
        "t.z equals near: not behind it.",
        lambda: at_depth(NEAR),
        settings=AT_NEAR,
        visible=(0,),
    ),
    case(
        "just behind the near plane",
        "One float32 nearer.",
        settings=AT_NEAR,
        culled=(0,),
        build=lambda: at_depth(float(np.nextafter(np.float32(NEAR), np.float32(0)))),
    ),
    case(
        "just before the near plane",
        "One float32 farther.",
        settings=AT_NEAR,
        visible=(0,),
        build=lambda: at_depth(float(np.nextafter(np.float32(NEAR), np.float32(1)))),
    ),
    case(
        "at and behind the eye",
        "Division by a depth of 0, and mirror images.",
        behind,
        culled=tuple(range(8)),
    ),
    case(
        "eye inside a splat",
        "Its middle is a hair before the eye.",
        lambda: at_depth(0.02, scale=0.5),
        visible=(0,),
    ),
    case(
        "eye inside a splat behind it",
        "Its middle is a hair behind the eye.",
        lambda: at_depth(-0.02, scale=0.5),
        culled=(0,),
    ),
    case(
        "giants about the eye",
        "They pop up where the Jacobian is trusted too far (issue 196 of UnityGaussianSplatting).",
        giants,
        cameras=(FRONT, TURNED, camera(turn=120)),
        most_excluded=12,
    ),
    case(
        "giant at the near plane",
        "5 world units at a depth of 0.0101.",
        lambda: at_depth(0.0101, scale=5.0),
        visible=(0,),
    ),
    case(
        "cloud about the eye",
        "Splats on both sides of the near plane.",
        inside_a_cloud,
        cameras=(FRONT, camera(turn=75)),
        most_excluded=12,
    ),
    case(
        "mean far outside, footprint inside",
        "Only the clamp of the Jacobian makes it reach in.",
        lambda: beside(6.0, 3.0, 2.2),
        visible=(0,),
    ),
    case(
        "grazing splat",
        "t.x/t.z is 450: without the clamp it covers all.",
        lambda: beside(5.0, 0.011, 0.3),
        cameras=(FRONT, camera(turn=0.4)),
    ),
    case(
        "grazing splats, no clamp",
        "The bare model far beside the image.",
        lambda: beside(4.0, 2.0, 0.8),
        settings={"no clamp": RenderSettings(model=ImageModel(jacobian_margin=None))},
        visible=(0,),
    ),
    case(
        "clamp about an off-centre point",
        "The margins of both sides differ.",
        stretched_at_the_border,
        cameras=(camera(cx=3.0, cy=28.0), camera(cx=39.0, cy=2.0)),
        most_excluded=2,
    ),
    case(
        "stretched at the border",
        "Long in depth, at the picture's edge.",
        stretched_at_the_border,
        cameras=(FRONT, camera(turn=8), camera(turn=16)),
        most_excluded=2,
    ),
    case(
        "wall in front",
        "An opaque splat at 0.05 hides everything.",
        lambda: at_depth(0.05, scale=50.0, logit=20.0),
        visible=(0,),
    ),
    case(
        "tilted disc through the near plane",
        "Half of it is before the near plane.",
        settings=ONLY_PLAIN,
        build=lambda: among_neighbours(
            splats([(0, 0.1, 0.3)], scale=(0.6, 0.6, 0.001), quats=about_axis((1, 0, 0), 80))
        ),
        visible=(0,),
    ),
)
