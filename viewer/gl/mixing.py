"""Scenes between two levels of merging: some parts of the finer one, the others of the coarser."""

from __future__ import annotations

from collections import OrderedDict

import numpy as np

from ...scene import Gaussians
from ...scene.gaussians import concatenate
from ...scene.merging import chances

MOST_KEPT = 2
"""Mixtures kept at once: the one in force, and the one before, to which a budget often goes back."""


class Mixer:
    """Makes scenes between two levels when they are asked for. For one thread at a time."""

    def __init__(self, finer: Gaussians, coarser: Gaussians, cell: float):
        """`cell`: the side of those in which `finer` was merged to `coarser`."""
        self.finer, self.coarser = finer, coarser
        self._cell = cell
        self._chances: tuple[np.ndarray, np.ndarray] | None = None
        self._made: OrderedDict[float, Gaussians] = OrderedDict()

    def scene(self, merged: float) -> Gaussians:
        """With a share `merged` of the finer one's cubes replaced by what they were merged to."""
        if self._chances is None:
            self._chances = (
                chances(self.finer, self._cell, self.finer),
                chances(self.finer, self._cell, self.coarser),
            )
        if merged not in self._made:
            fine, coarse = self._chances
            parts = [self.finer.take(fine >= merged), self.coarser.take(coarse < merged)]
            self._made[merged] = concatenate(parts)
            while len(self._made) > MOST_KEPT:
                self._made.popitem(last=False)
        self._made.move_to_end(merged)
        return self._made[merged]
