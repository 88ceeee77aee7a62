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
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Protocol

import numpy as np

from splatview.measure.knobs import KNOBS, Knob, Plan, Value, path_to_view
from splatview.measure.metrics import largest_error, psnr, ssim
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.background import background_colours
from splatview.scene.projection import project
from splatview.scene.reference import composite, splats_reaching

# ---- Rungs of the ladder: ways to draw, what is measured of each, and what may be said of two of them.


class SceneRenderer(Protocol):
    """One scene in one renderer, handed in: this package knows none."""

    name: str

    def supports(self, plan: Plan) -> bool:
        """Whether this machine can draw by `plan` at all."""
        ...

    def turned(self, camera: Camera, degrees: float) -> Camera:
        """The camera `degrees` farther on its way, for pictures that depend on those before."""
        ...

    def prepare(self, plan: Plan) -> None:
        """Makes what must be there before a frame is timed, such as the scene stored in the plan's way."""
        ...

    def draw(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        """Picture (H, W, 4) float32, never one kept from an earlier call, and the milliseconds up to its
        pixels in memory. `anew`: in an order of its own, though the settings let an older one serve."""
        ...

    def memory(self) -> int:
        """Bytes that scene and latest picture take in this renderer."""
        ...


def draw_by_path(renderer: SceneRenderer, camera: Camera, plan: Plan) -> tuple[np.ndarray, float]:
    """The picture at the end of the path of `path_to_view`, and a frame's milliseconds, the path's mean."""
    path = [
        renderer.turned(camera, degrees) if degrees else camera for degrees in path_to_view(plan.settings)
    ]
    drawn = [renderer.draw(each, plan, anew=len(path) > 1 and each is path[0]) for each in path]
    return drawn[-1][0], float(np.mean([milliseconds for _, milliseconds in drawn]))


@dataclass(frozen=True, kw_only=True)
class Rung:
    """One way to draw."""

    knob: str
    """Name of the knob that differs from the renderer's own defaults, "renderer" for none."""
    value: str
    renderer: SceneRenderer
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
    elsewhere: list[float] = field(default_factory=list)
    """dB in other views, against the baseline's picture there."""
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


def is_faster(one: Measured, other: Measured, claims: int) -> bool:
    """Whether it may be said that `one` takes less time than `other`, and `claims` such things without one
    being wrong, 19 times out of 20: their ratios to the baseline are farther apart than the noise of both
    together, and three quarters of the pairs of each agree."""
    certainty = NormalDist().inv_cdf(1 - 0.025 / claims) / NormalDist().inv_cdf(1 - 0.025)
    if not math.log(other.ratio / one.ratio) > math.log1p(certainty * math.hypot(one.noise, other.noise)):
        return False
    agree = np.percentile(one.ratios, 75) < other.ratio and one.ratio < np.percentile(other.ratios, 25)
    return bool(agree)


def mark_front(measured: Sequence[Measured]) -> None:
    """Sets `pareto`: the most accurate rung is on the front, and after it every one that is faster than all
    rungs on the front before it, by more than the noise. Of many rungs some are fast by chance: the noise
    counts as that of all comparisons together.

    So nothing is both faster and nearer to the truth than a rung on the front, and no two of them are equally
    fast as far as can be told. Time is the ratio to the baseline's frames beside it: medians of times that
    were taken at different moments compare the moments.
    """
    front: list[Measured] = []
    for one in measured:
        one.pareto = False
    known = [one for one in measured if one.ratio > 0 and not math.isnan(one.psnr)]
    for one in sorted(known, key=lambda each: (-each.psnr, each.ratio)):
        if all(is_faster(one, better, len(known)) for better in front):
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
    renderers: Sequence[SceneRenderer], plan: Plan, *, used_sh_degree: int, knobs: Sequence[str] | None = None
) -> list[Rung]:
    """Each renderer with its defaults, and with each value of each knob that it has and that differs.

    The first is the baseline. `knobs`: names of those wanted; None: all.
    """
    rungs = []
    for renderer in renderers:
        options = ("--renderer", renderer.name)
        first = renderer is renderers[0]
        rungs.append(
            Rung(
                knob="renderer",
                value=renderer.name,
                renderer=renderer,
                plan=plan,
                options=options,
                rank=0 if first else 2,
            )
        )
        for knob in KNOBS:
            if knobs is not None and knob.name not in knobs:
                continue
            for value in knob.values_for(renderer.name):
                changed = value.apply(plan)
                degree = changed.settings.sh_degree
                if knob.name == "sh-degree" and (degree is None or degree >= used_sh_degree):
                    continue
                if changed != plan and renderer.supports(changed):
                    rungs.append(
                        Rung(
                            knob=knob.name,
                            value=value.text,
                            renderer=renderer,
                            plan=changed,
                            options=(*options, knob.option, value.text),
                            rank=_rank(knob, value, renderers[0].name, first=first),
                        )
                    )
    return rungs


