"""The frame budget on simulated machines: frames that are late, noisy, slower than when they were priced."""

from __future__ import annotations

import math
from collections import deque
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from splatview.measure.knobs import Plan
from splatview.measure.ladder import Measured, Rung
from splatview.renderers.quality import (
    REST_FRAMES,
    SCALES,
    Governor,
    Shortcut,
    Watch,
    best_of,
    priced,
    unpriced,
)

FULL_MS = 60.0


class Machine:
    """Takes `slowness` times what was measured, with noise, and reports so many frames late."""

    def __init__(self, *, slowness: float = 1.0, noise: float = 0.0, late: int = 0, fixed: float = 0.2):
        self.slowness, self.noise, self.fixed = slowness, noise, fixed
        self._rng = np.random.default_rng(0)
        self._reports: deque[float] = deque([math.nan] * late)
        self.times: list[float] = []

    def draw(self, step: Shortcut | None) -> float:
        """Returns what is reported after this frame."""
        scale = 1.0 if step is None else step.scale
        ms = FULL_MS * self.slowness * (self.fixed + (1 - self.fixed) * scale**2)
        ms *= math.exp(self.noise * self._rng.standard_normal())
        self.times.append(ms)
        self._reports.append(ms)
        return self._reports.popleft()


def fly(watch: Watch, machine: Machine, frames: int) -> list[float]:
    """The times of the second half."""
    machine.times.clear()
    for _ in range(frames):
        report = machine.draw(watch.next(moved=True))
        if not math.isnan(report):
            watch.took(report)
    return machine.times[frames // 2 :]


def watch_for(budget: float, steps: tuple[Shortcut, ...] | None = None) -> Watch:
    governor = Governor(budget)
    governor.follow(unpriced(FULL_MS) if steps is None else steps)
    return Watch(governor)


@pytest.mark.parametrize("budget", [18.0, 25.0, 33.3, 50.0])
@pytest.mark.parametrize(
    "machine",
    [
        {},
        {"noise": 0.15},
        {"slowness": 1.2, "late": 2},
        {"slowness": 0.9, "noise": 0.2, "late": 2},
        {"slowness": 0.95, "fixed": 0.1},
    ],
    ids=["as priced", "noisy", "slower and late", "all of it", "other than thought"],
)
def test_the_median_frame_is_within_a_tenth_of_a_feasible_budget(budget, machine):
    times = fly(watch_for(budget), Machine(**machine), 400)
    assert float(np.median(times)) == pytest.approx(budget, rel=0.10)


def test_what_fits_in_full_is_drawn_in_full():
    watch = watch_for(2 * FULL_MS)
    fly(watch, Machine(noise=0.1), 50)
    assert watch.governor.step is not None and watch.governor.step.scale == 1


def test_an_impossible_budget_takes_the_quickest():
    watch = watch_for(1.0)
    fly(watch, Machine(), 50)
    assert watch.governor.step is watch.governor.steps[-1]


def test_exact_within_two_frames_of_rest_and_coarse_at_once():
    watch = watch_for(20.0)
    assert watch.next(moved=False) is None, "at rest from the beginning"
    assert watch.next(moved=True) is not None
    resting = [watch.next(moved=False) for _ in range(4)]
    assert REST_FRAMES == 2 and resting[1:] == [None] * 3
    assert resting[0] is not None, "a mouse that pauses for one frame does not flicker"
    assert watch.next(moved=True) is not None


def test_a_steady_machine_is_shown_one_sharpness():
    watch, machine = watch_for(30.0), Machine(noise=0.03)
    fly(watch, machine, 100)
    steps = {watch.next(moved=True) for _ in range(1)}
    for _ in range(200):
        watch.took(machine.draw(watch.governor.step))
        steps.add(watch.next(moved=True))
    assert len(steps) <= 3


def test_one_stall_changes_little():
    watch, machine = watch_for(30.0), Machine()
    fly(watch, machine, 100)
    before = watch.governor.step
    assert before is not None
    watch.took(500.0)
    fly(watch, machine, 60)
    assert watch.governor.step is not None
    assert watch.governor.step.scale == pytest.approx(before.scale, rel=0.13)


def test_a_time_that_is_no_number_teaches_nothing():
    governor = Governor(20.0)
    governor.follow(unpriced(FULL_MS))
    assert governor.step is not None
    governor.learn(governor.step, math.nan)
    assert governor.slowness == 1


NOBODY: Any = SimpleNamespace(name="quads")


def rung(knob: str, value: str, ratio: float, psnr: float) -> Measured:
    plan = Plan(kept=int(value) / 100) if knob == "keep" else Plan()
    made = Rung(knob=knob, value=value, renderer=NOBODY, plan=plan, options=())
    return Measured(rung=made, psnr=psnr, times=[FULL_MS * ratio], ratios=[ratio])


def test_steps_are_priced_from_what_was_measured():
    base = rung("renderer", "quads", 1.0, 80.0)
    rungs = (base, rung("sh-degree", "1", 0.5, 50.0), rung("resolution", "1/2", 0.4, 30.0))
    steps = priced(base, rungs)
    assert steps[0].choices == () and steps[0].scale == 1 and steps[0].ms == pytest.approx(FULL_MS)
    times, errors = [step.ms for step in steps], [step.error or 0 for step in steps]
    assert times == sorted(times, reverse=True) and errors == sorted(errors)
    assert any(step.choices == (("sh-degree", "1"),) and step.scale == 1 for step in steps)
    assert min(step.scale for step in steps) == pytest.approx(1 / 4)
    half = next(step for step in steps if abs(step.scale - 0.5) < 1e-9)
    assert half.ms == pytest.approx(0.5 * 0.4 * FULL_MS) and "sh-degree 1, 50% of the size" in half.note
    assert half.note.endswith("about 30 dB in the view measured")


def test_errors_are_those_of_the_worst_view():
    base, coarse, half = (
        rung("renderer", "quads", 1.0, 80.0),
        rung("sh-degree", "1", 0.5, 50.0),
        rung("resolution", "1/2", 0.4, 40.0),
    )
    for one, decibels in ((base, 90.0), (coarse, 33.0), (half, 25.0)):
        one.elsewhere.append(decibels)
    steps = priced(base, (base, coarse, half))
    notes = [step.note for step in steps if step.scale == 1 and step.choices]
    assert notes == ["sh-degree 1, about 33 dB at worst in 2 views"]
    assert all(step.views == 2 for step in steps)


def test_shares_of_splats_between_the_measured_ones_are_steps():
    base = rung("renderer", "quads", 1.0, 90.0)
    rungs = (
        base,
        rung("keep", "75", 0.8, 60.0),
        rung("keep", "25", 0.4, 30.0),
        rung("resolution", "1/2", 0.9, 20.0),
    )
    steps = [step for step in priced(base, rungs) if step.scale == 1]
    shares = [step.kept for step in steps]
    assert shares == [1.0, *(share / 100 for share in range(95, 20, -5))]
    half = steps[shares.index(0.5)]
    assert half.ms == pytest.approx(0.6 * FULL_MS) and half.note.startswith(
        "50% of the splats, about 45 dB in"
    )
    assert steps[-1].ms == pytest.approx(0.4 * FULL_MS) and "about 30 dB" in steps[-1].note
    gaps = [slow.ms / quick.ms for slow, quick in pairwise(steps)]
    assert max(gaps) < 1.11, "one of them is within a tenth of any budget between"


def test_where_time_was_short_fewer_pixels_are_still_there():
    base = rung("renderer", "quads", 1.0, 80.0)
    steps = priced(base, (base, rung("sh-degree", "1", 0.9, 50.0)))
    known = [step.note.removesuffix(" in the view measured") for step in steps[:2]]
    assert known == ["about 80 dB", "sh-degree 1, about 50 dB"]
    rest = steps[2:]
    assert rest and all(step.error is None and not step.choices for step in rest), "none above what is known"
    assert steps[-1].scale == pytest.approx(1 / 4)
    scales = [step.scale for step in rest]
    assert scales == sorted(scales, reverse=True) and max(step.ms for step in rest) < 0.9 * FULL_MS


def test_without_prices_the_badge_says_so():
    steps = unpriced(FULL_MS)
    assert len(steps) == len(SCALES) and steps[0].note == ""
    assert steps[-1].note == "25% of the size, error not measured"


def test_what_is_slower_and_worse_is_left_out():
    good = Shortcut(choices=(), scale=1, ms=5, error=1e-3)
    bad = Shortcut(choices=(("cut", "2-sigma"),), scale=1, ms=6, error=1e-2)
    assert best_of([bad, good]) == (good,)
