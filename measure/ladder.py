"""The accuracy ladder: what each shortcut saves, on this machine, and what it costs, on this scene.

Every rung draws the same views. Its accuracy is measured against a float64 truth; its time beside the
baseline's, a pair at a time and rung after rung in an order that changes, so that a machine that grows
slower or is shared cannot favour one. The baseline is also measured against itself: that is the noise
floor, and below it no claim is made.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ..scene import Camera
from .knobs import KNOBS, Plan
from .metrics import largest_error, psnr, ssim

SSIM_SIDE = 11
"""SSIM is undefined on smaller pictures."""

LEAST_ROUNDS = 3
"""Pairs a rung at least, so that there is a spread."""

NUDGED = 1
"""Number of the camera that differs least from a view but for 0; timed frames have larger ones."""

SELF = "noise"
"""The rung that is the baseline again."""


class Artist(Protocol):
    """A renderer with a scene, handed in: this package knows none."""

    name: str

    def prepare(self, camera: Camera, plan: Plan) -> None:
        """What must be there before `camera` is drawn, such as the scene stored in the plan's way: no part of
        a frame's time."""
        ...

    def draw(self, camera: Camera, plan: Plan) -> np.ndarray:
        """The picture (H, W, 4) float32; never one that was kept from an earlier call."""
        ...

    def memory(self, plan: Plan) -> int:
        """Bytes that scene and picture take in this renderer."""
        ...


@runtime_checkable
class TimedArtist(Protocol):
    """One that has to wait for its turn, and knows what of the time was its own."""

    def timed(self, camera: Camera, plan: Plan) -> float:
        """ms of a frame up to its pixels in memory."""
        ...


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One way to draw."""

    knob: str
    """Name of the knob that differs from the renderer's own defaults, "renderer" for none."""
    value: str
    artist: Artist
    plan: Plan
    options: tuple[str, ...]
    """What makes `splatview render` draw so."""


@dataclass(kw_only=True)
class Measured:
    """A rung and what is known of it so far."""

    rung: Rung
    psnr: float = math.nan
    """dB, mean over the views; inf where every one is the truth to the bit."""
    ssim: float = math.nan
    max_error: float = math.nan
    """The largest of any pixel, colour and view."""
    popping: float = math.nan
    """The largest change of any pixel and colour when the camera turns a little: splats change places."""
    memory: int = 0
    times: list[float] = field(default_factory=list)
    """ms a frame, and..."""
    ratios: list[float] = field(default_factory=list)
    """... each over that of the baseline's frame beside it."""
    pareto: bool = False
    """No other rung is both as fast and more accurate, or as accurate and faster."""

    @property
    def ms(self) -> float:
        return float(np.median(self.times)) if self.times else math.nan

    @property
    def spread(self) -> tuple[float, float]:
        """Quartiles of the times, ms."""
        if not self.times:
            return math.nan, math.nan
        low, high = np.percentile(self.times, [25, 75])
        return float(low), float(high)

    @property
    def ratio(self) -> float:
        """Of the baseline's time: below 1 is faster."""
        return float(np.median(self.ratios)) if self.ratios else math.nan


def is_clear(one: Measured, noise: float) -> bool:
    """Whether it may be said that a rung takes another time than the baseline: the ratio is out of the
    noise, and three quarters of its own pairs agree on the side."""
    if not abs(one.ratio - 1) > noise:
        return False
    if not one.ratios:
        return False
    low, high = np.percentile(one.ratios, [25, 75])
    return bool(low > 1 or high < 1)


@dataclass(frozen=True, kw_only=True)
class Ladder:
    """The whole measurement."""

    baseline: Measured
    rungs: tuple[Measured, ...]
    """Baseline first."""
    noise: float
    """How far from 1 the baseline's ratio to itself may be found by chance: smaller differences of a ratio
    mean nothing."""
    views: int
    rounds: int
    complete: bool
    """False where it was cancelled: what there is was measured, with fewer rounds."""