def _rank(knob: Knob, value: Value, baseline: str, *, first: bool) -> int:
    """Before all: knobs of the first renderer, of these first fewer pixels and fewer splats, which frame
    budgets need; then others' defaults (2). Of the others what the first does not have tells most, then the
    ends of the knobs."""
    if value.expensive:
        return 3 if first else 6
    if first:
        return 0 if knob.name in ("resolution", "keep") else 1
    if value not in knob.values_for(baseline):
        return 4
    return 5 if value is knob.values[-1] else 6


# ---- How far a measured ratio of times may be off by chance.


LEAST_PAIRS = 3
"""Fewer tell nothing of a scatter."""

WIDTH = 1.96 * 1.2533
"""Of standard deviations: a median scatters 1.25 times as much as a mean."""

LEAST_NOISE = 0.01
"""No one should read more into times of a shared machine."""


def noise_floor(ratios: Sequence[float], pairs: int | None = None) -> float:
    """Half width of the interval in which the median of so many equal pairs lies 19 times out of 20, as a
    share of the median.

    `pairs`: of how many pairs the median is; None: of `ratios`, which the scatter is taken from. It is
    WIDTH·sd/sqrt(n), sd from the quartiles so that one stall does not decide. Never below LEAST_NOISE. inf
    where there are too few pairs to tell.
    """
    pairs = len(ratios) if pairs is None else pairs
    if min(len(ratios), pairs) < LEAST_PAIRS:
        return math.inf
    low, middle, high = np.percentile(ratios, [25, 50, 75])
    deviation = (high - low) / 1.349 / middle
    return max(LEAST_NOISE, WIDTH * deviation / math.sqrt(pairs))


def floor_of_self(ratios: Sequence[float]) -> float:
    """The noise floor by `ratios` of something to itself, which should be 1."""
    floor = noise_floor(ratios)
    return max(floor, abs(float(np.median(ratios)) - 1)) if ratios else floor


def noise_of(
    ratios: Sequence[float], selves: Sequence[float], others: Sequence[Sequence[float]] = ()
) -> float:
    """How far the median of `ratios` may be off: by their own scatter, by that of `selves`, ratios of the
    baseline to itself, or by the usual one of `others`, for so many pairs, whichever is more: few pairs may
    be alike by chance."""
    own = max(noise_floor(ratios), noise_floor(selves, len(ratios)), floor_of_self(selves))
    return max(own, WIDTH * usual_deviation(others) / math.sqrt(max(len(ratios), 1)))


def usual_deviation(many: Sequence[Sequence[float]]) -> float:
    """Standard deviation of ratios about their own middle, as a share of it: the median over `many` such
    lists, whose variances are each right on the median even if short; 0 without any."""
    # The median of a chi-squared distribution of k degrees is k(1 - 2/9k)³, by Wilson and Hilferty.
    variances = [
        np.var(np.log(ratios), ddof=1) / (1 - 2 / (9 * (len(ratios) - 1))) ** 3
        for ratios in many
        if len(ratios) >= LEAST_PAIRS
    ]
    return math.sqrt(np.median(variances)) if variances else 0.0


