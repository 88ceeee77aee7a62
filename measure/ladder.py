"""The accuracy ladder: what each shortcut saves, on this machine, and what it costs, on this scene.

Every rung draws the same views. Its accuracy is measured against a float64 truth; its time beside the
baseline's, a pair at a time and rung after rung in an order that changes, so that a machine that grows
slower or is shared cannot favour one. The baseline is also measured against itself: that is the noise
floor, and below it no claim is made.

The time for all of it is given. Rungs for which it does not suffice are left out, by rank, and named.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

import numpy as np

from ..scene import Camera
from .knobs import Plan
from .metrics import largest_error, psnr, ssim
from .noise import LEAST_PAIRS, floor_of_self, noise_of
from .rungs import Ladder, Measured, Rung, TimedArtist, mark_front

SSIM_SIDE = 11
"""SSIM is undefined on smaller pictures."""

NUDGED = 1
"""Number of the camera that differs least from a view but for 0; timed frames have larger ones."""

UNKNOWN = 8.0
"""Frames of the fastest renderer that one of another is thought to take until it is known: software OpenGL
takes about so many of the CPU's."""

SHARE_FOR_JUDGING = 0.5
"""Of the progress shown: comparing with the truth, before timing."""


class TooDear(Exception):
    """There is no time for a rung."""


class Budget:
    """How long the ladder may take, and what is promised of it."""

    def __init__(self, seconds: float | None):
        self._begun = time.perf_counter()
        self.seconds = seconds
        self.promised = 0.0
        """Seconds that will be needed for the rungs that were accepted."""
        self.frame: dict[str, float] = {}
        """Seconds of a frame, by renderer, with its defaults."""

    @property
    def spent(self) -> float:
        return time.perf_counter() - self._begun

    def reaches(self, more: float) -> bool:
        return self.seconds is None or self.spent + self.promised + more <= self.seconds


def climb(
    rungs: Sequence[Rung],
    views: Sequence[Camera],
    truths: Sequence[np.ndarray],
    *,
    moved: Callable[[int, int], Camera],
    seconds: float,
    rounds: int | None = None,
    on_progress: Callable[[float, str], None] = lambda share, text: None,
    cancelled: Callable[[], bool] = lambda: False,
    seed: int = 0,
) -> Ladder:
    """Measures `rungs`, the first being the baseline.

    `truths`: the true picture (H, W, 4) of each of `views`. `moved(view, n)`: a camera that differs a
    little from view `view`, and from those of other n, so that each timed frame is drawn anew. All is over
    `seconds` after the call, but for a baseline that alone takes longer: rungs that would not get LEAST_PAIRS
    by then are left out. With `rounds` all are measured, with exactly so many pairs.
    """
    budget = Budget(seconds if rounds is None else None)
    measured: dict[int, Measured] = {}
    left_out: list[Rung] = []
    complete = True
    for rung in sorted(rungs, key=lambda each: each.rank):
        if cancelled():
            complete = False
            break
        share = min(SHARE_FOR_JUDGING, budget.spent / seconds)
        on_progress(share, f"{rung.artist.name}, {rung.knob} {rung.value}: against the truth")
        try:
            judged = _judged_within(budget, rung, rungs[0], views, truths, moved)
        except TooDear:
            left_out.append(rung)
        else:
            measured[id(rung)] = judged
    if not measured:  # cancelled before anything was known
        measured[id(rungs[0])] = Measured(rung=rungs[0])
    baseline = measured[id(rungs[0])]
    itself = Measured(rung=baseline.rung)
    timed = [itself, *(one for one in measured.values() if one is not baseline)]
    if complete:
        complete = _time(timed, baseline, views, moved, budget, rounds, on_progress, cancelled, seed)
    for one in list(measured.values()):
        if complete and one not in timed and one is not baseline:
            left_out.append(measured.pop(id(one.rung)).rung)
        one.noise = noise_of(one.ratios, itself.ratios)
    baseline.ratios, baseline.noise = [1.0], 0.0
    mark_front(list(measured.values()))
    return Ladder(
        baseline=baseline,
        rungs=tuple(measured[id(rung)] for rung in rungs if id(rung) in measured),
        noise=floor_of_self(itself.ratios),
        views=len(views),
        rounds=len(itself.ratios),
        complete=complete,
        left_out=tuple(rung for rung in rungs if rung in left_out),
        needed=budget.spent + sum(_price(budget, rung, len(views)) for rung in left_out),
    )


def _price(budget: Budget, rung: Rung, views: int) -> float:
    """Seconds that a rung takes, as far as that is known before: as long as its renderer's defaults."""
    base = min(budget.frame.values(), default=0.0)
    frame = budget.frame.get(rung.artist.name, UNKNOWN * base)
    return (views + 1) * frame + LEAST_PAIRS * (frame + base)


def _judged_within(
    budget: Budget,
    rung: Rung,
    first: Rung,
    views: Sequence[Camera],
    truths: Sequence[np.ndarray],
    moved: Callable[[int, int], Camera],
) -> Measured:
    """Raises TooDear as soon as it is known that there is no time for it."""
    base = budget.frame.get(first.artist.name, 0.0)
    frames: list[float] = []

    def took(frame: float, left: int) -> None:
        frames.append(frame)
        best = min(frames)  # the first may have waited for a compiler
        # A second frame is worth its time where it decides.
        decided = len(frames) > 1 or not budget.reaches(2 * best)
        if rung is not first and decided and not budget.reaches(left * best + LEAST_PAIRS * (best + base)):
            raise TooDear

    if rung is not first and not budget.reaches(_price(budget, rung, len(views))):
        raise TooDear
    one = Measured(rung=rung)
    judge(one, views, truths, moved(0, NUDGED), took)
    frame = min(frames)
    if rung.knob == "renderer":
        budget.frame[rung.artist.name] = frame
    budget.promised += LEAST_PAIRS * (frame + (base or frame))
    return one


