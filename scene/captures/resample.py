"""Photos through a pinhole and at another size: undistortion and averaging by area.

Distortion is taken out of the photo once, rather than put into the projection of every splat in every
step: see `undistorted` for what that costs.
"""

from __future__ import annotations

import numpy as np

from ..files.colmap import ColmapCamera
from .lens import distort, fold_radius

ROWS_AT_ONCE = 64
"""Of an undistorted photo: bounds the memory for its coordinates."""


def undistorted(image: np.ndarray, lens: ColmapCamera) -> tuple[np.ndarray, np.ndarray]:
    """The photo as a pinhole of the same size, focal lengths and principal point would have taken it.

    image: (H, W, C) uint8. Returns (H, W, C) uint8, and (H, W) bool: which pixels the photo covers.
    Bilinear. The same focal lengths keep the scale at the centre; what a barrel-shaped photo shows beyond
    the frame is lost, and what it does not reach is False.
    """
    height, width = image.shape[:2]
    out = np.zeros_like(image)
    valid = np.zeros((height, width), dtype=bool)
    u = (np.arange(width) + 0.5 - lens.cx) / lens.fx
    v = (np.arange(height) + 0.5 - lens.cy) / lens.fy
    reach = float(np.hypot(np.abs(u).max(), np.abs(v).max()))
    fold = fold_radius(lens, reach)
    flat = image.reshape(height * width, -1)
    for top in range(0, height, ROWS_AT_ONCE):
        rows = slice(top, min(top + ROWS_AT_ONCE, height))
        rays = np.stack(np.broadcast_arrays(u[None, :], v[rows, None]), axis=-1)
        there = distort(rays, lens)
        # From pixel centres: 0 is the middle of the first pixel.
        x = (there[..., 0] * lens.fx + lens.cx - 0.5).ravel()
        y = (there[..., 1] * lens.fy + lens.cy - 0.5).ravel()
        inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
        inside &= np.hypot(rays[..., 0], rays[..., 1]).ravel() < fold
        x, y = x[inside].astype(np.float32), y[inside].astype(np.float32)
        left, up = x.astype(np.int32), y.astype(np.int32)
        ax, ay = (x - left)[:, None], (y - up)[:, None]
        right, down = np.minimum(left + 1, width - 1), np.minimum(up + 1, height - 1)
        above = flat[up * width + left] * (1 - ax) + flat[up * width + right] * ax
        below = flat[down * width + left] * (1 - ax) + flat[down * width + right] * ax
        valid[rows] = inside.reshape(-1, width)
        out[rows][valid[rows]] = (above * (1 - ay) + below * ay + 0.5).astype(np.uint8)
    return out, valid


def area_averaged(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W, C) uint8 -> (height, width, C) uint8, no larger than it was: each pixel is the mean of the area
    that it covers, pixels of the edge in parts."""
    if image.shape[:2] == (height, width):
        return image
    rows = _average_rows(image, height)
    columns = _average_rows(np.ascontiguousarray(rows.transpose(1, 0, 2)), width)
    return (columns.transpose(1, 0, 2) + 0.5).astype(np.uint8)


def wholly_valid(mask: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) bool -> (height, width) bool: True where all of the area is."""
    ignored = area_averaged(np.where(mask, 0, 255).astype(np.uint8)[..., None], width, height)[..., 0]
    if mask.shape == (height, width):
        return mask
    # A part below 1/510 of a pixel's area rounds to nothing, as it does in the colour.
    return ignored == 0


def _average_rows(image: np.ndarray, count: int) -> np.ndarray:
    """(H, W, C) -> (count, W, C) float32."""
    height = len(image)
    flat = image.reshape(height, -1)
    out = np.empty((count, flat.shape[1]), dtype=np.float32)
    edges = np.arange(count + 1) * (height / count)
    for i in range(count):
        first = min(int(edges[i]), height - 1)
        last = min(int(np.ceil(edges[i + 1] - 1e-9)), height)
        covered = np.minimum(np.arange(first, last) + 1, edges[i + 1]) - np.maximum(
            np.arange(first, last), edges[i]
        )
        weights = (covered / covered.sum()).astype(np.float32)
        out[i] = weights @ flat[first:last].astype(np.float32)
    return out.reshape(count, *image.shape[1:])