SSIM_SIDE = 11
"""SSIM is undefined on smaller pictures."""

JITTERED = 1
"""Number of the camera that differs least from a view but for 0; timed frames have larger ones."""

UNKNOWN = 8.0
"""Frames of the fastest renderer that one of another is thought to take until it is known: software OpenGL
takes about so many of the CPU's."""

SHARE_FOR_COMPARING = 0.5
"""Of the progress shown: comparing with the truth, before timing."""


class TooExpensive(Exception):
    """There is no time for a rung."""


class Budget:
    """How long the ladder may take, and what is reserved of it."""

    def __init__(self, seconds: float | None):
        self._begun = time.perf_counter()
        self.seconds = seconds
        self.reserved = 0.0
        """Seconds that will be needed for the rungs that were accepted."""
        self.frame: dict[str, float] = {}
        """Seconds of a frame, by renderer, with its defaults."""

    @property
    def spent(self) -> float:
        return time.perf_counter() - self._begun

    def reaches(self, more: float) -> bool:
        return self.seconds is None or self.spent + self.reserved + more <= self.seconds


def run_ladder(
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
        share = min(SHARE_FOR_COMPARING, budget.spent / seconds)
        on_progress(share, f"{rung.renderer.name}, {rung.knob} {rung.value}: against the truth")
        try:
            compared = _compared_within(budget, rung, rungs[0], views, truths, moved)
        except TooExpensive:
            left_out.append(rung)
        else:
            measured[id(rung)] = compared
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
        mates = [other.ratios for other in timed if other.rung.renderer is one.rung.renderer]
        one.noise = noise_of(one.ratios, itself.ratios, mates)
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
    frame = budget.frame.get(rung.renderer.name, UNKNOWN * base)
    return (views + 1) * frame + LEAST_PAIRS * (frame + base)


def _compared_within(
    budget: Budget,
    rung: Rung,
    first: Rung,
    views: Sequence[Camera],
    truths: Sequence[np.ndarray],
    moved: Callable[[int, int], Camera],
) -> Measured:
    """Raises TooExpensive as soon as it is known that there is no time for it."""
    base = budget.frame.get(first.renderer.name, 0.0)
    frames: list[float] = []

    def took(frame: float, left: int) -> None:
        frames.append(frame)
        best = min(frames)  # the first may have waited for a compiler
        # A second frame is worth its time where it decides.
        decided = len(frames) > 1 or not budget.reaches(2 * best)
        if rung is not first and decided and not budget.reaches(left * best + LEAST_PAIRS * (best + base)):
            raise TooExpensive

    if rung is not first and not budget.reaches(_price(budget, rung, len(views))):
        raise TooExpensive
    one = Measured(rung=rung)
    compare(one, views, truths, moved(0, JITTERED), took)
    frame = min(frames)
    if rung.knob == "renderer":
        budget.frame[rung.renderer.name] = frame
    budget.reserved += LEAST_PAIRS * (frame + (base or frame))
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
            _drop_most_expensive(timed, spent, budget, (LEAST_PAIRS - done) / done)
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
            name = f"{one.rung.renderer.name}, {one.rung.knob} {one.rung.value}"
            on_progress(min(share, 0.99), f"{name}: {ms[id(one)]:.0f} ms")
        done += 1
    return True


def _drop_most_expensive(timed: list[Measured], spent: dict[int, float], budget: Budget, more: float) -> None:
    """Takes rungs out of `timed`, those of highest rank first and of these the costliest, until `more` times
    what was spent on the others is within the budget."""
    left = (budget.seconds or 0.0) - budget.spent
    order = sorted(timed[1:], key=lambda one: (one.rung.rank, spent[id(one)]))
    while order and more * sum(spent[id(one)] for one in timed) > left:
        timed.remove(order.pop())


def compare(
    one: Measured,
    views: Sequence[Camera],
    truths: Sequence[np.ndarray],
    jittered: Camera,
    took: Callable[[float, int], None] = lambda frame, left: None,
) -> None:
    """Draws every view and compares it with the truth; and from `jittered`, a little beside the first, for
    popping. `took` hears the seconds of each frame, and how many are to come."""
    renderer, plan = one.rung.renderer, one.rung.plan
    decibels, similarities, worst = [], [], 0.0
    left = len(views) + 1

    def drawn(camera: Camera, *, anew: bool = False) -> np.ndarray:
        nonlocal left
        renderer.prepare(plan)
        begun = time.perf_counter()
        image, _ = renderer.draw(camera, plan, anew=True) if anew else draw_by_path(renderer, camera, plan)
        left -= 1
        took(time.perf_counter() - begun, left)
        return image

    for number, (camera, truth) in enumerate(zip(views, truths, strict=True)):
        picture = drawn(camera)
        decibels.append(psnr(picture, truth))
        if min(truth.shape[:2]) >= SSIM_SIDE:
            similarities.append(ssim(picture, truth))
        worst = max(worst, largest_error(picture, truth))
        if number == 0:
            one.popping = largest_error(drawn(jittered, anew=True), picture)
    one.psnr, one.max_error = float(np.mean(decibels)), worst
    one.ssim = float(np.mean(similarities)) if similarities else math.nan
    one.memory = renderer.memory()


def timed_draw(rung: Rung, camera: Camera) -> float:
    """Milliseconds of one frame up to its pixels in memory."""
    rung.renderer.prepare(rung.plan)
    return draw_by_path(rung.renderer, camera, rung.plan)[1]


# ---- Whether a fast float64 picture may stand for the truth: compared with `scene.reference` in sampled
# blocks.
#
# The reference takes minutes for a large picture of a large scene. A rasteriser in float64 that agrees with
# it to the last digits in blocks drawn at random may stand in for it, and the agreement is stated.


SIDE = 8
"""px of a block's sides."""

AGREEMENT = 1e-6
"""Pictures farther apart than this are not the same truth; honest ones differ by some 1e-12, and by no
more than a cut's step where an alpha sits on it to the last digit."""


def disagreement(
    picture: np.ndarray,
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings,
    *,
    blocks: int = 24,
    seed: int = 0,
) -> float:
    """The largest difference of any number of `picture` (H, W, 4) float64 from the reference, in `blocks`
    blocks of SIDE² pixels chosen at random. NaN where either is."""
    footprints = project(gaussians, camera, settings, dtype=np.float64)
    shape = camera.height, camera.width, 3
    behind = np.broadcast_to(background_colours(settings.background, camera), shape)
    rng = np.random.default_rng(seed)
    worst = 0.0
    for _ in range(blocks):
        left = int(rng.integers(0, max(1, camera.width - SIDE + 1)))
        top = int(rng.integers(0, max(1, camera.height - SIDE + 1)))
        part = picture[top : top + SIDE, left : left + SIDE]
        x, y = np.meshgrid(
            np.arange(left, left + part.shape[1]) + 0.5, np.arange(top, top + part.shape[0]) + 0.5
        )
        reaching = splats_reaching(footprints, x.min(), x.max(), y.min(), y.max())
        colour, light = composite(footprints, reaching, x.ravel(), y.ravel(), settings)
        colour += light[:, None] * behind[top : top + SIDE, left : left + SIDE].reshape(-1, 3)
        true = np.concatenate([colour, 1 - light[:, None]], axis=1).reshape(part.shape)
        worst = float(np.maximum(worst, np.abs(part - true).max()))
    return worst
