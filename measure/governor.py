"""Holding a frame budget: which shortcut the time allows while the camera moves, and exact when it rests.

What shortcuts save was measured, once, on this scene; what a governor learns while frames go by is one
number, by how much everything takes longer now. No clock and no OpenGL in here.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Generic, Protocol, TypeVar

import numpy as np

from splatview.measure.ladder import Measured

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


# ---- What a governor can choose from: measured shortcuts, alone and with fewer pixels, each at its price.


SCALES = tuple(2 ** (-k / 12) for k in range(25))
"""Of the picture's sides, from 1 to 1/4; times of neighbours are at most 11 % apart, so that one of them is
within a tenth of any budget that lies between."""

SHARES = tuple(round(0.05 * k, 2) for k in range(1, 20))
"""Of the splats, between those that are measured."""

LEAST_ERROR = 1e-14
"""Mean squared, for logarithms of errors that are 0: rounding alone makes more."""

UNPRICED_PIXELS = 0.8
"""The share of a frame that goes with its pixels, as long as nothing was measured."""


@dataclass(frozen=True, kw_only=True)
class Shortcut:
    """One way to draw in less time."""

    choices: tuple[tuple[str, str], ...]
    """Knob and value, as typed."""
    scale: float
    """Of the picture's sides."""
    kept: float = 1.0
    """Share of the splats that is drawn, of those that contribute most."""
    ms: float
    error: float | None
    """Mean squared error of colours against the truth; None: not measured."""

    @property
    def is_exact(self) -> bool:
        """Leaves nothing out."""
        return not self.choices and self.scale == 1 and self.kept == 1

    @property
    def note(self) -> str:
        """For the user: "40 % of the splats, 71 % of the size, about 35 dB"."""
        parts = [f"{name} {text}" for name, text in self.choices]
        if self.kept < 1:
            parts.append(f"{self.kept:.0%} of the splats")
        if self.scale < 1:
            parts.append(f"{self.scale:.0%} of the size")
        if self.error is None:
            parts.append("error not measured")
        elif self.error > 0:
            parts.append(f"about {-10 * math.log10(self.error):.0f} dB")
        return ", ".join(parts)


def priced(baseline: Measured, rungs: Sequence[Measured]) -> tuple[Shortcut, ...]:
    """Steps from what a ladder found out about one renderer, slowest first, none beaten by another.

    Of each rung with one knob turned, and of the baseline, a step a scale. What half the sides save and
    cost is measured; in between, time goes with the pixels and blur grows with their size. Where time did
    not suffice to measure it, fewer pixels are taken as `unpriced` does, when no measured rung will do.
    """
    own = [one for one in rungs if one.rung.renderer.name == baseline.rung.renderer.name]
    half = next((one for one in own if (one.rung.knob, one.rung.value) == ("resolution", "1/2")), None)
    share, halving = UNPRICED_PIXELS, None
    if half is not None and math.isfinite(half.ratio):
        share = min(max((1 - half.ratio) / (1 - 0.5**2), 0.0), 1.0)
        halving = max(squared(half.psnr) - squared(baseline.psnr), 0.0)
    steps = [
        Shortcut(
            choices=choices,
            kept=kept,
            scale=scale,
            ms=baseline.ms * ratio * (1 - share + share * scale**2),
            error=error + (halving or 0.0) * (1 / scale - 1),
        )
        for choices, kept, ratio, error in _alternatives(baseline, own)
        for scale in (SCALES if halving is not None else SCALES[:1])
    ]
    return best_of(steps if halving is not None else [*steps, *unpriced(baseline.ms)[1:]])


Alternative = tuple[tuple[tuple[str, str], ...], float, float, float]
"""Choices, share of the splats, time by the baseline's, mean squared error."""


def _alternatives(baseline: Measured, own: Sequence[Measured]) -> list[Alternative]:
    """The baseline, each rung with one knob turned, and between the shares of splats that were measured
    others: time goes with the share, and the error's logarithm too."""
    found: list[Alternative] = [((), 1.0, 1.0, squared(baseline.psnr))]
    shares = {1.0: (1.0, squared(baseline.psnr))}
    for one in own:
        if one is baseline or not math.isfinite(one.ratio) or one.rung.knob in WHOLE:
            continue
        if one.rung.knob == "keep":
            shares[one.rung.plan.kept] = (one.ratio, squared(one.psnr))
        else:
            found.append((((one.rung.knob, one.rung.value),), 1.0, one.ratio, squared(one.psnr)))
    measured = sorted(shares)
    ratios, errors = zip(*(shares[share] for share in measured), strict=True)
    between = [share for share in SHARES if share > measured[0]]
    for share in sorted({*measured[:-1], *between}):
        log_error = np.interp(share, measured, np.log(np.maximum(errors, LEAST_ERROR)))
        found.append(((), share, float(np.interp(share, measured, ratios)), float(np.exp(log_error))))
    return found


WHOLE = ("renderer", "resolution")
"""Rungs that are no knob of their own here."""


def unpriced(milliseconds: float) -> tuple[Shortcut, ...]:
    """Fewer pixels only, from what a full frame takes: good enough until prices are known."""
    return tuple(
        Shortcut(
            choices=(),
            scale=scale,
            ms=milliseconds * (1 - UNPRICED_PIXELS + UNPRICED_PIXELS * scale**2),
            error=None if scale < 1 else 0.0,
        )
        for scale in SCALES
    )


def best_of(steps: Sequence[Shortcut]) -> tuple[Shortcut, ...]:
    """Those that no other beats in time and error both, slowest first."""
    best: list[Shortcut] = []
    for step in sorted(steps, key=lambda one: (one.ms, badness(one))):
        if not best or badness(step) < badness(best[-1]):
            best.append(step)
    return tuple(reversed(best))


def badness(step: Shortcut) -> float:
    """Mean squared error; where it is not measured, worse than any, and the more so the fewer the pixels."""
    return step.error if step.error is not None else 1 / step.scale


def squared(psnr: float) -> float:
    """Mean squared error of so many dB."""
    return 10 ** (-psnr / 10)
