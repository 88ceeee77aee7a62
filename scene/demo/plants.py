"""Needles: grass, flowers and reeds round the pond, pines and autumn birches up the slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.scene.demo import terrain
from splatview.scene.demo.lighting import film, lit
from splatview.scene.demo.primitives import discs, fbm, mix, needles, noise, smoothstep, sphere_points, unit
from splatview.scene.demo.terrain import Ground, distance_haze
from splatview.scene.gaussians import Gaussians, concatenate

PINE_WIDTH = 0.24
"""Radius of a pine's skirt in units of its height."""

CLEARING = np.array([0.0, 6.5])
"""No tree stands on the line from here, where the first camera is, to the pond."""


@dataclass(frozen=True, eq=False)
class Trees:
    feet: np.ndarray
    """(T, 3) on the ground."""
    tall: np.ndarray
    """(T,) height in world units."""
    pine: np.ndarray
    """(T,) bool; the others are birches."""
    hue: np.ndarray
    """(T,) in [0, 1]: from green to red."""

    def canopy(self, points: np.ndarray) -> np.ndarray:
        """Height (N,) above the ground of the trees that stand over `points` (N, 3)."""
        top = np.zeros(len(points))
        for foot, tall, pine in zip(self.feet, self.tall, self.pine, strict=True):
            near = np.flatnonzero(np.abs(points[:, 0] - foot[0]) < 0.45 * tall)
            near = near[np.abs(points[near, 2] - foot[2]) < 0.45 * tall]
            distance = np.hypot(points[near, 0] - foot[0], points[near, 2] - foot[2]) / tall
            if pine:
                crown = tall * np.clip(1 - distance / PINE_WIDTH, 0, 1)
            else:
                crown = (
                    tall
                    * (0.62 + 0.34 * np.sqrt(np.clip(1 - (distance / 0.30) ** 2, 0, 1)))
                    * (distance < 0.30)
                )
            top[near] = np.maximum(top[near], crown)
        return top


def plant(rng: np.random.Generator, *, candidates: int = 9000) -> Trees:
    """Where trees stand: groves on gentle ground, none in the water or before the first camera."""
    radius = rng.uniform(2.6, 15.0, candidates)
    angle = rng.uniform(0, 2 * np.pi, candidates)
    x, z = radius * np.cos(angle), radius * np.sin(angle)
    h = terrain.height(x, z)
    normals = terrain.surface_normals(x, z)
    grove = fbm(np.stack([x, z], axis=1) * 0.33, 91, octaves=3)
    fits = (h > 0.16) & (h < 2.7) & (normals[:, 1] > 0.80) & (grove > 0.12 - 0.035 * (radius - 4))
    along = np.clip((x * CLEARING[0] + z * CLEARING[1]) / (CLEARING @ CLEARING), 0, 1.4)
    aside = np.hypot(x - along * CLEARING[0], z - along * CLEARING[1])
    fits &= ~((z > 0) & (aside < 1.5 + 0.34 * z))
    order = np.flatnonzero(fits).tolist()
    chosen: list[int] = []
    for i in order:
        apart = 0.42 + 0.012 * radius[i]
        taken = np.array(chosen, dtype=int)
        if not taken.size or np.hypot(x[taken] - x[i], z[taken] - z[i]).min() > apart:
            chosen.append(i)
    x, z, h = x[chosen], z[chosen], h[chosen]
    kind = noise(np.stack([x, z], axis=1) * 0.55, 97) + rng.normal(0, 0.25, len(x))
    pine = (kind > -0.12) | (h > 1.6)
    tall = np.where(pine, rng.uniform(0.75, 1.55, len(x)), rng.uniform(0.65, 1.05, len(x)))
    hue = np.clip(rng.normal(0.5, 0.28, len(x)), 0, 1)
    return Trees(np.stack([x, h - 0.02, z], axis=1), tall, pine, hue)


def forest(count: int, trees: Trees, ground: Ground, rng: np.random.Generator) -> Gaussians:
    """All trees in `count` splats, more of them in trees near the pond."""
    distance = np.hypot(trees.feet[:, 0], trees.feet[:, 2])
    weight = trees.tall * np.where(trees.pine, 1.0, 1.0) / (6 + distance**2)
    per_tree = np.maximum(8, np.round(weight / weight.sum() * count * 0.96)).astype(int)
    parts = [trunks(trees, ground)]
    for kind, grow in ((trees.pine, pine_needles), (~trees.pine, birch_leaves)):
        which = np.repeat(np.flatnonzero(kind), per_tree[kind])
        # Fewer splats in a tree: each covers more of it.
        size = np.sqrt(500 / per_tree[which])
        parts.append(grow(which, size, trees, ground, rng))
    return concatenate(parts)


