"""The ground: a pond in a meadow in a bowl of mountains, and the shadows that everything throws on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.scene.demo.lighting import SUN, film, lit, sky
from splatview.scene.demo.primitives import discs, fbm, mix, noise, ridged, smoothstep, sunflower, unit
from splatview.scene.gaussians import Gaussians

RADIUS = 19.0
"""Where the ground ends, behind the crests."""

CORE = 4.2
"""Splats are densest within this radius; beyond it the spacing grows with the distance."""

WATER_LEVEL = 0.0

GRASS = np.array([0.105, 0.165, 0.040])
DRY_GRASS = np.array([0.28, 0.225, 0.070])
EARTH = np.array([0.17, 0.115, 0.065])
SAND = np.array([0.36, 0.28, 0.18])
ROCK = np.array([0.23, 0.205, 0.185])
DARK_ROCK = np.array([0.105, 0.10, 0.105])
SNOW = np.array([0.88, 0.90, 0.95])


def height(x: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Height (N,) of the ground at x, z (N,)."""
    here = np.stack([x, z], axis=1)
    radius = np.hypot(x, z)
    rolling = fbm(here * 0.35, 11, octaves=4)
    meadow = 0.17 + 0.22 * (rolling + 0.35) + 0.02 * np.clip(radius - 3, 0, None) ** 1.3
    shore = np.hypot(x / 1.5, z) / 1.75 + 0.28 * fbm(here * 0.55, 23, octaves=3)
    ground = -0.42 + (np.maximum(meadow, 0.06) + 0.42) * smoothstep(0.55, 1.45, shore)

    # Mountains all round, lower towards +z where the first camera stands.
    away = smoothstep(-0.9, 0.75, -z / np.maximum(radius, 1e-9))
    foot = smoothstep(6.5, 15.0, radius + 1.6 * fbm(here * 0.16, 31, octaves=2))
    crests = ridged(here * 0.115 + 0.35 * noise(here * 0.1, 41)[:, None], 43, octaves=5)
    return ground + foot * (0.6 + (1.1 + 4.3 * away) * crests**1.15)


def surface_normals(x: np.ndarray, z: np.ndarray, step: float | np.ndarray = 0.02) -> np.ndarray:
    """Unit normals (N, 3) of the ground at x, z (N,); slopes are taken over `step` (N,) world units."""
    slope_x = (height(x + step / 2, z) - height(x - step / 2, z)) / step
    slope_z = (height(x, z + step / 2) - height(x, z - step / 2)) / step
    return unit(np.stack([-slope_x, np.ones_like(x), -slope_z], axis=1))


