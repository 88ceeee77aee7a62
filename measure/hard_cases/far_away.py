"""Scenes far from the origin, and scenes of other sizes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from splatview.measure.hard_cases.case import (
    BOTH,
    FRONT,
    ONLY_PLAIN,
    TURNED,
    HardCase,
    Same,
    among_neighbours,
    camera,
    neighbours,
    splats,
)
from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, concatenate

THEME = "far away"
SAME_AT_ORIGIN = 45.0
"""dB, at least, that a scene far away has against the same one at the origin."""


def shifted(build: Callable[[], Gaussians], shift: tuple[float, float, float], dtype: type) -> Gaussians:
    scene = build()
    return replace(scene, means=(scene.means.astype(np.float64) + shift).astype(dtype))


def moved(view: Camera, shift: tuple[float, float, float]) -> Camera:
    matrix = view.world_to_camera.copy()
    matrix[:3, 3] -= matrix[:3, :3] @ np.array(shift)
    return replace(view, world_to_camera=matrix)


ORDINARY = partial(neighbours, 1, count=40)

case = partial(HardCase, theme=THEME, cameras=(FRONT,), settings=ONLY_PLAIN)


def moved_case(
    name: str,
    what: str,
    shift: tuple[float, float, float],
    *,
    build: Callable[[], Gaussians] = ORDINARY,
    cameras: tuple[Camera, ...] = (FRONT, TURNED),
    dtype: type = np.float64,
    same: bool = True,
    **statement,
) -> HardCase:
    return case(
        name,
        what,
        partial(shifted, build, shift, dtype),
        cameras=tuple(moved(view, shift) for view in cameras),
        same=Same(build=build, cameras=cameras, psnr=SAME_AT_ORIGIN) if same else None,
        **{"most_excluded": 3, **statement},
    )


def on_whole_numbers() -> Gaussians:
    """Means that are whole numbers stay so at 10⁷ in float32."""
    rng = np.random.default_rng(5)
    return splats(
        np.round(rng.uniform((-12, -9, 20), (12, 9, 30), (60, 3))),
        log_scales=rng.normal(0.3, 0.4, (60, 3)),
        quats=rng.normal(size=(60, 4)),
        rgb=rng.uniform(0, 1, (60, 3)),
        logits=0.5,
    )


def smooth_gradient() -> Gaussians:
    """Large faint splats in a row: steps of position would show as bands."""
    x = np.linspace(-1.5, 1.5, 60)
    means = np.stack([x, np.zeros(60), np.full(60, 2.5)], axis=1)
    colours = np.stack([np.linspace(0, 1, 60)] * 3, axis=1)
    return splats(means, scale=0.3, logits=-1.5, rgb=colours)


def scaled(factor: float) -> Gaussians:
    scene = neighbours(1, count=40)
    return replace(
        scene,
        means=scene.means * np.float32(factor),
        log_scales=scene.log_scales + np.float32(np.log(factor)),
    )


def star(depth: float, size: float) -> Gaussians:
    distant = splats([(0.1 * depth, 0.1 * depth, depth)], scale=size, degree=3)
    distant.sh[0, 1:] = 0.1
    return among_neighbours(distant, degree=3)


def two_towns() -> Gaussians:
    """Half of the scene is at the origin, the other half 20 km away."""
    return concatenate([neighbours(count=30, seed=3), shifted(neighbours, (2e4, 0, 0), np.float64)])


def lost_outliers() -> Gaussians:
    """Some splats that training lost at 10¹⁵ must not decide what positions are relative to."""
    lost = splats(np.array([(1e15, 0, 0), (0, -1e15, 1e15), (-1e15, 1e15, 0)]))
    return concatenate([neighbours(1, count=40), splats(lost.means, degree=1)])


TINY = {"near 1e-7": RenderSettings(model=ImageModel(near=1e-7))}

CASES = (
    moved_case(
        "10⁷ m from the origin", "Geo-referenced: float32 has steps of a metre there.", (1e7, -2e7, 3e6)
    ),
    moved_case("10⁷ m, along the view", "Depths are small differences of huge numbers.", (0.0, 0.0, 1e7)),
    moved_case("6.4·10⁶ m, earth-centred", "Latitude and longitude as x, y, z.", (4.2e6, 1.7e5, 4.8e6)),
    moved_case(
        "10⁷ m in float32",
        "Whole numbers, which float32 still holds.",
        (1e7, 0.0, -1e7),
        dtype=np.float32,
        build=on_whole_numbers,
    ),
    moved_case(
        "10⁵ m in float32",
        "Steps of 8 mm are in the file; none may be added.",
        (1e5, 3e4, -1e5),
        dtype=np.float32,
        same=False,
    ),
    moved_case(
        "gradient at 10⁶ m",
        "Bands where positions are rounded (Spark issue 287).",
        (1e6, 1e6, 0.0),
        build=smooth_gradient,
    ),
    moved_case(
        "10¹² m from the origin", "What float64 can still do: steps of 0.1 mm.", (1e12, 0.0, 0.0), same=False
    ),
    case(
        "two towns 20 km apart",
        "No centre is near both halves.",
        two_towns,
        cameras=(FRONT, moved(FRONT, (2e4, 0, 0))),
        most_excluded=3,
    ),
    case(
        "lost outliers",
        "A few splats at 10¹⁵ beside a good scene.",
        lost_outliers,
        cameras=(FRONT, TURNED),
        culled=(40, 41, 42),
        most_excluded=3,
    ),
    case(
        "scene of a millionth",
        "Everything within 3e-6 of the eye.",
        partial(scaled, 1e-6),
        settings=TINY,
        most_excluded=3,
    ),
    case("scene of a million", "Everything 3 million units away.", partial(scaled, 1e6), most_excluded=3),
    case(
        "star at 10¹²",
        "A splat of 10¹¹ units, seen as a few pixels.",
        partial(star, 1e12, 1e11),
        cameras=(FRONT, TURNED),
        visible=(0,),
        settings=BOTH,
    ),
    case(
        "star at 10²⁵",
        "The square of its distance is infinite in float32.",
        partial(star, 1e25, 1e24),
        visible=(0,),
        trains=False,
        settings=BOTH,
    ),
    case(
        "means at the end of float32",
        "3e38 away, a point that the blur makes a pixel of.",
        partial(star, 3e38, 1.0),
        visible=(0,),
        trains=False,
    ),
    case(
        "telescope",
        "An eye 10⁴ units away with a focal length of 10⁵ px.",
        ORDINARY,
        most_excluded=6,
        cameras=(camera(focal=1e5, eye=(0, 0, -1e4)),),
    ),
)
