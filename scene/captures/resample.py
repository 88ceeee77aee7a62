"""Photos at other pixels: as a pinhole would have taken them, faces of panoramas, and averages by area."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.captures.panoramas import places_in
from splatview.scene.lens import FISHEYE_RADIUS, Lens, distort, undistort

# Where photos are to look as a pinhole would have taken them, their distortion is taken out once, when they
# are loaded. What that costs was measured on pictures of a demo scene, 750x498, taken through a lens that
# shifts pixels by up to 13 (k1 = -0.05) or 40 (k1 = -0.15) and brought back: PSNR against the pinhole's
# picture is 45.3 and 44.2 dB at full size, 49.4 and 48.4 dB after downscaling by 2, 54.7 and 54.0 dB by 4,
# where trained scenes reach 25 to 35 dB; leaving the distortion in gives 26.2 and 21.8 dB. It takes some
# 0.1 s a megapixel on one core, once. What lies outside the pinhole's frame is lost, which is why training
# through the lens is better where a lens bends much.


ROWS_AT_ONCE = 64
"""Rows of an undistorted photo worked on together: bounds the memory for its coordinates."""


def undistorted(image: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The photo as a pinhole of the same size, focal lengths and principal point would have taken it.

    image: (H, W, C) uint8, C <= 4. Returns (H, W, C) uint8, and (H, W) bool: which pixels the photo covers.
    Bilinear. The same focal lengths keep the scale at the centre; what a barrel-shaped photo shows beyond
    the frame is lost, and what it does not reach is False.
    """
    height, width, channels = image.shape
    flat = _as_words(image).ravel()
    right, down = int(width > 1), width if height > 1 else 0
    out = np.zeros((height, width, 4), dtype=np.uint8)
    valid = np.zeros((height, width), dtype=bool)

    u = (np.arange(width) + 0.5 - camera.cx) / camera.fx
    v = (np.arange(height) + 0.5 - camera.cy) / camera.fy
    lens = camera.lens or Lens(model="PINHOLE")
    for top in range(0, height, ROWS_AT_ONCE):
        rows = slice(top, min(top + ROWS_AT_ONCE, height))
        rays = np.stack(np.broadcast_arrays(u[None, :], v[rows, None]), axis=-1)
        there = distort(rays, lens)
        # From pixel centres: 0 is the middle of the first pixel.
        x = there[..., 0] * camera.fx + camera.cx - 0.5
        y = there[..., 1] * camera.fy + camera.cy - 0.5
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        if np.isfinite(lens.valid_radius):
            inside &= np.hypot(rays[..., 0], rays[..., 1]) < lens.valid_radius
        valid[rows] = inside
        x, y = x[inside].astype(np.float32), y[inside].astype(np.float32)
        left = np.clip(x.astype(np.int64), 0, max(width - 2, 0))
        upper = np.clip(y.astype(np.int64), 0, max(height - 2, 0))
        out[rows][inside] = _mixed(flat, upper * width + left, right, down, x - left, y - upper)
    return out[..., :channels], valid


def _as_words(image: np.ndarray) -> np.ndarray:
    """(H, W, C) uint8 -> (H, W) uint32, C <= 4: a gather of words fetches all channels of a pixel at once,
    1.3 times as fast in all."""
    words = np.zeros((*image.shape[:2], 4), dtype=np.uint8)
    words[..., : image.shape[2]] = image
    return words.view(np.uint32)[..., 0]


def _mixed(
    flat: np.ndarray, first: np.ndarray, right: int, down: int, ax: np.ndarray, ay: np.ndarray
) -> np.ndarray:
    """(P, 4) uint8: bilinear between pixels `first` (P,) of words and those so many to the right and below,
    by shares (P,) float32 of the way."""

    def at(indices: np.ndarray) -> np.ndarray:
        return flat.take(indices).view(np.uint8).reshape(-1, 4).astype(np.float32)

    ax, ay = ax[:, None], ay[:, None]
    above, below = at(first), at(first + down)
    above += (at(first + right) - above) * ax
    below += (at(first + down + right) - below) * ax
    above += (below - above) * ay
    return (above + np.float32(0.5)).astype(np.uint8)


