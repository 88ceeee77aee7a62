"""The ground grid and the world's axes as lines in the picture."""

from __future__ import annotations

import math

import numpy as np

from splatview.renderers.gl.overlay import Lines
from splatview.scene import Camera
from splatview.scene.image_model import NEAR

CELLS = 20
"""Cells from the grid's middle to its edge."""

CELLS_IN_SCENE = 5.0
"""About so many cells lie in the scene's radius."""

PIECES = 24
"""Pieces of a line, each with an opacity of its own."""

MAJOR = 10
"""Every so-many-th line is brighter."""

AXIS_COLOURS = ((0.90, 0.38, 0.36), (0.48, 0.76, 0.36), (0.36, 0.58, 0.94))
"""Of x, y and z, as on the axis cross."""

GREY, MINOR_OPACITY, MAJOR_OPACITY = (0.62, 0.64, 0.68), 0.4, 0.75

GRID_THROUGH, AXES_THROUGH = 0.15, 0.6
"""Share of grid and axes that is seen through the scene."""


def cell_size(radius: float) -> float:
    """World units: 1, 2 or 5 times a power of ten, about `radius` over CELLS_IN_SCENE."""
    wanted = max(radius, 1e-30) / CELLS_IN_SCENE
    power = 10.0 ** math.floor(math.log10(wanted))
    return power * max(step for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1 + 1e-9))


def plane_axes(up: np.ndarray) -> np.ndarray:
    """(2, 3) float64: unit directions in the ground of the unit `up` (3,); world axes where that is one."""
    aside = np.eye(3)[np.argsort(np.abs(up), kind="stable")[:2]]
    first = aside[0] - (aside[0] @ up) * up
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)])


def ground_lines(camera: Camera, up: np.ndarray, floor: np.ndarray, radius: float) -> Lines:
    """A grid of cells of `cell_size` on the plane through `floor` (3,), world, square to the unit `up` (3,);
    fades away from `floor`. Its lines lie at multiples of the cell from the world's origin."""
    cell = cell_size(radius)
    directions = plane_axes(up)
    middle = np.round(directions @ floor / cell)
    height = (up @ floor) * up
    offsets = np.arange(-CELLS, CELLS + 1)
    along = np.linspace(-CELLS, CELLS, PIECES + 1)
    starts, colours = [], []
    for axis in (0, 1):
        numbers = middle[axis] + offsets
        grid = np.zeros((len(offsets), PIECES + 1, 2))
        grid[..., axis] = numbers[:, None]
        grid[..., 1 - axis] = middle[1 - axis] + along
        opacity = np.where(numbers % MAJOR == 0, MAJOR_OPACITY, MINOR_OPACITY)[:, None]
        away = np.hypot(grid[..., 0] - middle[0], grid[..., 1] - middle[1]) / CELLS
        fade = opacity * np.clip(1 - away, 0, 1)
        starts.append(grid * cell)
        colours.append(np.concatenate([np.broadcast_to(GREY, (*fade.shape, 3)), fade[..., None]], axis=2))
    points = np.concatenate(starts).reshape(-1, PIECES + 1, 2) @ directions + height
    rgba = np.concatenate(colours)
    ends = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
    colour = np.stack([rgba[:, :-1], rgba[:, 1:]], axis=2).reshape(-1, 2, 4)
    return projected(camera, ends, colour, shows_through=GRID_THROUGH)


def axis_lines(camera: Camera, length: float) -> Lines:
    """The world's axes from the origin, `length` world units long each."""
    share = np.linspace(0, length, PIECES + 1)
    points = share[None, :, None] * np.eye(3)[:, None, :]
    ends = np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)
    rgba = np.concatenate([np.array(AXIS_COLOURS), np.ones((3, 1))], axis=1)
    colour = np.repeat(rgba, PIECES, axis=0)[:, None].repeat(2, axis=1)
    return projected(camera, ends, colour, shows_through=AXES_THROUGH)


def projected(camera: Camera, ends: np.ndarray, colours: np.ndarray, *, shows_through: float) -> Lines:
    """Pieces with `ends` (L, 2, 3), world, and `colours` (L, 2, 4) as `camera` sees them; cut off at the
    near plane where rays meet in the eye, and left out where the picture has none of them."""
    t = (ends - camera.eye) @ camera.R_camera_world.T
    if not camera.orthographic:
        before = t[..., 2] >= NEAR
        t, colours, before = (part[before.any(axis=1)] for part in (t, colours, before))
        for end in (0, 1):
            cut = ~before[:, end]
            share = (NEAR - t[cut, 1 - end, 2]) / (t[cut, end, 2] - t[cut, 1 - end, 2])
            t[cut, end] = t[cut, 1 - end] + share[:, None] * (t[cut, end] - t[cut, 1 - end])
    pixels = camera.image_points(t)
    with np.errstate(invalid="ignore"):
        low, high = pixels.min(axis=1), pixels.max(axis=1)
        seen = (high >= -2).all(axis=1) & (low <= (camera.width + 2, camera.height + 2)).all(axis=1)
        seen &= (np.abs(pixels) < 1e6).all(axis=(1, 2)) & (colours[..., 3] > 0).any(axis=1)
    return Lines(pixels[seen].astype(np.float32), colours[seen].astype(np.float32), shows_through)
