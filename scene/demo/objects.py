"""Colour that moves with the viewer: reflections traced through the scene and fitted with SH to degree 3.

A splat's colour seen along direction d is 0.5 + SH(d). For a glossy surface with normal n the eye sees
what arrives from d - 2(d·n)n; that, tone-mapped, is sampled at many d from which the splat can be seen
at all and fitted by weighted least squares, so that none of the 16 coefficients is spent on views from
inside the object.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from splatview.scene.demo.lighting import SUN, SUN_COLOUR, film, sky
from splatview.scene.demo.primitives import balls, discs, fbm, mix, smoothstep, sphere_points, sunflower, unit
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians, concatenate
from splatview.scene.sh import sh_basis

VIEWS = 144
"""Directions over the whole sphere that a fit samples; about half can see a given splat."""

SUN_LOBE = 16.0
"""How narrow the sun's highlight is, exp(SUN_LOBE·(cos - 1)): about what degree 3 can follow."""

RIDGE = 0.004
"""Weight that keeps coefficients small where no view constrains them."""

BATCH = 4096

Radiance = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""(origins (N, 3), unit directions (N, 3)) -> what arrives from there (N, 3)."""


def fit_sh(
    colours: np.ndarray, directions: np.ndarray, weights: np.ndarray, *, degree: int = 3
) -> np.ndarray:
    """SH coefficients (N, K, 3) that best give display `colours` (N, D, 3) at `directions` (D, 3).

    Directions run from the eye to the splat; `weights` (N, D) are at least 0. The mean colour is not
    held back by the ridge, only how it varies.
    """
    basis = sh_basis(directions, degree)
    squared = np.einsum("nd,dk,dl->nkl", weights, basis, basis, optimize=True)
    target = np.einsum("nd,dk,ndc->nkc", weights, basis, colours - 0.5, optimize=True)
    ridge = np.full(SH_COEFFICIENTS[degree], RIDGE)
    ridge[0] = 1e-9
    squared += np.diag(ridge) * weights.sum(1)[:, None, None]
    return np.linalg.solve(squared, target)


def reflecting(
    points: np.ndarray,
    normals: np.ndarray,
    base: np.ndarray,
    tint: np.ndarray,
    fresnel: float,
    arriving: Radiance,
    sunlight: np.ndarray | float = 1.0,
    *,
    grazing: float = 1.0,
) -> np.ndarray:
    """SH (N, 16, 3) of a polished surface: `base` (N, 3) radiance plus reflections times `tint` (3,).

    `fresnel` is the reflectance face on, in [0, 1] (Schlick 1994); it rises to 1 at the rim.
    `sunlight` (N,) in [0, 1] scales the highlight of the sun, which is too small for SH and is shown as a
    wider lobe. `grazing` above 1 gives views from the side more weight: right for water, which nobody
    sees from above.
    """
    directions = sphere_points(VIEWS)
    sunlight = np.broadcast_to(sunlight, len(points))
    sh = np.empty((len(points), SH_COEFFICIENTS[3], 3))
    for start in range(0, len(points), BATCH):
        batch = slice(start, start + BATCH)
        n = normals[batch]
        facing = -(n @ directions.T)
        weights = np.where(facing > 0, np.clip(facing, 0.1, 1) ** (1 / grazing), 0)
        who, view = np.nonzero(facing > 0)
        cosine = facing[who, view]
        mirrored = directions[view] + 2 * cosine[:, None] * n[who]
        share = fresnel + (1 - fresnel) * (1 - cosine) ** 5
        light = base[batch][who] * (1 - share)[:, None]
        light = light + arriving(points[batch][who], mirrored) * share[:, None] * tint
        highlight = np.exp(SUN_LOBE * (mirrored @ SUN - 1)) * sunlight[batch][who] * share
        light += highlight[:, None] * SUN_COLOUR * tint
        colours = np.full((len(n), VIEWS, 3), 0.5)
        colours[who, view] = film(light)
        sh[batch] = fit_sh(colours, directions, weights)
    return sh


def sphere(count: int, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points, normals (N, 3) and spacing (N,) of a sphere."""
    normals = sphere_points(count)
    return centre + radius * normals, normals, np.full(count, radius * np.sqrt(4 * np.pi / count))


