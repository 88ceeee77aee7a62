"""What a training thread shows of itself, and the share of the machine that it keeps to."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from ..scene import Gaussians
from .evaluate import Evaluation
from .settings import TrainSettings

State = Literal["training", "paused", "done", "failed"]

LEAST_SHARE = 0.02
"""Of the cores: less would look like a program that hangs."""


class Pace(NamedTuple):
    """How a share of the cores is kept to."""

    threads: int
    duty: float
    """Of the time, that the threads work; they sleep in between."""


def pace_of(share: float, cores: int) -> Pace:
    """As few threads as have the share, asleep for what they are too many."""
    wanted = min(max(share, LEAST_SHARE), 1.0) * cores
    threads = max(math.ceil(wanted - 1e-9), 1)
    return Pace(threads, min(wanted / threads, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """The scene as it stood after a step. Nothing changes it any more."""

    gaussians: Gaussians
    ids: np.ndarray
    """(N,) int64: who is who, see `Splats.ids`."""
    iteration: int
    seconds: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Status:
    """Where the run stands."""

    state: State
    settings: TrainSettings
    iteration: int
    progress: float
    """Share of the run that is over, 0 to 1."""
    seconds: float
    """Of the run, pauses left out."""
    gaussians: int
    sh_degree: int
    """In training by now."""
    loss: float
    """Of the latest step; NaN before the first."""
    rate: float = 0.0
    """Steps a second, sleep included; 0 while not known."""
    evaluation: Evaluation | None = None
    """The latest one, and..."""
    evaluated_at: int = 0
    """... its step."""
    failure: str | None = None
    """One line on what ended the training."""
    activity: str = ""
    """What takes longer than a step, while it lasts: "Saving"."""
    saved_at: int | None = None
    """Step at which scene and checkpoint were last written by this thread."""

    @property
    def seconds_left(self) -> float | None:
        """Of the run at the present pace; None where that cannot be told."""
        left = []
        if self.settings.iterations is not None and self.rate > 0:
            left.append((self.settings.iterations - self.iteration) / self.rate)
        if self.settings.minutes is not None:
            left.append(60 * self.settings.minutes - self.seconds)
        return max(min(left), 0.0) if left else None
