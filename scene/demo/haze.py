"""What is hardly there: mist over the water and in the valleys, clouds, and the sky behind them."""

from __future__ import annotations

import numpy as np

from ..gaussians import Gaussians, concatenate
from .light import SUN_COLOUR, film, sky
from .noise import fbm, mix, smoothstep
from .shapes import balls, discs, sphere_points, unit

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