def trunks(trees: Trees, ground: Ground) -> Gaussians:
    up = np.zeros_like(trees.feet)
    up[:, 1] = trees.tall * np.where(trees.pine, 0.9, 0.75)
    bark = np.where(trees.pine[:, None], (0.13, 0.085, 0.055), (0.62, 0.58, 0.50))
    side = np.tile(unit(np.array((-0.6, 0.2, 0.7))), (len(up), 1))
    light = ground.sunlight(trees.feet + up * 0.4, lift=0.5 * trees.tall)
    colour = film(distance_haze(trees.feet, lit(bark, side, light, 0.6)))
    return needles(trees.feet - 0.15 * up, trees.feet + up, 0.014 * trees.tall, colour, opacity=0.97)


def pine_needles(which, size, trees: Trees, ground: Ground, rng: np.random.Generator) -> Gaussians:
    """Twigs that leave the trunk in whorls and droop."""
    n, tall, feet = len(which), trees.tall[which], trees.feet[which]
    up = 1 - np.sqrt(rng.uniform(0.0, 0.84, n))
    up = 0.10 + 0.90 * (up - up.min()) / (1 - up.min())
    whorls = 11
    level = np.floor(up * whorls + rng.uniform(-0.15, 0.15, n)) / whorls
    skirt = PINE_WIDTH * (1.04 - up) * (0.75 + 0.5 * (1 - (up - level) * whorls).clip(0, 1))
    out = np.sqrt(rng.uniform(0.08, 1, n))
    angle = rng.uniform(0, 2 * np.pi, n)
    spoke = np.stack([np.cos(angle), np.zeros(n), np.sin(angle)], axis=1)
    sag = np.array((0, 1.0, 0)) * (-0.30 * out * skirt)[:, None]
    place = feet + tall[:, None] * (
        spoke * (skirt * out)[:, None] + sag + np.array((0, 1.0, 0)) * up[:, None]
    )
    direction = unit(spoke + np.array((0, -0.28, 0)) + rng.normal(0, 0.30, (n, 3)))
    length = tall * size * 0.105 * (0.55 + 0.6 * (1 - up))
    green = (
        mix((0.030, 0.062, 0.030), (0.085, 0.125, 0.040), rng.random(n))
        * (0.75 + 0.5 * trees.hue[which])[:, None]
    )
    normal = unit(spoke * 0.9 + (0, 0.55, 0) + rng.normal(0, 0.25, (n, 3)))
    sun = ground.sunlight(place + 0.30 * tall[:, None] * spoke, lift=0.10)
    light = lit(green, normal, (0.25 + 0.75 * sun) * (0.25 + 0.75 * out), 0.25 + 0.75 * out**2, wrap=0.3)
    half = direction * (length / 2)[:, None]
    width = 0.0075 * tall * size
    return needles(place - half, place + half, width, film(distance_haze(place, light)), opacity=0.93)


def birch_leaves(which, size, trees: Trees, ground: Ground, rng: np.random.Generator) -> Gaussians:
    """Leaves on the shells of a few overlapping clumps; the low sun shines through them."""
    n, tall, feet = len(which), trees.tall[which], trees.feet[which]
    clumps = rng.normal(size=(len(trees.tall), 7, 3)) * (0.105, 0.12, 0.105) + (0, 0.64, 0)
    middle = clumps[which, rng.integers(0, 7, n)]
    shell = unit(rng.normal(size=(n, 3)))
    out = rng.uniform(0.35, 1, n) ** 0.5
    place = feet + tall[:, None] * (middle + shell * (0.17 * out)[:, None])
    normal = unit(shell + rng.normal(0, 0.45, (n, 3)))
    hue = np.clip(trees.hue[which] + rng.normal(0, 0.13, n), 0, 1)
    colour = mix((0.40, 0.31, 0.035), (0.56, 0.22, 0.025), smoothstep(0.1, 0.6, hue))
    colour = mix(colour, (0.44, 0.085, 0.03), smoothstep(0.65, 1.0, hue))
    from_trunk = unit(place - (feet + tall[:, None] * (0, 0.62, 0)))
    depth = np.linalg.norm(place - (feet + tall[:, None] * (0, 0.62, 0)), axis=1) / (0.28 * tall)
    sun = ground.sunlight(place + 0.28 * tall[:, None] * from_trunk, lift=0.10)
    light = lit(
        colour,
        unit(normal + 1.2 * from_trunk),
        0.15 + 0.85 * sun,
        np.clip(0.25 + 0.75 * depth**2, 0, 1),
        wrap=0.55,
    )
    spacing = 0.040 * tall * size
    return discs(place, normal, spacing, film(distance_haze(place, light)), opacity=0.92)