def face_of(panorama: np.ndarray, face: str, side: int) -> np.ndarray:
    """(H, W, C) uint8, C <= 4, equirectangular -> (side, side, C) uint8: a face of the cube around it, see
    `panoramas`. Bilinear, round the seam; the last rows reach to the poles."""
    height, width, channels = panorama.shape
    # The first column again behind the last, so that each pixel has a neighbour.
    words = _as_words(panorama)
    flat = np.concatenate([words, words[:, :1]], axis=1).ravel()
    out = np.empty((side, side, 4), dtype=np.uint8)
    for top in range(0, side, ROWS_AT_ONCE):
        rows = np.arange(top, min(top + ROWS_AT_ONCE, side))
        u, v = places_in(face, side, rows)
        # From pixel centres: 0 is the middle of the first pixel.
        x = (u * width - 0.5).ravel() % width
        y = np.clip(v * height - 0.5, 0, height - 1).ravel()
        left = np.minimum(x.astype(np.int64), width - 1)
        upper = np.clip(y.astype(np.int64), 0, max(height - 2, 0))
        down = width + 1 if height > 1 else 0
        shares = ((x - left).astype(np.float32), (y - upper).astype(np.float32))
        out[rows] = _mixed(flat, upper * (width + 1) + left, 1, down, *shares).reshape(-1, side, 4)
    return out[..., :channels]


def pixels_that_see(camera: Camera) -> np.ndarray | None:
    """(H, W) bool: pixels that the lens shows something at, which corners of a fisheye's picture often are
    not; None where all are."""
    lens = camera.lens
    border = camera.visible_slopes
    if lens is None or not max(map(abs, border)) >= min(lens.valid_radius, FISHEYE_RADIUS):
        return None
    return _pixels_that_see(
        lens, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    ).copy()


@lru_cache(maxsize=16)
def _pixels_that_see(
    lens: Lens, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> np.ndarray:
    seen = np.empty((height, width), dtype=bool)
    x, y = (np.arange(width) + 0.5 - cx) / fx, (np.arange(height) + 0.5 - cy) / fy
    for top in range(0, height, ROWS_AT_ONCE):
        rows = slice(top, min(top + ROWS_AT_ONCE, height))
        points = np.stack(np.broadcast_arrays(x[None, :], y[rows, None]), axis=-1)
        seen[rows] = np.isfinite(undistort(points, lens)).all(axis=-1)
    return seen


def area_averaged(
    image: np.ndarray, width: int, height: int, extent: tuple[float, float] | None = None
) -> np.ndarray:
    """(H, W, C) uint8 -> (height, width, C) uint8, no larger than it was: each pixel is the mean of the area
    that it covers, pixels of the edge in parts. `extent`: what there is of the image in its pixels (x, y),
    where the last ones reach beyond."""
    if image.shape[:2] == (height, width):
        return image
    x, y = extent or (image.shape[1], image.shape[0])
    factor = image.shape[1] // width
    if image.shape[:2] == (y, x) == (factor * height, factor * width):
        return _averaged_by(factor, image)
    rows = _average_rows(image, height, y)
    columns = _average_rows(np.ascontiguousarray(rows.transpose(1, 0, 2)), width, x)
    return (columns.transpose(1, 0, 2) + 0.5).astype(np.uint8)


def wholly_valid(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) bool -> (height, width) bool: True where all of the area is."""
    ignored = area_averaged(np.where(mask, 0, 255).astype(np.uint8)[..., None], width, height)[..., 0]
    if mask.shape == (height, width):
        return mask
    # A part below 1/510 of a pixel's area rounds to nothing, as it does in the colour.
    return ignored == 0


def _averaged_by(factor: int, image: np.ndarray) -> np.ndarray:
    """(H, W, C) uint8 -> (H / factor, W / factor, C) uint8, where both are whole: by whole numbers, the same
    as by areas. RGB of 16 megapixels takes 0.05 s in place of 0.15 by a factor of four, grey levels 0.016 in
    place of 0.09. (Dropped: `Image.reduce`, as fast, but a tenth of a level too dark by three.)"""
    rows = image[::factor].astype(np.uint32 if factor > MOST_ROWS else np.uint16)
    for i in range(1, factor):
        rows += image[i::factor]
    sums = rows[:, ::factor].astype(np.uint32)
    for i in range(1, factor):
        sums += rows[:, i::factor]
    return (sums / np.float32(factor**2) + np.float32(0.5)).astype(np.uint8)


def _average_rows(image: np.ndarray, count: int, extent: float) -> np.ndarray:
    """(H, W, C) -> (count, W, C) float32, of the first `extent` rows."""
    height = len(image)
    flat = image.reshape(height, -1)
    out = np.empty((count, flat.shape[1]), dtype=np.float32)
    edges = np.arange(count + 1) * (extent / count)
    for i in range(count):
        first = min(int(edges[i]), height - 1)
        last = min(int(np.ceil(edges[i + 1] - 1e-9)), height)
        covered = np.minimum(np.arange(first, last) + 1, edges[i + 1]) - np.maximum(
            np.arange(first, last), edges[i]
        )
        weights = (covered / covered.sum()).astype(np.float32)
        out[i] = weights @ flat[first:last].astype(np.float32)
    return out.reshape(count, *image.shape[1:])


MOST_ROWS = 257
"""Pixels whose sum 16 bits hold."""
