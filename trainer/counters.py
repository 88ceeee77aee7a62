"""Where a run stands, what its steps report, the curves of that, and what ends it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from splatview.scene import Gaussians, InputError


class NothingSeen(InputError):
    """No photo shows any splat, so that nothing can be learnt."""


class PluginError(InputError):
    """A loss of the user's failed; the message names it and the step. The scene is as the last step left
    it."""

    scene: Gaussians | None = None
    """What was trained so far, where `setup.train` raises it."""


class StepReport(NamedTuple):
    """One step, as plots and progress bars want it."""

    iteration: int
    """Steps done, this one included."""
    loss: float
    gaussians: int
    progress: float
    """Share of the run that is over, 0 to 1."""


@dataclass
class Counters:
    """Where a run stands."""

    iteration: int = 0
    photos: int = 0
    """Photos looked at, of all steps."""
    seconds: float = 0.0
    """Wall-clock time since the run began, pauses between resumed parts left out."""
    prepared: float = 0.0
    """Of these, before the first step."""


MOST_ROWS = 4096
"""Rows kept: more than a plot has pixels."""


class History:
    """Rows of numbers, one a step. When full, pairs become their means: the whole run stays in view."""

    def __init__(self, columns: Sequence[str], limit: int = MOST_ROWS) -> None:
        """`limit`: an even number of rows, at least 2."""
        if not (limit >= 2 and limit % 2 == 0):
            raise ValueError(f"limit must be even and at least 2, got {limit}")
        self._columns = {name: place for place, name in enumerate(columns)}
        self._limit = limit
        self._stride = 1
        self._sum, self._summed = np.zeros(len(self._columns)), 0
        # Replaced as a whole, so that a reader sees rows and their number together. Rows below the number
        # are never written again.
        self._kept: tuple[np.ndarray, int] = (np.empty((len(self._columns), limit)), 0)

    def add(self, *values: float) -> None:
        """One row, in the order of the columns. Only one thread may call this."""
        self._sum += values
        self._summed += 1
        if self._summed < self._stride:
            return
        rows, count = self._kept
        if count == self._limit:
            halved = np.empty_like(rows)
            halved[:, : count // 2] = (rows[:, ::2] + rows[:, 1::2]) / 2
            rows, count = halved, count // 2
            self._stride *= 2
            self._kept = (rows, count)
            if self._summed < self._stride:
                return
        rows[:, count] = self._sum / self._summed
        self._kept = (rows, count + 1)
        self._sum, self._summed = np.zeros(len(self._columns)), 0

    def __len__(self) -> int:
        """Rows that can be read."""
        return self._kept[1]

    def read(self, *names: str) -> list[np.ndarray]:
        """The columns of these names, each (rows,) float64, contiguous, of one moment. Not to be written to.

        Each row is the mean of as many steps as were merged, the same number in all rows.
        """
        rows, count = self._kept
        return [rows[self._columns[name], :count] for name in names]
