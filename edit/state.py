"""What a document is at this moment: scene, a mark a splat, palette, crops, and the versions of each."""

from __future__ import annotations

from collections import deque

import numpy as np

from ..scene import Gaussians
from ..scene.adjustment import IDENTITY, Adjustment
from ..scene.crop import Crop

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