def knot(count: int, centre: np.ndarray, size: float, thickness: float):
    """Points, normals (N, 3) and spacing (N,) of a trefoil knot that stands upright."""

    def curve(t: np.ndarray) -> np.ndarray:
        return size * np.stack(
            [
                (np.sin(t) + 2 * np.sin(2 * t)) / 3,
                (np.cos(t) - 2 * np.cos(2 * t)) / 3,
                -np.sin(3 * t) / 2.2,
            ],
            axis=1,
        )

    lap = curve(np.linspace(0, 2 * np.pi, 400))
    length = np.linalg.norm(np.diff(lap, axis=0), axis=1).sum()
    around = max(3, round(np.sqrt(count * 2 * np.pi * thickness / length)))
    along = max(3, count // around)
    # One helix wound round the whole knot: no rings, no seam.
    t = np.arange(along * around) / (along * around) * 2 * np.pi
    angle = np.arange(along * around) * 2 * np.pi * (along + 0.5) / along / around
    line = curve(t)
    tangent = unit(curve(t + 1e-3) - curve(t - 1e-3))
    side = unit(np.cross(tangent, (0.1, 0.3, 1.0)))
    normals = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(tangent, side)
    points = centre + line + thickness * normals
    spacing = np.full(len(points), 2 * np.pi * thickness / around)
    return points, normals, spacing


def column(count: int, foot: np.ndarray, radius: float, tall: float):
    """Points, normals (N, 3) and spacing (N,) of an upright cylinder with a lid."""
    lid = round(count * radius / (radius + 2 * tall))
    rank, angle = sunflower(lid)
    top = np.stack([np.sqrt(rank) * np.cos(angle), np.zeros(lid), np.sqrt(rank) * np.sin(angle)], axis=1)
    rank, angle = sunflower(count - lid)
    round_it = np.stack([np.cos(angle), np.zeros(count - lid), np.sin(angle)], axis=1)
    points = np.concatenate([radius * top + (0, tall, 0), radius * round_it + rank[:, None] * (0, tall, 0)])
    normals = np.concatenate([np.tile((0.0, 1.0, 0.0), (lid, 1)), round_it])
    area = np.pi * radius * (radius + 2 * tall)
    return foot + points, normals, np.full(count, np.sqrt(area / count))


def hides(centre: np.ndarray, radius: float, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Whether rays (N, 3) pass through a ball, (N,) bool."""
    offset = centre - origins
    along = (offset * directions).sum(1)
    return (along > 0) & ((offset**2).sum(1) - along**2 < radius**2)


def pond(count: int, ground, level: float, half_size: tuple[float, float], arriving: Radiance) -> Gaussians:
    """Water that mirrors what is round it; clear at the shore, ruffled a little."""
    rank, angle = sunflower(count)
    radius = np.sqrt(rank)
    x, z = half_size[0] * radius * np.cos(angle), half_size[1] * radius * np.sin(angle)
    points = np.stack([x, np.full(count, level), z], axis=1)
    depth = level - ground.smooth_at(ground.heights, points)
    points, depth = points[depth > -0.02], depth[depth > -0.02]
    ripple = np.stack([fbm(points[:, ::2] * (2.5, 5.0), seed, octaves=3) for seed in (301, 307)], axis=1)
    normals = unit(np.stack([0.02 * ripple[:, 0], np.ones(len(points)), 0.05 * ripple[:, 1]], axis=1))
    deep = np.clip(depth / 0.35, 0, 1)[:, None]
    base = np.array((0.05, 0.075, 0.05)) * (1 - deep) + np.array((0.012, 0.035, 0.045)) * deep
    sh = reflecting(
        points, normals, base, np.ones(3), 0.22, arriving, 0.5 * ground.sunlight(points), grazing=4.0
    )
    spacing = np.full(len(points), np.sqrt(np.pi * half_size[0] * half_size[1] / count))
    opacity = np.clip(0.35 + 4.0 * depth, 0.30, 0.96)
    return discs(points, normals, spacing * 1.1, sh, opacity=opacity)


SKY_RADIUS = 70.0


def dome(count: int) -> Gaussians:
    """The sky as discs far away; clouds are painted on. Below the horizon it fades into a pale depth."""
    directions = sphere_points(count)
    colour = sky(np.maximum(directions, (-1, 0.0, -1)))
    colour = mix(colour, (0.20, 0.23, 0.30), smoothstep(0.0, -0.75, directions[:, 1]))
    # Clouds lie in a plane overhead: streaks that crowd towards the horizon.
    rise = np.clip(directions[:, 1], 0, None) + 0.10
    plane = directions[:, ::2] / rise[:, None]
    density = fbm(plane * (0.55, 0.95) + 3.3, 201, octaves=5)
    cover = smoothstep(0.02, 0.50, density) * smoothstep(0.03, 0.22, directions[:, 1])
    thick = smoothstep(0.15, 0.75, density)
    white = 0.55 * SUN_COLOUR * (0.55, 0.62, 0.75) * (1 - 0.35 * thick)[:, None]
    colour = mix(colour, 0.45 * colour + white * (0.95, 0.82, 0.76), 0.92 * cover)
    spacing = np.full(len(directions), SKY_RADIUS * np.sqrt(4 * np.pi / count))
    return discs(SKY_RADIUS * directions, -directions, spacing * 1.4, film(colour), opacity=0.98)


def mist(count: int, rng: np.random.Generator, height) -> Gaussians:
    """Large faint splats: a veil over the pond and banks at the mountains' feet."""
    return concatenate([veil(count // 2, rng), banks(count - count // 2, rng, height)])


def veil(count: int, rng: np.random.Generator) -> Gaussians:
    """Thin mist that lies on the far water and lit by the sun behind it."""
    x, z = rng.normal(0.2, 2.0, count), rng.normal(-1.8, 0.9, count)
    points = np.stack([x, 0.06 + 0.16 * rng.random(count), z], axis=1)
    scales = np.stack(
        [rng.uniform(0.35, 0.9, count), rng.uniform(0.03, 0.08, count), rng.uniform(0.2, 0.5, count)], axis=1
    )
    colour = film(np.tile((1.10, 0.98, 0.86), (count, 1)) * rng.uniform(0.8, 1.1, (count, 1)))
    return balls(points, scales, colour, opacity=rng.uniform(0.012, 0.05, count))


def banks(count: int, rng: np.random.Generator, height) -> Gaussians:
    """Mist in the valleys between meadow and crests."""
    radius, angle = rng.uniform(7.5, 15, count), rng.uniform(0, 2 * np.pi, count)
    x, z = radius * np.cos(angle), radius * np.sin(angle)
    points = np.stack([x, height(x, z) + rng.uniform(0.0, 0.5, count), z], axis=1)
    scales = np.stack(
        [rng.uniform(0.8, 1.9, count), rng.uniform(0.10, 0.24, count), rng.uniform(0.8, 1.9, count)], axis=1
    )
    towards = unit(points * (1, 0, 1) + (0, 0.6, 0))
    colour = film(0.80 * sky(towards) + 0.12)
    return balls(points, scales, colour, opacity=rng.uniform(0.03, 0.14, count))