def grass(count: int, trees: Trees, ground: Ground, rng: np.random.Generator) -> Gaussians:
    """Blades in tufts, thick near the pond, the colour of the ground they stand on."""
    tries = int(count * 2.6)
    radius = 9.5 * rng.beta(1.7, 2.2, tries)
    angle = rng.uniform(0, 2 * np.pi, tries)
    feet = np.stack([radius * np.cos(angle), np.zeros(tries), radius * np.sin(angle)], axis=1)
    feet[:, 1] = terrain.height(feet[:, 0], feet[:, 2])
    tufts = fbm(feet[:, ::2] * 2.6, 101, octaves=3)
    stands = np.flatnonzero((feet[:, 1] > 0.055) & (tufts + rng.normal(0, 0.22, tries) > -0.08))[:count]
    feet, tufts = feet[stands], tufts[stands]
    n = len(feet)
    normals = terrain.surface_normals(feet[:, 0], feet[:, 2])
    long = (0.055 + 0.075 * rng.random(n) ** 2) * (1 + 0.9 * np.clip(tufts, 0, 1))
    wind = np.array((0.30, 0, 0.12)) * noise(feet[:, ::2] * 0.8, 103)[:, None]
    lean = rng.normal(0, 0.30, (n, 3)) * (1, 0, 1) + wind
    tips = feet + (np.array((0, 1.0, 0)) + lean) * long[:, None]
    tone = rng.random(n)
    colour = terrain.albedo(feet, np.tile((0, 1.0, 0), (n, 1))) * (0.75 + 0.65 * tone)[:, None]
    colour = mix(colour, (0.38, 0.33, 0.10), 0.55 * (rng.random(n) < 0.14))
    light = lit(
        colour,
        unit(normals + 0.8 * lean),
        ground.sunlight(feet),
        ground.smooth_at(ground.openness, feet),
        wrap=0.35,
    )
    flowers = np.flatnonzero((tufts > 0.16) & (rng.random(n) < 0.035))
    petals = np.array([(0.85, 0.80, 0.72), (0.80, 0.16, 0.08), (0.80, 0.55, 0.05), (0.42, 0.20, 0.62)])
    petal = petals[(noise(feet[flowers, ::2] * 1.3, 107) * 6).astype(int) % 4]
    bloom = lit(petal, np.tile((0, 1.0, 0), (len(flowers), 1)), ground.sunlight(feet[flowers]), 1.0, wrap=0.4)
    return concatenate(
        [
            needles(feet, tips, 0.0036 + 0.0016 * tone, film(light), opacity=0.90),
            discs(
                tips[flowers] + (0, 0.01, 0),
                unit(rng.normal(0, 0.4, (len(flowers), 3)) + np.array((0, 1, 0))),
                np.full(len(flowers), 0.020),
                film(bloom),
            ),
        ]
    )


def reeds(count: int, ground: Ground, rng: np.random.Generator) -> Gaussians:
    """Stems with brown heads in stands along the waterline."""
    tries = count * 60
    x, z = rng.uniform(-3.6, 3.6, tries), rng.uniform(-2.6, 2.6, tries)
    h = terrain.height(x, z)
    stand = noise(np.stack([x, z], axis=1) * 0.9, 111)
    fits = np.flatnonzero((h > -0.13) & (h < 0.05) & (stand > 0.12))[: count * 3 // 4]
    feet = np.stack([x[fits], h[fits], z[fits]], axis=1)
    n = len(feet)
    long = rng.uniform(0.22, 0.50, n)
    lean = rng.normal(0, 0.11, (n, 3)) * (1, 0, 1)
    tips = feet + (np.array((0, 1.0, 0)) + lean) * long[:, None]
    colour = mix((0.16, 0.17, 0.05), (0.40, 0.32, 0.12), rng.random(n))
    sun = ground.sunlight(feet, lift=0.2)
    stems = film(lit(colour, unit(lean + np.array((-0.3, 0.5, 0.4))), sun, 0.85, wrap=0.5))
    heads = np.flatnonzero(rng.random(n) < 0.33)
    brown = lit(
        np.tile((0.15, 0.075, 0.035), (len(heads), 1)),
        np.tile((-0.5, 0.4, 0.6), (len(heads), 1)),
        sun[heads],
        1.0,
        wrap=0.5,
    )
    along = tips[heads] - feet[heads]
    return concatenate(
        [
            needles(feet, tips, 0.0045, stems),
            needles(feet[heads] + 0.80 * along, tips[heads] + 0.04 * along, 0.011, film(brown), opacity=0.96),
        ]
    )


def fur(count: int, radius: float, rng: np.random.Generator) -> Gaussians:
    """A ball of needles: for looking at needles alone."""
    normals = sphere_points(count)
    swirl = np.cross(normals, (0.2, 1.0, 0.1))
    lean = unit(normals + 0.8 * swirl * noise(normals * 2.0, 113)[:, None] + rng.normal(0, 0.12, (count, 3)))
    feet, tips = radius * 0.62 * normals, radius * (0.62 * normals + 0.38 * lean)
    colour = mix((0.32, 0.13, 0.045), (0.72, 0.42, 0.16), smoothstep(-0.4, 0.5, fbm(normals * 3, 127)))
    light = lit(colour, unit(normals + 0.5 * lean), 1.0, 0.8, wrap=0.3)
    return needles(feet, tips, 0.0045 * radius, film(light * rng.uniform(0.65, 1.25, (count, 1))))