def _time(
    timed: list[Measured],
    baseline: Measured,
    views: Sequence[Camera],
    moved: Callable[[int, int], Camera],
    budget: Budget,
    rounds: int | None,
    on_progress: Callable[[float, str], None],
    cancelled: Callable[[], bool],
    seed: int,
) -> bool:
    """Pair after pair of each of `timed` with the baseline; False where it was cancelled.

    Every rung gets LEAST_PAIRS; where pairs take longer than was thought, some are taken out of `timed`
    instead: in the first round, by rank, those that come when the time is gone. After that those take part
    that have had no more than their share of the time, so that costly ones do not take it all.
    """
    rng = np.random.default_rng(seed)
    spent = {id(one): 0.0 for one in timed}
    done = frame = 0
    while rounds is None or done < rounds:
        if rounds is None and 0 < done < LEAST_PAIRS:
            _drop_dearest(timed, spent, budget, (LEAST_PAIRS - done) / done)
        fair = float(np.mean([spent[id(one)] for one in timed]))
        first = rounds is None and done == 0
        turns = list(timed) if first else [timed[place] for place in rng.permutation(len(timed))]
        for place, one in enumerate(turns):
            if first and place > 0:
                pairs = sum(spent.values())
                if budget.spent + (LEAST_PAIRS - 1) * pairs + LEAST_PAIRS * pairs / place > (
                    budget.seconds or math.inf
                ):
                    del timed[place:]
                    break
            view = frame % len(views)
            if budget.seconds is not None and done >= LEAST_PAIRS:
                if budget.spent + spent[id(one)] / len(one.ratios) > budget.seconds:
                    return True
                if spent[id(one)] > fair:
                    continue
            if cancelled():
                return False
            frame += 1
            begun = time.perf_counter()
            # Two frames each: whoever comes second finds the other's camera in no cache of its own.
            pair = [baseline, one] if frame % 2 else [one, baseline]
            ms = {
                id(who): timed_draw(who.rung, moved(view, 2 * frame + turn)) for turn, who in enumerate(pair)
            }
            spent[id(one)] += time.perf_counter() - begun
            one.times.append(ms[id(one)])
            baseline.times.append(ms[id(baseline)])
            one.ratios.append(ms[id(one)] / ms[id(baseline)])
            share = max(budget.spent / budget.seconds, 0.0) if budget.seconds else done / max(rounds or 1, 1)
            name = f"{one.rung.artist.name}, {one.rung.knob} {one.rung.value}"
            on_progress(min(share, 0.99), f"{name}: {ms[id(one)]:.0f} ms")
        done += 1
    return True


def _drop_dearest(timed: list[Measured], spent: dict[int, float], budget: Budget, more: float) -> None:
    """Takes rungs out of `timed`, those of highest rank first and of these the costliest, until `more` times
    what was spent on the others is within the budget."""
    left = (budget.seconds or 0.0) - budget.spent
    order = sorted(timed[1:], key=lambda one: (one.rung.rank, spent[id(one)]))
    while order and more * sum(spent[id(one)] for one in timed) > left:
        timed.remove(order.pop())


def judge(
    one: Measured,
    views: Sequence[Camera],
    truths: Sequence[np.ndarray],
    nudged: Camera,
    took: Callable[[float, int], None] = lambda frame, left: None,
) -> None:
    """Draws every view and compares it with the truth; and from `nudged`, a little beside the first, for
    popping. `took` hears the seconds of each frame, and how many are to come."""
    artist, plan = one.rung.artist, one.rung.plan
    decibels, similarities, worst = [], [], 0.0
    left = len(views) + 1

    def drawn(camera: Camera, draw: Callable[[Camera, Plan], np.ndarray] = artist.draw) -> np.ndarray:
        nonlocal left
        artist.prepare(camera, plan)
        begun = time.perf_counter()
        picture = draw(camera, plan)
        left -= 1
        took(time.perf_counter() - begun, left)
        return picture

    for number, (camera, truth) in enumerate(zip(views, truths, strict=True)):
        picture = drawn(camera)
        decibels.append(psnr(picture, truth))
        if min(truth.shape[:2]) >= SSIM_SIDE:
            similarities.append(ssim(picture, truth))
        worst = max(worst, largest_error(picture, truth))
        if number == 0:
            one.popping = largest_error(drawn(nudged, artist.follow), picture)
    one.psnr, one.max_error = float(np.mean(decibels)), worst
    one.ssim = float(np.mean(similarities)) if similarities else math.nan
    one.memory = artist.memory(plan)


def timed_draw(rung: Rung, camera: Camera) -> float:
    """ms of one frame up to its pixels in memory."""
    rung.artist.prepare(camera, rung.plan)
    if isinstance(rung.artist, TimedArtist):
        return rung.artist.timed(camera, rung.plan)
    begun = time.perf_counter()
    rung.artist.draw(camera, rung.plan)
    return 1e3 * (time.perf_counter() - begun)
