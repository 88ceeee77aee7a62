"""What a document is at this moment: scene, a mark a splat, palette, crops, and the versions of each."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from splatview.edit.kernels import marks as kernels
from splatview.scene import Gaussians
from splatview.scene.edits import IDENTITY, Adjustment, Crop

CHANGES_KEPT = 64
"""Runs of changed marks that are remembered: a renderer that missed more reads all marks anew."""


class State:
    """Only `changes` alter it, and each alteration raises the version of what it alters."""

    def __init__(self, gaussians: Gaussians) -> None:
        self.gaussians = gaussians
        self.marks = np.zeros(len(gaussians), np.uint32)
        self.palette: tuple[Adjustment, ...] = (IDENTITY,)
        self.crops: tuple[Crop, ...] = ()
        self.revision = 0
        """Grows with every edit, but not when splats light up."""
        self.scene_version = 0
        self.marks_version = 0
        self.palette_version = 0
        self.crops_version = 0
        self.changes: deque[tuple[int, int, int]] = deque(maxlen=CHANGES_KEPT)

    @property
    def versions(self) -> tuple[int, int, int, int]:
        """Of scene, marks, palette and crops: equal exactly if nothing has changed in between."""
        return (self.scene_version, self.marks_version, self.palette_version, self.crops_version)

    def marks_changed(self, start: int, stop: int, *, edited: bool = True) -> None:
        """To be called after `marks[start:stop]` was written to."""
        self.revision += edited
        self.marks_version += 1
        self.changes.append((self.marks_version, start, stop))

    def set_palette(self, palette: tuple[Adjustment, ...]) -> None:
        self.revision += 1
        self.palette = palette
        self.palette_version += 1

    def set_crops(self, crops: tuple[Crop, ...]) -> None:
        self.revision += 1
        self.crops = crops
        self.crops_version += 1

    def set_scene(self, gaussians: Gaussians, marks: np.ndarray | None = None) -> None:
        """Another scene in its place, with `marks` if it has more or fewer splats."""
        self.revision += 1
        self.gaussians = gaussians
        self.scene_version += 1
        if marks is not None:
            self.marks = marks
            self.marks_version += 1
            self.changes.clear()


# ---- Sets of splats, kept small: what the history stores instead of masks.


@dataclass(frozen=True, eq=False)
class SplatSet:
    """Some of N splats: as runs, or where those would take more room, one bit a splat.

    Never more than N / 8 bytes, so the history of a scene has a bound that does not depend on how
    scattered the selections are.
    """

    size: int
    """N."""
    count: int
    """How many are in the set."""
    span: tuple[int, int]
    """(start, stop) that holds all of it; (0, 0) if it is empty."""
    stored: np.ndarray
    """(R, 2) int32 start and count, or (ceil(N / 8),) uint8 bits, lowest first."""

    @classmethod
    def of_mask(cls, mask: np.ndarray) -> SplatSet:
        """`mask` (N,) bool."""
        mask = np.ascontiguousarray(mask, bool)
        size, count = len(mask), int(np.count_nonzero(mask))
        if not count:
            return cls(size, 0, (0, 0), np.empty((0, 2), np.int32))
        runs = int(np.count_nonzero(mask[1:] > mask[:-1])) + int(mask[0])
        stop = size - int(mask[::-1].argmax())
        span = (int(mask.argmax()), stop)
        if 8 * runs <= (size + 7) // 8:
            return cls(size, count, span, kernels.mask_runs(mask, runs))
        return cls(size, count, span, np.packbits(mask, bitorder="little"))

    @classmethod
    def of_flags(cls, marks: np.ndarray, care: int, value: int) -> SplatSet:
        """Those whose flags within `care` are exactly `value`."""
        return cls.of_mask(kernels.flag_mask(marks, care, value))

    @property
    def mask(self) -> np.ndarray:
        """(N,) bool."""
        if self.stored.ndim == 1:
            return np.unpackbits(self.stored, count=self.size, bitorder="little").view(bool)
        mask = np.zeros(self.size, bool)
        kernels.fill_mask(self.stored, mask)
        return mask

    @property
    def indices(self) -> np.ndarray:
        """(count,) int64, ascending."""
        return np.flatnonzero(self.mask)

    def toggle(self, marks: np.ndarray, bits: int) -> None:
        """Flips `bits` of the set's `marks` (N,) uint32, in place."""
        if self.stored.ndim == 1:
            kernels.toggle_mask(marks, self.mask, bits)
        else:
            kernels.toggle_runs(marks, self.stored, bits)

    @property
    def nbytes(self) -> int:
        return self.stored.nbytes

    def __len__(self) -> int:
        return self.count
