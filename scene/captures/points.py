"""Points to start from where no reconstruction gives any: random ones where the cameras look."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.formats import load_scene
from splatview.scene.formats.io import excerpt
from splatview.scene.sh import SH_C0

MIN_POINTS = 4
"""A point and its three nearest neighbours, which give a splat its size."""

RANDOM_POINTS = 20_000

GREY = 128

BALL_OF_DISTANCE = 0.5
"""Radius of the ball around what all cameras look at, in cameras' distances from it."""

FACING = 0.8
"""Share of the cameras that must have that point before them for it to count."""

NEAR_OF_EXTENT, FAR_OF_EXTENT = 0.2, 5.0
"""Depths of points in front of cameras that look different ways, in the cameras' own spread."""


def random_points(
    cameras: Sequence[Camera], count: int = RANDOM_POINTS, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """(count, 3) float64 and (count, 3) uint8 grey; equal arguments give equal points.

    In a ball around the point nearest to all optical axes where the cameras look at one thing; elsewhere
    (a room from within, a row of parallel views) in front of the cameras, evenly in disparity.
    """
    rng = np.random.default_rng(seed)
    eyes = np.array([camera.eye for camera in cameras])
    axes = np.array([camera.forward for camera in cameras])
    focus = _nearest_to_axes(eyes, axes)
    facing = ((focus - eyes) * axes).sum(axis=1) > 0
    if facing.mean() >= FACING and _is_bounded(axes):
        radius = BALL_OF_DISTANCE * float(np.median(np.linalg.norm(eyes - focus, axis=1)))
        direction = rng.normal(size=(count, 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        points = focus + radius * direction * rng.uniform(size=(count, 1)) ** (1 / 3)
    else:
        points = _in_front(cameras, eyes, count, rng)
    return points, np.full((count, 3), GREY, dtype=np.uint8)


def _across(axes: np.ndarray) -> np.ndarray:
    """(N, 3) unit -> (3, 3): the sum of the projections across the axes."""
    return len(axes) * np.eye(3) - axes.T @ axes


def _is_bounded(axes: np.ndarray) -> bool:
    """Whether the axes differ enough (some 3° on average) that they say how far away they meet."""
    return float(np.linalg.eigvalsh(_across(axes))[0]) > 0.0025 * len(axes)


def _nearest_to_axes(eyes: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """The point with the least sum of squared distances to the lines eye + t·axis."""
    offsets = eyes.sum(axis=0) - axes.T @ (axes * eyes).sum(axis=1)
    return np.linalg.lstsq(_across(axes), offsets, rcond=None)[0]


def _in_front(
    cameras: Sequence[Camera], eyes: np.ndarray, count: int, rng: np.random.Generator
) -> np.ndarray:
    extent = float(np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max()) or 1.0
    depth = 1 / rng.uniform(1 / (FAR_OF_EXTENT * extent), 1 / (NEAR_OF_EXTENT * extent), size=count)
    pixel = rng.uniform(size=(count, 2))
    points = np.empty((count, 3))
    for i, camera in enumerate(cameras):
        mine = slice(i, None, len(cameras))
        rays = camera.points_at(pixel[mine] * (camera.width, camera.height), 1.0)
        # Pixels that the lens shows nothing at: straight ahead instead.
        rays = np.where(np.isfinite(rays), rays, (0.0, 0.0, 1.0)) * depth[mine, None]
        points[mine] = camera.eye + rays @ camera.R_world_camera.T
    return points


def first_points(
    folder: Path, named: Sequence[str], usual: Sequence[str]
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """(P, 3) float64, (P, 3) uint8 and warnings, of the first file in `folder` that there is.

    `named` are names that the capture gives, and that are missed where they are not there; `usual` are
    tried then. No points where there is no file. Raises InputError where it is damaged.
    """
    warnings = [
        f"the points {excerpt(name)} are not on disk" for name in named if not os.path.isfile(folder / name)
    ]
    for name in (*named, *usual):
        path = folder / name
        if os.path.isfile(path):
            cloud = load_scene(path)
            colours = np.clip(cloud.sh[:, 0] * SH_C0 + 0.5, 0, 1)
            colours = (np.nan_to_num(colours, nan=0.5) * 255 + 0.5).astype(np.uint8)
            return cloud.means.astype(np.float64), colours, warnings
    return np.empty((0, 3)), np.empty((0, 3), dtype=np.uint8), warnings
