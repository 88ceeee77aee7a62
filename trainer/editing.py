"""Edits of a run between its steps: its recipe, and what of the scene is deleted, cropped, or kept free."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from splatview.scene import InputError
from splatview.scene.edits import Crop, cropped_in, crops_about
from splatview.trainer.adam import SelectiveAdam
from splatview.trainer.counters import Counters
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import Splats
from splatview.trainer.strategies import Strategy
from splatview.trainer.strategies.ops import State, keep

KEPT = (
    *("seed", "strategy", "background", "surround", "model", "exposure", "shading", "outliers"),
    *("transients", "withheld"),
)
"""Settings that a run keeps from its first step to its last."""

CUT_STEPS = 10
"""Steps after which what has moved to where the recipe cuts is taken out, if not refined sooner."""


class Editing:
    """What somebody may change in a `Trainer` between its steps."""

    splats: Splats
    optimizer: SelectiveAdam
    state: State
    strategy: Strategy
    settings: TrainSettings
    most_splats: float
    """Splats that the run has memory for: `max_splats` cannot be raised above."""
    counters: Counters
    centre: np.ndarray
    """(3,) float64: where the origin of the splats is in the world; crops and regions are in the world."""

    def change(self, **settings: Any) -> None:
        """Changes fields of the recipe, between two steps.

        Raises:
            ValueError: a value makes no sense, or is one that a run keeps; nothing is changed.
        """
        for name in KEPT:
            if settings.get(name, getattr(self.settings, name)) != getattr(self.settings, name):
                raise ValueError(f"{name} cannot be changed in a run")
        if not settings.get("max_splats", 0) <= self.most_splats:
            raise ValueError(f"max_splats must be at most {self.most_splats:,}: there is no memory for more")
        self.settings = replace(self.settings, **settings)
        self.strategy.settings = self._local(self.settings)

    def _local(self, settings: TrainSettings) -> TrainSettings:
        """The settings with their regions relative to the centre."""
        return replace(settings, no_growth=crops_about(settings.no_growth, self.centre))

    def delete(self, ids: np.ndarray) -> int:
        """Takes out the splats of these numbers, see `Splats.ids`; those that are gone already do not matter.

        Returns how many were taken out. Density control may fill the place again, and the number of splats
        up to its plan: see `add_region`. Of several processes each must be told the same.

        Raises:
            InputError: none would be left; nothing is changed.
        """
        return self._keep(~np.isin(self.splats.ids, ids))

    def crop(self, crops: Sequence[Crop]) -> int:
        """Takes out what the crops in force cut away, and returns how many that were. Raises as `delete`."""
        return self._cropped(crops)

    def _cropped(self, crops: Sequence[Crop]) -> int:
        return self._keep(cropped_in(crops_about(crops, self.centre), self.splats.arrays.means))

    def add_cut(self, crops: Sequence[Crop]) -> int:
        """As `crop`, and from now on what comes to where they cut is soon taken out too.

        The recipe's `cut` holds these rules, and `change` takes one out. They never take the last splats.
        """
        gone = self.crop(crops)
        self.change(cut=(*self.settings.cut, tuple(crops)))
        return gone

    def add_region(self, region: Crop) -> None:
        """From now on nothing grows inside the region; what is there is trained on, and may die or move away.

        The recipe's `no_growth` holds the regions, and `change` takes one out.
        """
        self.change(no_growth=(*self.settings.no_growth, region))

    def _keep(self, kept: np.ndarray) -> int:
        if not kept.any():
            raise InputError("no splat would be left to train; choose fewer")
        if not kept.all():
            keep(self.splats, self.optimizer, self.state, kept)
        return int(len(kept) - kept.sum())

    def _cut(self) -> None:
        """Takes out what has come to where the recipe cuts, now and then."""
        iteration = self.counters.iteration
        if iteration % CUT_STEPS == 0 or self.state["refined_at"] == iteration:
            for crops in self.settings.cut:
                # A run is not ended by the last splats' moving out: they stay until others are inside.
                with contextlib.suppress(InputError):
                    self._cropped(crops)
