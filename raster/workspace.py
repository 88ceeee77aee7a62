"""Buffers that are used again from picture to picture: fresh memory costs a page fault every 4 KiB."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .kept_order import KeptOrder

GROWTH = 1.25
"""A buffer that has become too small is replaced by one so much larger than asked for."""


class Workspace:
    """Named buffers that only grow. Belongs to one picture at a time; not for two threads at once."""

    def __init__(self) -> None:
        self._buffers: dict[str, np.ndarray] = {}
        self.kept_order: KeptOrder | None = None
        """Of the picture before, where `RenderSettings.resort_frames` lets it serve more than one."""

    def take(self, name: str, shape: tuple[int, ...], dtype: np.dtype | type) -> np.ndarray:
        """An array with any contents, aligned to a cache line; the one taken before by this name is lost."""
        dtype = np.dtype(dtype)
        size = math.prod(shape) * dtype.itemsize
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < size:
            capacity = size if buffer is None else int(size * GROWTH)
            self._buffers.pop(name, None)
            del buffer
            whole = np.empty(capacity + 64, np.uint8)
            start = -whole.ctypes.data % 64
            buffer = self._buffers[name] = whole[start : start + capacity]
        return buffer[:size].view(dtype).reshape(shape)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(buffer.nbytes for buffer in self._buffers.values())
