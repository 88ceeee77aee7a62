"""Scenes made by code: the landscape that opens when nothing else is given, and single subjects of it.

World units are arbitrary. Internally y is up; `demo_scene` turns the result so that -y is up, as in
scenes trained from photos.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from splatview.scene.camera import Camera, look_at
from splatview.scene.demo.lighting import film, lit, sky
from splatview.scene.demo.objects import column, dome, hides, knot, mist, pond, reflecting, sphere
from splatview.scene.demo.plants import forest, fur, grass, plant, reeds
from splatview.scene.demo.primitives import balls, discs, fbm, pack
from splatview.scene.demo.terrain import WATER_LEVEL, height, surface, survey
from splatview.scene.errors import InputError
from splatview.scene.gaussians import Gaussians, concatenate
from splatview.scene.sh import sh_basis

DEFAULT_SPLATS = 190_000
"""Enough that the first view shows no holes at 1280x720."""

COMMENT = "Made by splatview: demo scene"

MONUMENT = np.array([0.95, -0.30, 0.45])
"""Where its column stands on the bottom of the pond."""

KNOT = MONUMENT + np.array((0, 0.92, 0))
KNOT_SIZE = 0.42
BALL = np.array([-1.25, 0.0, 1.78])
BALL_RADIUS = 0.27
STONE = np.array([0.30, 0.27, 0.235])
GOLD = np.array([1.30, 0.84, 0.32])


def demo_scene(name: str = "landscape", *, splats: int | None = None, seed: int = 0) -> Gaussians:
    """The demo scene `name` in about `splats` splats (default: what suits it), SH degree 3, -y up.

    "landscape": all there is; "needles", "gloss", "haze": one kind of splat each; "single": one splat.
    Equal arguments give equal scenes.

    Raises:
        InputError: no such scene, or fewer than 1 splat.
    """
    if name not in SCENES:
        raise InputError(f"no demo scene is called {name!r}: choose from {', '.join(SCENES)}")
    make, usual = SCENES[name]
    count = usual if splats is None else splats
    if count < 1:
        raise InputError(f"a demo scene needs at least 1 splat, got {count}")
    made = make(count, np.random.default_rng(seed))
    return turned_over(concatenate([made]), f"{COMMENT} {name}")


def demo_camera(width: int = 1280, height: int = 720) -> Camera:
    """The view for which the landscape was composed: over the pond to the mountains."""
    return look_at(
        (0.45, -1.35, -5.9), (0.15, -0.98, 0.0), up=(0, -1, 0), fov_y=42, width=width, height=height
    )


def landscape(count: int, rng: np.random.Generator) -> Gaussians:
    trees = plant(rng)
    ground = survey(trees.canopy)

    def share(fraction: float) -> int:
        return max(8, round(count * fraction))

    def mirrored_in_water(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        golden = hides(KNOT, KNOT_SIZE, origins, directions)[:, None]
        return np.where(golden, 0.75 * GOLD, ground.seen(origins, directions))

    return concatenate(
        [
            dome(share(0.032)),
            surface(share(0.47), ground),
            pond(share(0.055), ground, WATER_LEVEL, (3.3, 2.3), mirrored_in_water),
            monument(share(0.055), ground),
            forest(share(0.25), trees, ground, rng),
            grass(share(0.20), trees, ground, rng),
            reeds(share(0.010), ground, rng),
            mist(share(0.003), rng, height),
        ]
    )


def monument(count: int, ground) -> Gaussians:
    """A golden knot on a column in the water, and a silver ball in the grass."""
    lawn = float(ground.smooth_at(ground.heights, BALL[None])[0])
    gold = knot(count * 6 // 10, KNOT, KNOT_SIZE, 0.085)
    ball = sphere(count * 2 // 10, BALL + np.array((0, lawn + 0.85 * BALL_RADIUS, 0)), BALL_RADIUS)
    stone, up, spacing = column(count * 2 // 10, MONUMENT, 0.17, 0.42)
    grain = 1 + 0.35 * fbm(stone * 9.0, 401)[:, None]
    shade = lit(STONE * grain, up, ground.sunlight(stone), 0.85)
    parts = [discs(stone, up, spacing, film(shade))]
    for (points, normals, spacing), tint, reflectance in (
        (gold, GOLD, 0.78),
        (ball, np.array((0.92, 0.95, 1.0)), 0.72),
    ):
        sun = ground.sunlight(points)
        base = lit(np.tile(0.18 * tint, (len(points), 1)), normals, sun, 0.8)
        parts.append(
            discs(
                points,
                normals,
                spacing,
                reflecting(points, normals, base, tint, reflectance, ground.seen, sun),
            )
        )
    return concatenate(parts)


def needles_alone(count: int, rng: np.random.Generator) -> Gaussians:
    return fur(count, 1.0, rng)


def gloss_alone(count: int, rng: np.random.Generator) -> Gaussians:
    """A golden knot under an open sky; below the horizon lies a dark ground."""

    def arriving(_origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        ground = np.array((0.10, 0.075, 0.05))
        return np.where(directions[:, 1:2] > 0, sky(directions), ground)

    points, normals, spacing = knot(count, np.zeros(3), 1.0, 0.26)
    base = lit(np.tile(0.15 * GOLD, (len(points), 1)), normals, 1.0, 1.0)
    return discs(points, normals, spacing, reflecting(points, normals, base, GOLD, 0.75, arriving))


def haze_alone(count: int, rng: np.random.Generator) -> Gaussians:
    """A cloud: large faint splats, thick in the middle, lit from the sun's side."""
    points = rng.normal(size=(count, 3)) * (1.0, 0.45, 0.7)
    scales = rng.uniform(0.10, 0.45, (count, 1)) * rng.uniform(0.7, 1.3, (count, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    colour = film(lit(np.full((count, 3), 0.5), normals, 1.0, 1.0, wrap=0.8))
    return balls(points, scales, colour, opacity=rng.uniform(0.01, 0.12, count))


def single(count: int, rng: np.random.Generator) -> Gaussians:
    """`count` equal splats in one place, an ellipsoid with three different axes; one, unless asked."""
    return pack(
        np.zeros((count, 3)),
        np.tile((0.92, 0.10, 0.20, 0.32), (count, 1)),
        np.tile((0.5, 0.25, 0.1), (count, 1)),
        np.tile((0.90, 0.55, 0.20), (count, 1)),
        0.95,
    )


SCENES: dict[str, tuple[Callable[[int, np.random.Generator], Gaussians], int]] = {
    "landscape": (landscape, DEFAULT_SPLATS),
    "needles": (needles_alone, 30_000),
    "gloss": (gloss_alone, 20_000),
    "haze": (haze_alone, 600),
    "single": (single, 1),
}
"""Name -> (maker, usual number of splats)."""


def turned_over(gaussians: Gaussians, comment: str) -> Gaussians:
    """Half a turn about x, from y up to -y up, SH padded to degree 3 and turned along."""
    flip = np.array([1, -1, -1])
    probe = np.array([[0.48, 0.60, 0.64]])
    # Half a turn about an axis only changes the sign of each basis function.
    signs = np.sign(sh_basis(probe * flip, 3) * sh_basis(probe, 3))[0]
    sh = np.zeros((len(gaussians), 16, 3), dtype=np.float32)
    sh[:, : gaussians.sh.shape[1]] = gaussians.sh
    w, x, y, z = gaussians.quats.T
    return Gaussians(
        means=gaussians.means * flip.astype(np.float32),
        quats=np.stack([-x, w, -z, y], axis=1),
        log_scales=gaussians.log_scales,
        opacity_logits=gaussians.opacity_logits,
        sh=sh * signs[:, None].astype(np.float32),
        comments=(comment,),
    )
