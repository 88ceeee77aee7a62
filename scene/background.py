"""What is seen where the scene lets light through: one colour, a sky over a ground, or a picture all around.

All but a colour are seen along the pixels' rays, so they stay where they are while the eye turns, and are
infinitely far away: the eye's place does not matter. Colours are display-referred, as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.scene.camera import Camera

Colour = tuple[float, float, float]
"""RGB."""

WORLD_UP = (0.0, -1.0, 0.0)
"""Trainers keep the axes of the first photos, x right, y down: -y is up, nearly or exactly."""

ROWS = 32
"""Rows of a picture worked on at once, so that what is in between fits into a cache."""


@dataclass(frozen=True, kw_only=True)
class Gradient:
    """From `bottom` straight down to `top` straight up, in proportion to the height on the unit sphere."""

    top: Colour
    bottom: Colour
    up: tuple[float, float, float] = WORLD_UP
    """Upwards, world axes; any length but 0."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Panorama:
    """An equirectangular picture, seen from its inside; equal to none but itself.

    Its top row lies upwards and its middle column in front, which is +z as far as `up` allows (+x where z is
    up or down): with -y up, a camera of the identity matrix has the middle of the picture before it. What is
    right in the picture is to the right. Between its pixels it is bilinear, and its sides meet.
    """

    pixels: np.ndarray
    """(H, W, 3) uint8."""
    up: tuple[float, float, float] = WORLD_UP
    name: str = ""
    """What messages call it."""


Background = Colour | Gradient | Panorama


def axes_of(background: Gradient | Panorama) -> np.ndarray:
    """(3, 3) float64: its right, up and front as rows, unit, world axes."""
    up = np.asarray(background.up, np.float64)
    up = up / np.linalg.norm(up)
    front = np.array([0.0, 0.0, 1.0]) if abs(up[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    front = front - (front @ up) * up
    front /= np.linalg.norm(front)
    return np.stack([np.cross(front, up), up, front])


def pixel_rays(camera: Camera) -> np.ndarray | None:
    """(3, 3) float64: takes (x, y, 1), px, to the pixel's ray in world axes, of any length; None where the
    camera has a lens that bends them. Parallel rays all go the same way."""
    if camera.lens is not None:
        return None
    if camera.orthographic:
        return np.outer(camera.forward, (0.0, 0.0, 1.0))
    inverse = np.array(
        [
            [1 / camera.fx, 0, -camera.cx / camera.fx],
            [0, 1 / camera.fy, -camera.cy / camera.fy],
            [0, 0, 1],
        ]
    )
    return camera.R_world_camera @ inverse


def background_colours(
    background: Background, camera: Camera, dtype: type[np.floating] = np.float64
) -> np.ndarray:
    """What `camera` sees of it, in `dtype`: (H, W, 3), or (3,) where it is one colour.

    Black where a lens shows nothing, so far out that no ray comes there."""
    if isinstance(background, tuple):
        return np.asarray(background, dtype)
    picture = np.empty((camera.height, camera.width, 3), dtype)
    for top in range(0, camera.height, ROWS):
        rows = picture[top : top + ROWS]
        rays = _rays(background, camera, top, rows)
        if isinstance(background, Gradient):
            rows[:] = _gradient(background, *rays)
        else:
            rows[:] = _panorama(background, *rays)
        if camera.lens is not None:
            rows[~np.isfinite(rays).all(axis=0)] = 0
    return picture


def composite_over(image: np.ndarray, background: Background, camera: Camera) -> None:
    """Blends `background` behind a picture (H, W, 4), premultiplied over black, in place. Image model: the
    last part of step 7, with T = 1 - alpha."""
    behind = background_colours(background, camera, image.dtype.type)
    image[..., :3] += (1 - image[..., 3:]) * behind


Rays = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Components (R, W) along the background's right, up and front, of any length."""


def _rays(background: Gradient | Panorama, camera: Camera, top: int, like: np.ndarray) -> Rays:
    """Through the centres of the pixels of the rows from `top` on, as many as `like` (R, W, 3) has."""
    dtype = like.dtype.type
    x = np.arange(like.shape[1], dtype=dtype) + dtype(0.5)
    y = np.arange(top, top + like.shape[0], dtype=dtype)[:, None] + dtype(0.5)
    matrix = pixel_rays(camera)
    if matrix is None:
        pixels = np.stack(np.broadcast_arrays(x, y), axis=-1)
        world = camera.points_at(pixels, 1.0) @ camera.R_world_camera.T
        right, up, front = np.moveaxis((world @ axes_of(background).T).astype(dtype), -1, 0)
    else:
        right, up, front = (
            dtype(across) * x + (dtype(down) * y + dtype(ahead))
            for across, down, ahead in axes_of(background) @ matrix
        )
    return right, up, front


def _gradient(background: Gradient, right: np.ndarray, up: np.ndarray, front: np.ndarray) -> np.ndarray:
    """(R, W, 3)"""
    dtype = up.dtype
    share = (up / np.sqrt(right * right + up * up + front * front) + 1) / 2
    bottom, top = np.array(background.bottom, dtype), np.array(background.top, dtype)
    return bottom + share[..., None] * (top - bottom)


def _panorama(background: Panorama, right: np.ndarray, up: np.ndarray, front: np.ndarray) -> np.ndarray:
    """(R, W, 3)"""
    number, pixels = up.dtype.type, background.pixels.reshape(-1, 3)
    height, width = background.pixels.shape[:2]
    turn = np.arctan2(right, front) * number(0.5 / np.pi) + number(0.5)
    fall = number(0.5) - np.arctan2(up, np.sqrt(right * right + front * front)) * number(1 / np.pi)
    x = turn * width - number(0.5)
    y = np.clip(fall * height - number(0.5), 0, height - 1)
    with np.errstate(invalid="ignore"):
        left, top = np.nan_to_num(np.floor(x)), np.nan_to_num(np.floor(y))
    across, down = (x - left)[..., None], (y - top)[..., None]
    left, top = left.astype(np.int32) % width, top.astype(np.int32) * width
    beside, below = (left + 1) % width, np.minimum(top + width, (height - 1) * width)
    above = pixels.take(top + left, 0) * (1 - across) + pixels.take(top + beside, 0) * across
    under = pixels.take(below + left, 0) * (1 - across) + pixels.take(below + beside, 0) * across
    return (above * (1 - down) + under * down) / number(255)