def albedo(points: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Colour (N, 3) of the bare ground at `points` (N, 3) by height, slope and chance."""
    here = points[:, ::2]
    patches, fine = fbm(here * 0.9, 51, octaves=4), fbm(here * 7.0, 61, octaves=3)
    green = mix(GRASS, DRY_GRASS, smoothstep(-0.35, 0.55, patches + 0.25 * fine))
    earth = mix(green, EARTH, smoothstep(0.25, 0.6, fbm(here * 1.7, 71, octaves=4) + 0.1 * fine))
    strata = fbm(np.stack([points[:, 1] * 3.2, 0.3 * (here[:, 0] + here[:, 1])], axis=1), 81, octaves=3)
    rock = mix(ROCK, DARK_ROCK, smoothstep(-0.4, 0.5, strata + 0.5 * fine))
    steep = smoothstep(0.86, 0.70, normals[:, 1] + 0.06 * fine + 0.04 * patches)
    high = smoothstep(1.7, 3.2, points[:, 1] + 0.7 * patches)
    colour = mix(earth, rock, np.clip(steep + 0.75 * high, 0, 1))
    snow = smoothstep(1.9, 2.8, points[:, 1] + 0.9 * patches) * smoothstep(
        0.45, 0.64, normals[:, 1] + 0.08 * fine
    )
    colour = mix(colour, SNOW, snow)
    wet = smoothstep(0.10, 0.03, points[:, 1] + 0.02 * fine)
    colour = mix(colour, SAND * 0.85, wet)
    colour = colour * (1 - 0.45 * smoothstep(0.035, -0.01, points[:, 1]))[:, None]
    return colour * (1 + 0.22 * fine)[:, None]


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground on a grid, for what asks about it in bulk: shadows, openness, reflections."""

    heights: np.ndarray
    """(M, M) of the ground, rows along z."""
    obstacles: np.ndarray
    """(M, M) with what stands on it."""
    openness: np.ndarray
    """(M, M) share of the sky that is seen, in [0, 1]."""
    radiance: np.ndarray
    """(M, M, 3) that the ground sends out."""

    @property
    def cell(self) -> float:
        return 2 * RADIUS / (len(self.heights) - 1)

    def at(self, grid: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Nearest values of `grid` (M, M, ...) at `points` (..., 3)."""
        index = np.clip((points + RADIUS) / self.cell + 0.5, 0, len(grid) - 1).astype(np.int32)
        return grid[index[..., 2], index[..., 0]]

    def smooth_at(self, grid: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Bilinear values of `grid` (M, M) at `points` (N, 3)."""
        where = np.clip((points[:, ::2] + RADIUS) / self.cell, 0, len(grid) - 1.001)
        i, j = where.astype(np.int32).T
        u, v = (where - np.floor(where)).T
        top = grid[j, i] * (1 - u) + grid[j, i + 1] * u
        return top * (1 - v) + (grid[j + 1, i] * (1 - u) + grid[j + 1, i + 1] * u) * v

    def sunlight(self, points: np.ndarray, *, lift: float | np.ndarray = 0.03) -> np.ndarray:
        """How much of the sun reaches `points` (N, 3), in [0, 1]: penumbrae widen with the distance."""
        light = np.ones(len(points))
        for distance in 0.06 * 1.17 ** np.arange(36):
            ray = points + SUN * distance
            clearance = ray[:, 1] + lift - self.smooth_at(self.obstacles, ray)
            light = np.minimum(light, 0.5 + clearance / (0.10 * distance + 0.04))
        return smoothstep(0, 1, light)

    def seen(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance (N, 3) along rays from `origins` in unit `directions` (N, 3): ground or sky."""
        colour = sky(np.maximum(directions, (-1, 0.01, -1)))
        searching = np.arange(len(origins))
        for distance in 0.10 * 1.22 ** np.arange(28):
            ray = origins[searching] + directions[searching] * distance
            hit = ray[:, 1] < self.at(self.obstacles, ray)
            colour[searching[hit]] = self.at(self.radiance, ray[hit])
            searching = searching[~hit]
        return colour


def survey(obstacle_height, *, cells: int = 420) -> Ground:
    """Measures the ground on a grid. `obstacle_height(points (N, 3)) -> (N,)` is what stands there."""
    axis = np.linspace(-RADIUS, RADIUS, cells)
    x, z = (grid.ravel() for grid in np.meshgrid(axis, axis))
    h = height(x, z)
    points = np.stack([x, h, z], axis=1)
    heights = h.reshape(cells, cells)
    obstacles = np.maximum(heights + obstacle_height(points).reshape(cells, cells), WATER_LEVEL)
    # Openness: how far a place lies below the mean of its surroundings, near and far.
    openness = np.ones_like(heights)
    for reach, strength in ((2, 1.2), (5, 0.8), (14, 0.35)):
        hollow = box_blur(obstacles, reach) - heights
        openness -= strength * np.clip(hollow / (reach * 2 * RADIUS / cells), -0.2, 1) * 0.5
    ground = Ground(heights, obstacles, np.clip(openness, 0.15, 1), np.zeros((cells, cells, 3)))
    slope_z, slope_x = np.gradient(heights, axis, axis)
    normals = unit(np.stack([-slope_x.ravel(), np.ones(cells**2), -slope_z.ravel()], axis=1))
    radiance = lit(albedo(points, normals), normals, ground.sunlight(points), ground.openness.ravel())
    wooded = (obstacles > heights + 0.12)[..., None]
    radiance = np.where(wooded, (0.07, 0.08, 0.03), radiance.reshape(cells, cells, 3))
    return Ground(heights, obstacles, ground.openness, radiance)


def box_blur(grid: np.ndarray, reach: int) -> np.ndarray:
    """Means over (2·reach + 1)² cells, twice, edges repeated."""
    for axis in (0, 1, 0, 1):
        pad = [(reach + 1, reach) if a == axis else (0, 0) for a in (0, 1)]
        sums = np.cumsum(np.pad(grid, pad, mode="edge"), axis=axis)
        ahead, behind = [slice(None)] * 2, [slice(None)] * 2
        ahead[axis], behind[axis] = slice(2 * reach + 1, None), slice(None, -2 * reach - 1)
        grid = (sums[tuple(ahead)] - sums[tuple(behind)]) / (2 * reach + 1)
    return grid


def distance_haze(points: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """Air between the middle of the scene and `points` (N, 3) mixed into `radiance` (N, 3)."""
    distance = np.hypot(points[:, 0], points[:, 2])
    share = (
        0.62
        * (1 - np.exp(-np.clip(distance - 5, 0, None) / 11))
        * np.exp(-np.clip(points[:, 1], 0, None) / 7)
    )
    flat = unit(points * (1, 0, 1) + (1e-6, 0, 0)) * (1, 0, 1) + (0, 0.07, 0)
    return mix(radiance, 0.72 * sky(unit(flat)), share)


def surface(count: int, ground: Ground) -> Gaussians:
    """The ground in `count` flat discs, densest around the pond."""
    rank, angle = sunflower(count)
    # Density proportional to 1 / (r² + CORE²): the integral inverted.
    growth = np.log(1 + (RADIUS / CORE) ** 2)
    radius = CORE * np.sqrt(np.expm1(rank * growth))
    spacing = np.sqrt(np.pi * growth * (radius**2 + CORE**2) / count)
    x, z = radius * np.cos(angle), radius * np.sin(angle)
    h = height(x, z)
    keep = h > -0.3
    x, z, h, spacing = x[keep], z[keep], h[keep], spacing[keep]
    points = np.stack([x, h, z], axis=1)
    # Finer slopes than the discs can show would only make them bristle.
    normals = surface_normals(x, z, 1.6 * spacing)
    radiance = lit(
        albedo(points, normals), normals, ground.sunlight(points), ground.smooth_at(ground.openness, points)
    )
    downhill = np.cross(np.cross(normals, (0.0, 1.0, 0.0)) + np.array((0, 0, 1e-9)), normals)
    return discs(
        points,
        normals,
        spacing,
        film(distance_haze(points, radiance)),
        tangents=unit(downhill),
        stretch=1 / np.clip(normals[:, 1], 0.45, 1),
        opacity=0.985,
    )
