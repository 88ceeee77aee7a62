"""Holding a frame budget: which shortcut the time allows while the camera moves, and exact when it rests.

What shortcuts save was measured, once, on this scene; what a governor learns while frames go by is one
number, by how much everything takes longer now. No clock and no OpenGL in here.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from statistics import median
from typing import Generic, Protocol, TypeVar

REMEMBERED = 9
"""Frames whose median is what is learnt: it is the median frame that is to take the budget, and on a machine
that others use too, stalls pull a mean far above it."""

SLACK = 1.08
"""A step is kept while it takes the budget by no more than this factor too long or too short: pictures that
changed their sharpness with every frame would be seen to flicker."""

REST_FRAMES = 2
"""Frames in which the camera has not moved after which the exact picture is drawn. Not one: a mouse that is
dragged slowly stands still for a frame now and then."""

OVERTAKEN = 2
"""Frames after a change of step whose times may still be of the step before: GPUs report late."""


class Step(Protocol):
    """A way to draw."""

    @property
    def ms(self) -> float:
        """What a frame took when it was measured."""
        ...


StepT = TypeVar("StepT", bound=Step)


class Slowness:
    """By how much frames take longer than when they were priced."""

    def __init__(self) -> None:
        self._latest: deque[float] = deque(maxlen=REMEMBERED)

    def learn(self, ratio: float) -> None:
        self._latest.append(ratio)

    @property
    def factor(self) -> float:
        return median(self._latest) if self._latest else 1.0


class Governor(Generic[StepT]):
    """Chooses the step whose frames fill the budget."""

    def __init__(self, budget_ms: float, *, slack: float = SLACK):
        self.budget_ms, self.slack = budget_ms, slack
        self.steps: tuple[StepT, ...] = ()
        self.step: StepT | None = None
        """In force while the camera moves; None where there is none to choose from."""
        self._slowness = Slowness()

    @property
    def slowness(self) -> float:
        return self._slowness.factor

    def follow(self, steps: Sequence[StepT]) -> None:
        """Other steps, slowest first. How slow the machine is stays known."""
        self.steps, self.step = tuple(steps), None
        self.choose()

    def set_budget(self, milliseconds: float) -> None:
        if milliseconds != self.budget_ms:
            self.budget_ms, self.step = milliseconds, None
            self.choose()

    def learn(self, step: StepT, milliseconds: float) -> None:
        """A frame drawn by `step` took so long."""
        if step.ms > 0 and math.isfinite(milliseconds) and step in self.steps:
            self._slowness.learn(milliseconds / step.ms)
            self.choose()

    def choose(self) -> None:
        if not self.steps:
            return
        allowed = self.budget_ms / self.slowness
        if self.step is not None and allowed / self.slack <= self.step.ms <= allowed * self.slack:
            return
        fitting = [step for step in self.steps if step.ms <= allowed * self.slack]
        # The nearest to the budget, in ratio; where none fits, the quickest.
        self.step = min(fitting, key=lambda step: _apart(step.ms, allowed), default=self.steps[-1])


def _apart(milliseconds: float, allowed: float) -> float:
    return abs(math.log(max(milliseconds, 1e-9) / max(allowed, 1e-9)))


class Watch(Generic[StepT]):
    """Frame by frame: which step to draw with, and what its time teaches."""

    def __init__(self, governor: Governor[StepT]):
        self.governor = governor
        self.still = REST_FRAMES
        """Frames since the camera moved."""
        self._drawn: StepT | None = None
        self._since = 0

    def next(self, *, moved: bool) -> StepT | None:
        """For the frame that comes; None: exactly."""
        self.still = 0 if moved else min(self.still + 1, REST_FRAMES)
        step = None if self.resting else self.governor.step
        self._since = self._since + 1 if step is self._drawn else 0
        self._drawn = step
        return step

    @property
    def resting(self) -> bool:
        return self.still >= REST_FRAMES

    def took(self, milliseconds: float) -> None:
        """The latest frame that was timed."""
        if self._drawn is not None and self._since >= OVERTAKEN:
            self.governor.learn(self._drawn, milliseconds)
