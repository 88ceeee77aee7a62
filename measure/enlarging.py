"""Pictures drawn small and shown large."""

from __future__ import annotations

import numpy as np


def enlarged(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """`image` (h, w, C) float on (height, width, C) pixels of the same area, bilinear, same dtype.

    What a GPU's linear filter does: pixel centres at halves, the border's pixels continued outwards.
    """
    for axis, size in ((0, height), (1, width)):
        old = image.shape[axis]
        if old == size:
            continue
        place = np.clip((np.arange(size) + 0.5) * (old / size) - 0.5, 0, old - 1)
        before = np.floor(place).astype(np.intp)
        shape = [1, 1, 1]
        shape[axis] = size
        share = (place - before).astype(image.dtype).reshape(shape)
        left = np.take(image, before, axis=axis)
        right = np.take(image, np.minimum(before + 1, old - 1), axis=axis)
        image = left + (right - left) * share
    return image


def reduced_size(width: int, height: int, share: float) -> tuple[int, int]:
    """Pixels of a picture on `share` of the sides, at least 1x1."""
    return max(1, round(width * share)), max(1, round(height * share))
