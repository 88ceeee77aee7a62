"""Rungs of the ladder: ways to draw, what is measured of each, and what may be said of two of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ..scene import Camera
from .knobs import KNOBS, Knob, Plan, Value


class Artist(Protocol):
    """A renderer with a scene, handed in: this package knows none."""

    name: str

    def prepare(self, camera: Camera, plan: Plan) -> None:
        """What must be there before `camera` is drawn, such as the scene stored in the plan's way: no part of
        a frame's time."""
        ...

    def draw(self, camera: Camera, plan: Plan) -> np.ndarray:
        """The picture (H, W, 4) float32; never one that was kept from an earlier call. Where it depends on
        those before, by the path of `paths`."""
        ...

    def follow(self, camera: Camera, plan: Plan) -> np.ndarray:
        """The picture of a camera that has moved on a little since the last `draw`, drawn as the frame in
        which that shows most."""
        ...

    def memory(self, plan: Plan) -> int:
        """Bytes that scene and picture take in this renderer."""
        ...


@runtime_checkable
class ChoosyArtist(Protocol):
    """One whose machine may lack what some of its renderer's knobs need."""

    def can_draw(self, plan: Plan) -> bool:
        """Whether there is a picture by `plan` at all."""
        ...


@runtime_checkable
class TimedArtist(Protocol):
    """One that knows better than a clock around `draw` what a frame takes: it has to wait for its turn."""

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
    rank: int = 0
    """Where time is short, rungs of a higher rank are left out first."""


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
    noise: float = math.inf
    """How far `ratio` may be off by chance, as a share of it: `noise.noise_of` its pairs."""
    pareto: bool = False
    """On the front, by `mark_front`."""

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


def is_clear(one: Measured) -> bool:
    """Whether it may be said that a rung takes another time than the baseline: the ratio is out of the
    noise, and three quarters of its own pairs agree on the side."""
    if not abs(one.ratio - 1) > one.noise:
        return False
    low, high = np.percentile(one.ratios, [25, 75])
    return bool(low > 1 or high < 1)


def is_faster(one: Measured, other: Measured) -> bool:
    """Whether it may be said that `one` takes less time than `other`: their ratios to the baseline are
    farther apart than the noise of both together."""
    return math.log(other.ratio / one.ratio) > math.log1p(math.hypot(one.noise, other.noise))


def mark_front(measured: Sequence[Measured]) -> None:
    """Sets `pareto`: the most accurate rung is on the front, and after it every one that is faster than all
    rungs on the front before it, by more than the noise.

    So nothing is both faster and nearer to the truth than a rung on the front, and no two of them are equally
    fast as far as can be told. Time is the ratio to the baseline's frames beside it: medians of times that
    were taken at different moments compare the moments.
    """
    front: list[Measured] = []
    for one in measured:
        one.pareto = False
    known = [one for one in measured if one.ratio > 0 and not math.isnan(one.psnr)]
    for one in sorted(known, key=lambda each: (-each.psnr, each.ratio)):
        if all(is_faster(one, better) for better in front):
            one.pareto = True
            front.append(one)


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
    """Pairs of the baseline with itself; costly rungs have fewer pairs, and more noise."""
    complete: bool
    """False where it was cancelled: what there is was measured, with fewer rounds."""
    left_out: tuple[Rung, ...] = ()
    """Those for which there was no time, and..."""
    needed: float = 0.0
    """... about how many seconds would have been enough for all."""


def rungs_for(
    artists: Sequence[Artist], plan: Plan, *, used_sh_degree: int, knobs: Sequence[str] | None = None
) -> list[Rung]:
    """Each renderer with its defaults, and with each value of each knob that it has and that differs.

    The first is the baseline. `knobs`: names of those wanted; None: all.
    """
    rungs = []
    for artist in artists:
        options = ("--renderer", artist.name)
        first = artist is artists[0]
        rungs.append(
            Rung(
                knob="renderer",
                value=artist.name,
                artist=artist,
                plan=plan,
                options=options,
                rank=0 if first else 2,
            )
        )
        for knob in KNOBS:
            if knobs is not None and knob.name not in knobs:
                continue
            for value in knob.values_for(artist.name):
                changed = value.apply(plan)
                degree = changed.settings.sh_degree
                if knob.name == "sh-degree" and (degree is None or degree >= used_sh_degree):
                    continue
                able = not isinstance(artist, ChoosyArtist) or artist.can_draw(changed)
                if able and changed != plan:
                    rungs.append(
                        Rung(
                            knob=knob.name,
                            value=value.text,
                            artist=artist,
                            plan=changed,
                            options=(*options, knob.option, value.text),
                            rank=_rank(knob, value, artists[0].name, first=first),
                        )
                    )
    return rungs


def _rank(knob: Knob, value: Value, baseline: str, *, first: bool) -> int:
    """Before all: knobs of the first renderer, of these first fewer pixels and fewer splats, which frame
    budgets need; then others' defaults (2). Of the others what the first does not have tells most, then the
    ends of the knobs."""
    if value.dear:
        return 3 if first else 6
    if first:
        return 0 if knob.name in ("resolution", "keep") else 1
    if value not in knob.values_for(baseline):
        return 4
    return 5 if value is knob.values[-1] else 6
