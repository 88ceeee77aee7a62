"""Where a run stands, what its steps report, and what ends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

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
    seconds: float = 0.0
    """Wall-clock time since the run began, pauses between resumed parts left out."""
    prepared: float = 0.0
    """Of these, before the first step."""