def rungs_for(
    artists: Sequence[Artist],
    plan: Plan,
    *,
    used_sh_degree: int,
    knobs: Sequence[str] | None = None,
    first_only: bool = False,
) -> list[Rung]:
    """Each renderer with its defaults, and with each value of each knob that it has and that differs.

    The first is the baseline. `knobs`: names of those wanted; None: all. `first_only`: knobs of the first
    renderer alone.
    """
    rungs = []
    for artist in artists:
        options = ("--renderer", artist.name)
        rungs.append(Rung(knob="renderer", value=artist.name, artist=artist, plan=plan, options=options))
        for knob in KNOBS if artist is artists[0] or not first_only else ():
            if knobs is not None and knob.name not in knobs:
                continue
            for value in knob.values_for(artist.name):
                changed = value.apply(plan)
                degree = changed.settings.sh_degree
                if knob.name == "sh-degree" and (degree is None or degree >= used_sh_degree):
                    continue
                if changed != plan:
                    rungs.append(
                        Rung(
                            knob=knob.name,
                            value=value.text,
                            artist=artist,
                            plan=changed,
                            options=(*options, knob.option, value.text),
                        )
                    )
    return rungs


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
    little from view `view`, and from those of other n, so that each timed frame is drawn anew. Rounds of
    timing go on until `seconds` are over since the call, at least LEAST_ROUNDS (or exactly `rounds`).
    """
    begun = time.perf_counter()
    baseline, *others = (Measured(rung=rung) for rung in rungs)
    itself = Measured(rung=baseline.rung)
    measured = [baseline, *others]
    complete = True
    for number, one in enumerate(measured):
        if cancelled():
            complete = False
            measured = measured[:number]
            break
        on_progress(0.4 * number / len(measured), f"{one.rung.knob} {one.rung.value}: against the truth")
        judge(one, views, truths, [moved(view, NUDGED) for view in range(len(views))])
    timed = [itself, *(one for one in measured if one is not baseline)] if measured else []
    rng = np.random.default_rng(seed)
    done, frame = 0, 0
    while measured and complete and _goes_on(done, rounds, begun, seconds):
        for place in rng.permutation(len(timed)):
            if cancelled():
                complete = False
                break
            one, view = timed[place], frame % len(views)
            frame += 1
            # Two frames each: whoever comes second finds the other's camera in no cache of its own.
            pair = [baseline, one] if frame % 2 else [one, baseline]
            spent = {
                id(who): timed_draw(who.rung, moved(view, 2 * frame + turn)) for turn, who in enumerate(pair)
            }
            one.times.append(spent[id(one)])
            baseline.times.append(spent[id(baseline)])
            one.ratios.append(spent[id(one)] / spent[id(baseline)])
            share = max((time.perf_counter() - begun) / seconds, 0.4) if rounds is None else done / rounds
            on_progress(min(share, 0.99), f"{one.rung.knob} {one.rung.value}: {spent[id(one)]:.0f} ms")
        else:
            done += 1
    baseline.ratios = [1.0]
    mark_pareto(measured)
    return Ladder(
        baseline=baseline,
        rungs=tuple(measured),
        noise=noise_floor(itself.ratios),
        views=len(views),
        rounds=done,
        complete=complete,
    )


def _goes_on(done: int, rounds: int | None, begun: float, seconds: float) -> bool:
    if rounds is not None:
        return done < rounds
    if done < LEAST_ROUNDS:
        return True
    spent = time.perf_counter() - begun
    return spent + spent / (done + 1) / 2 < seconds


def judge(
    one: Measured, views: Sequence[Camera], truths: Sequence[np.ndarray], nudged: Sequence[Camera]
) -> None:
    """Draws every view and compares it with the truth; and from cameras `nudged` a little, for popping."""
    decibels, similarities, worst, popping = [], [], 0.0, 0.0
    for camera, truth, beside in zip(views, truths, nudged, strict=True):
        one.rung.artist.prepare(camera, one.rung.plan)
        picture = one.rung.artist.draw(camera, one.rung.plan)
        decibels.append(psnr(picture, truth))
        if min(truth.shape[:2]) >= SSIM_SIDE:
            similarities.append(ssim(picture, truth))
        worst = max(worst, largest_error(picture, truth))
        one.rung.artist.prepare(beside, one.rung.plan)
        popping = max(popping, largest_error(one.rung.artist.draw(beside, one.rung.plan), picture))
    one.psnr, one.max_error, one.popping = float(np.mean(decibels)), worst, popping
    one.ssim = float(np.mean(similarities)) if similarities else math.nan
    one.memory = one.rung.artist.memory(one.rung.plan)


def timed_draw(rung: Rung, camera: Camera) -> float:
    """ms of one frame up to its pixels in memory."""
    rung.artist.prepare(camera, rung.plan)
    if isinstance(rung.artist, TimedArtist):
        return rung.artist.timed(camera, rung.plan)
    begun = time.perf_counter()
    rung.artist.draw(camera, rung.plan)
    return 1e3 * (time.perf_counter() - begun)


def noise_floor(ratios: Sequence[float]) -> float:
    """Half width of the interval in which the median of so many equal pairs lies 19 times out of 20.

    The median of n ratios scatters 1.25 times as much as a mean: 1.96·1.25·sd/sqrt(n), sd from the
    quartiles so that one stall does not decide. Never below a hundredth: no one should read more into
    times of a shared machine. inf where there are too few pairs to tell.
    """
    if len(ratios) < LEAST_ROUNDS:
        return math.inf
    low, high = np.percentile(ratios, [25, 75])
    deviation = (high - low) / 1.349
    off_centre = abs(float(np.median(ratios)) - 1)
    return max(0.01, 1.96 * 1.2533 * deviation / math.sqrt(len(ratios)), off_centre)


def mark_pareto(measured: Sequence[Measured]) -> None:
    """Sets `pareto` where no other rung has both time and accuracy at least as good and one better.

    Time is the ratio to the baseline's frames beside it: medians of times that were taken at different
    moments compare the moments.
    """
    for one in measured:
        one.pareto = not any(
            other.ratio <= one.ratio
            and other.psnr >= one.psnr
            and (other.ratio < one.ratio or other.psnr > one.psnr)
            for other in measured
            if other is not one
        )
