"""Less accurate pictures that take less time: what each leaves out and costs, and which one a budget allows.

While the camera moves, a picture may have fewer pixels, fewer or merged splats, or a knob of the accuracy
ladder turned. What that saves is measured on this scene, from this view, on this machine, and what it costs
from around too, so that a badge is true of other views: by `price` for pictures of the CPU, by the ladder for
those of a GPU. One governor chooses for both; what it
learns while frames go by is one number, by how much everything takes longer now.
"""

from __future__ import annotations

import math
import threading
from collections import OrderedDict, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from weakref import WeakKeyDictionary

import numpy as np

from splatview.measure.ladder import Measured
from splatview.renderers.request import FrameRequest, FrameStats, Renderer
from splatview.scene import Gaussians
from splatview.scene.attribute_formats import Attributes, stored
from splatview.scene.edits import HIDDEN, SceneEdits
from splatview.scene.effects.overrides import all_in_sight
from splatview.scene.framing import views_around
from splatview.scene.gaussians import concatenate
from splatview.scene.lod import chances, levels_and_cells

MOVING_MS = 36.0
"""Milliseconds for a picture while the camera moves, where the user has set no budget. With the window's own
work that is over 20 pictures a second."""

SCALES = tuple(2 ** (-k / 12) for k in range(25))
"""Shares of the picture's sides that are drawn; below a quarter nothing can be recognised. Times of
neighbours are at most 11 % apart, so that one of them is within a tenth of any budget between."""

SHARES = tuple(round(0.05 * k, 2) for k in range(1, 20))
"""Shares of the splats between those that are measured."""

UNPRICED_SCALE = 0.5
"""Scale of the CPU's moving pictures before prices are known."""

UNPRICED_PIXELS = 0.8
"""Share of a frame's time that goes with its pixels, as long as nothing was measured."""

LEAST_ERROR = 1e-14
"""Mean squared error in place of 0 in logarithms: rounding alone makes more."""


@dataclass(frozen=True, kw_only=True)
class Shortcut:
    """One way to draw in less time."""

    choices: tuple[tuple[str, str], ...] = ()
    """Knob and value, as typed."""
    scale: float = 1.0
    """Share of the picture's sides."""
    kept: float = 1.0
    """Share of the splats that is drawn."""
    ms: float
    """Milliseconds of a frame when it was measured."""
    error: float | None
    """Mean squared error of colours, 0 to 1 being black to white, of the worst of `views`; None: not
    measured."""
    views: int = 1
    """From all around, in which the error was measured."""
    gaussians: Gaussians | None = None
    """Merged scene that is drawn, of a mixture the finer level; None: the scene itself, of which those splats
    are kept that contribute most."""
    mixer: Mixer | None = None
    merged: float = 0.0
    """Share of the coarser level in a mixture."""

    @property
    def scene(self) -> Gaussians | None:
        """Merged scene that is drawn, made where it is a mixture that is not there."""
        return self.gaussians if self.mixer is None else self.mixer.scene(self.merged)

    @property
    def is_exact(self) -> bool:
        """Whether it leaves nothing out."""
        return not self.choices and self.scale == 1 and self.kept == 1

    @property
    def note(self) -> str:
        """What it leaves out, for the user: "40 % of the splats, 71 % of the size, about 35 dB at worst in 4
        views"."""
        parts = [f"{name} {text}" for name, text in self.choices]
        if self.kept < 1:
            parts.append(f"{self.kept:.0%} of the splats")
        if self.scale < 1:
            parts.append(f"{self.scale:.0%} of the size")
        if self.error is None:
            parts.append("error not measured")
        elif self.error > 0:
            where = f"at worst in {self.views} views" if self.views > 1 else "in the view measured"
            parts.append(f"about {-10 * math.log10(self.error):.0f} dB {where}")
        return ", ".join(parts)


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


REMEMBERED = 9
"""Frames whose median is what is learnt: it is the median frame that is to take the budget, and on a machine
that others use too, stalls pull a mean far above it."""

SLACK = 1.08
"""A shortcut is kept while it takes the budget by no more than this factor too long or too short: pictures
that changed their sharpness with every frame would be seen to flicker."""

MOVING_SLACK = 1.25
"""The same where there is no budget to fill; then nothing is chosen that takes longer than MOVING_MS."""

REST_FRAMES = 2
"""Frames in which the camera has not moved after which the exact picture is drawn. Not one: a mouse that is
dragged slowly stands still for a frame now and then."""

OVERTAKEN = 2
"""Frames after a change of shortcut whose times may still be of the one before: GPUs report late."""


class Governor:
    """Chooses the shortcut whose frames fill the budget, or are smooth where there is none."""

    def __init__(self, budget_ms: float | None = None):
        self.steps: tuple[Shortcut, ...] = ()
        self.step: Shortcut | None = None
        """In force while the camera moves; None where there is none to choose from."""
        self._ratios: deque[float] = deque(maxlen=REMEMBERED)
        self.set_budget(budget_ms)

    @property
    def slowness(self) -> float:
        """By how much frames take longer than when they were priced."""
        return median(self._ratios) if self._ratios else 1.0

    def follow(self, steps: Sequence[Shortcut]) -> None:
        """Chooses from other shortcuts, slowest first. How slow the machine is stays known."""
        self.steps, self.step = tuple(steps), None
        self.choose()

    def set_budget(self, milliseconds: float | None) -> None:
        """Holds a budget; None: what is smooth."""
        self.budget_ms = milliseconds
        self._target = MOVING_MS if milliseconds is None else milliseconds
        self._slack = MOVING_SLACK if milliseconds is None else SLACK
        self._longest = 1.0 if milliseconds is None else SLACK
        self.step = None
        self.choose()

    def learn(self, step: Shortcut, milliseconds: float) -> None:
        """A frame drawn by `step` took so long."""
        if step.ms > 0 and math.isfinite(milliseconds) and step in self.steps:
            self._ratios.append(milliseconds / step.ms)
            self.choose()

    def choose(self) -> None:
        if not self.steps:
            return
        allowed = self._target / max(self.slowness, 1e-6)
        if self.step is not None and allowed / self._slack <= self.step.ms <= allowed * self._slack:
            return
        fitting = [step for step in self.steps if step.ms <= allowed * self._longest]
        # The nearest to the budget, in ratio; where none fits, the quickest.
        allowed = max(allowed, 1e-9)
        self.step = min(
            fitting, key=lambda step: abs(math.log(max(step.ms, 1e-9) / allowed)), default=self.steps[-1]
        )


class Watch:
    """Frame by frame: which step to draw with, and what its time teaches."""

    def __init__(self, governor: Governor):
        self.governor = governor
        self.still = REST_FRAMES
        """Frames since the camera moved."""
        self._drawn: Shortcut | None = None
        self._since = 0

    def next(self, *, moved: bool) -> Shortcut | None:
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


WHOLE = ("renderer", "resolution")
"""Rungs that are no knob of their own here."""


def worst_error(one: Measured) -> float:
    """Mean squared error in the worst view that it was looked at from."""
    return squared(min([one.psnr, *one.elsewhere]))


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
        halving = max(worst_error(half) - squared(baseline.psnr), 0.0)
    steps = [
        Shortcut(
            choices=choices,
            kept=kept,
            scale=scale,
            ms=baseline.ms * ratio * (1 - share + share * scale**2),
            error=error + (halving or 0.0) * (1 / scale - 1),
            views=1 + min(len(one.elsewhere) for one in own),
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
            shares[one.rung.plan.kept] = (one.ratio, worst_error(one))
        else:
            found.append((((one.rung.knob, one.rung.value),), 1.0, one.ratio, worst_error(one)))
    measured = sorted(shares)
    ratios, errors = zip(*(shares[share] for share in measured), strict=True)
    between = [share for share in SHARES if share > measured[0]]
    for share in sorted({*measured[:-1], *between}):
        log_error = np.interp(share, measured, np.log(np.maximum(errors, LEAST_ERROR)))
        found.append(((), share, float(np.interp(share, measured, ratios)), float(np.exp(log_error))))
    return found


def unpriced(milliseconds: float) -> tuple[Shortcut, ...]:
    """Fewer pixels only, from what a full frame takes: good enough until prices are known."""
    return tuple(
        Shortcut(
            scale=scale,
            ms=milliseconds * (1 - UNPRICED_PIXELS + UNPRICED_PIXELS * scale**2),
            error=None if scale < 1 else 0.0,
        )
        for scale in SCALES
    )


MOST_BYTES = 256 << 20
"""Bytes of a level: larger ones would cost more memory than their time is worth."""

FINE_STEP = 1.1
"""Time of one mixture of levels to the next."""

SAME_WORK = 1.5
"""Prices hold for views that differ by less than this in the splats and pixels drawn."""

MOST_KEPT = 2
"""Mixtures kept at once: the one in force, and the one before, to which a budget often goes back."""


class Mixer:
    """Makes scenes between two levels when they are asked for. For one thread at a time."""

    def __init__(self, finer: Gaussians, coarser: Gaussians, cell: float):
        """`cell`: the side of those in which `finer` was merged to `coarser`."""
        self.finer, self.coarser = finer, coarser
        self._cell = cell
        self._chances: tuple[np.ndarray, np.ndarray] | None = None
        self._made: OrderedDict[float, Gaussians] = OrderedDict()

    def scene(self, merged: float) -> Gaussians:
        """With a share `merged` of the finer one's cubes replaced by what they were merged to."""
        if self._chances is None:
            self._chances = (
                chances(self.finer, self._cell, self.finer),
                chances(self.finer, self._cell, self.coarser),
            )
        if merged not in self._made:
            fine, coarse = self._chances
            parts = [self.finer.take(fine >= merged), self.coarser.take(coarse < merged)]
            self._made[merged] = concatenate(parts)
            while len(self._made) > MOST_KEPT:
                self._made.popitem(last=False)
        self._made.move_to_end(merged)
        return self._made[merged]


@dataclass(frozen=True, eq=False)
class Level:
    """One of ever coarser scenes."""

    gaussians: Gaussians
    mixer: Mixer | None = None
    """Of the level before and this one, if this one was made of it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MovingPlan:
    """What a scene's pictures can be reduced to."""

    gaussians: Gaussians
    levels: tuple[Level, ...]
    """The scene itself first."""
    shortcuts: tuple[Shortcut, ...]
    """Ever quicker; each is the one of least error that takes no longer."""
    fine: tuple[Shortcut, ...] = ()
    """The same with mixtures of levels, so that one of them is within a tenth of any budget in between."""
    work: tuple[int, int]
    """Splats and pixels drawn in the view that was priced."""

    def holds_for(self, work: tuple[int, int]) -> bool:
        pairs = zip(self.work, work, strict=True)
        return all(max(old, new, 1) < SAME_WORK * max(min(old, new), 1) for old, new in pairs)


def make_levels(gaussians: Gaussians, stop: Callable[[], bool]) -> tuple[Level, ...]:
    """The scene and what it merges to, of what fits in memory; fewer levels where `stop()` becomes true."""
    levels = [Level(gaussians)]
    before = gaussians
    for level, cell in levels_and_cells(gaussians):
        if level.nbytes <= MOST_BYTES:
            direct = before is levels[-1].gaussians
            levels.append(Level(level, Mixer(before, level, cell) if direct else None))
        before = level
        if stop():
            break
    return tuple(levels)


def price(
    levels: tuple[Level, ...], request: FrameRequest, renderer: Renderer, stop: Callable[[], bool]
) -> MovingPlan | None:
    """Draws every level twice, in full and in half size, and from around for the worst error; None where
    `stop()` became true."""
    views = [replace(request, camera=camera) for camera in views_around(request.camera, levels[0].gaussians)]
    truths: list[np.ndarray] = []
    halving = 0.0
    work = (0, 0)
    shortcuts: list[Shortcut] = []
    whole: list[Shortcut] = []
    """Of each level, in full size."""
    for each in levels:
        level = each.gaussians
        merging = full_ms = half_ms = 0.0
        for number, view in enumerate(views):
            if stop():
                return None
            full = replace(view, gaussians=level)
            picture, stats = drawn(renderer, full)
            if each is levels[0]:
                truths.append(picture)
            merging = max(merging, squared_error(picture, truths[number]))
            if number > 0 and each is not levels[0]:
                continue
            half_picture, half = drawn(renderer, replace(full, resolution=0.5 * full.resolution))
            if each is levels[0]:
                halving = max(halving, squared_error(doubled(half_picture), picture))
            if number == 0:
                full_ms, half_ms = stats.milliseconds, half.milliseconds
                work = work if any(work) else (stats.visible, stats.pixel_splats)
        of_pixels = max(full_ms - half_ms, 0.0) / (1 - 0.5**2)
        shortcuts += [
            Shortcut(
                gaussians=level,
                kept=len(level) / max(len(levels[0].gaussians), 1),
                scale=scale,
                ms=max(full_ms - of_pixels, 0.0) + of_pixels * scale**2,
                # Blur grows with the size of pixels: none at 1, what was measured at 1/2.
                error=merging + halving * (1 / scale - 1),
                views=len(views),
            )
            for scale in SCALES
        ]
        whole.append(shortcuts[-len(SCALES)])
    mixtures = [
        mixture
        for finer, coarser, level in zip(whole, whole[1:], levels[1:], strict=False)
        if level.mixer is not None
        for mixture in mixtures_of(finer, coarser, level.mixer)
    ]
    return MovingPlan(
        gaussians=levels[0].gaussians,
        levels=levels,
        shortcuts=best_of(shortcuts),
        fine=best_of([*shortcuts, *mixtures]),
        work=work,
    )


def mixtures_of(finer: Shortcut, coarser: Shortcut, mixer: Mixer) -> list[Shortcut]:
    """Between two levels, in steps of time of at most FINE_STEP; time and error go with what is merged."""
    if not finer.ms > coarser.ms > 0:
        return []
    steps = math.ceil(math.log(finer.ms / coarser.ms) / math.log(FINE_STEP))
    mixtures = []
    for step in range(1, steps):
        ms = finer.ms * (coarser.ms / finer.ms) ** (step / steps)
        merged = (finer.ms - ms) / (finer.ms - coarser.ms)
        mixtures.append(
            Shortcut(
                gaussians=finer.gaussians,
                kept=finer.kept + merged * (coarser.kept - finer.kept),
                scale=1.0,
                ms=ms,
                error=badness(finer) + merged * (badness(coarser) - badness(finer)),
                views=coarser.views,
                mixer=mixer,
                merged=merged,
            )
        )
    return mixtures


def drawn(renderer: Renderer, request: FrameRequest) -> tuple[np.ndarray, FrameStats]:
    """RGB (H, W, 3) of the pixels that the request draws, and what drawing them took."""
    renderer.draw(request)
    return renderer.read()[..., :3], renderer.stats(wait=True)


def doubled(image: np.ndarray) -> np.ndarray:
    """(H, W, C) -> (2H, 2W, C), between pixels linearly, as the window shows a smaller picture."""
    for axis in (0, 1):
        before = np.concatenate([image.take([0], axis), image], axis).take(range(image.shape[axis]), axis)
        after = np.concatenate([image, image.take([-1], axis)], axis).take(
            range(1, image.shape[axis] + 1), axis
        )
        pair = np.stack([0.75 * image + 0.25 * before, 0.75 * image + 0.25 * after], axis + 1)
        shape = list(image.shape)
        shape[axis] *= 2
        image = pair.reshape(shape)
    return image


def squared_error(image: np.ndarray, truth: np.ndarray) -> float:
    """Mean over what both have, colours clipped to what a screen shows."""
    height, width = min(len(image), len(truth)), min(image.shape[1], truth.shape[1])
    difference = np.clip(image[:height, :width], 0, 1) - np.clip(truth[:height, :width], 0, 1)
    return float(np.mean(np.square(difference)))


# Scenes with fewer splats, or attributes in fewer bits: made once for each scene.
#
# Splats are kept by measured contribution: the share of the pictures' light that each makes in views from all
# around (`edit.sample_views`), whatever view is drawn in the end. Smaller shares are subsets of larger ones.


class Reduced:
    """The reduced forms of one scene, made when first asked for."""

    def __init__(self) -> None:
        self._ranking: np.ndarray | None = None
        self._being_ranked = threading.Lock()
        self._forms: dict[tuple[float, Attributes], Gaussians] = {}

    def form(self, gaussians: Gaussians, kept: float, attributes: Attributes) -> Gaussians:
        key = kept, attributes
        if key not in self._forms:
            fewer = gaussians if kept >= 1 else gaussians.take(self.most_seen(gaussians, kept))
            self._forms[key] = stored(fewer, attributes)
        return self._forms[key]

    def most_seen(self, gaussians: Gaussians, share: float) -> np.ndarray:
        return np.sort(self.ranking(gaussians)[: kept_count(len(gaussians), share)])

    def ranking(self, gaussians: Gaussians) -> np.ndarray:
        """(N,) indices. From any thread; who comes while it is made waits for it."""
        with self._being_ranked:
            if self._ranking is None:
                self._ranking = ranked_by_contribution(gaussians)
            return self._ranking

    @property
    def is_ranked(self) -> bool:
        return self._ranking is not None


_reduced: WeakKeyDictionary[Gaussians, Reduced] = WeakKeyDictionary()


def reduced(request: FrameRequest) -> FrameRequest:
    """The request for the splats that it keeps, rounded as its attributes are: a scene that is the same
    object whenever it is asked for again."""
    gaussians = request.gaussians
    if gaussians is None or (request.kept >= 1 and request.attributes == "float32"):
        return request
    form = _reduced.setdefault(gaussians, Reduced()).form(gaussians, request.kept, request.attributes)
    return replace(request, gaussians=form, kept=1.0)


def is_ranked(gaussians: Gaussians) -> bool:
    """Whether it is known what a share keeps: finding out takes a second for some 500,000 splats."""
    known = _reduced.get(gaussians)
    return known is not None and known.is_ranked


def rank(gaussians: Gaussians) -> None:
    """Finds it out. For a thread of its own."""
    _reduced.setdefault(gaussians, Reduced()).ranking(gaussians)


def with_rest_hidden(gaussians: Gaussians, kept: float, edits: SceneEdits | None) -> SceneEdits | None:
    """`edits` that hide what a share `kept` of the splats leaves out besides: what is loaded can stay."""
    if kept >= 1:
        return edits
    chosen = _reduced.setdefault(gaussians, Reduced()).most_seen(gaussians, kept)
    rest = np.ones(len(gaussians), bool)
    rest[chosen] = False
    made = edits or SceneEdits(marks=np.zeros(len(gaussians), np.uint32))
    marks = made.marks.copy()
    marks[rest] |= HIDDEN
    return replace(made, marks=marks, flags=made.flags | HIDDEN, changes=())


def kept_count(splats: int, share: float) -> int:
    """How many of `splats` a share is: one at least, if there are any."""
    return min(splats, max(1, round(splats * share)))


def ranked_by_contribution(gaussians: Gaussians) -> np.ndarray:
    """(N,) indices, the splats that make most of the pictures first; of equals the earlier one."""
    if not len(gaussians):
        return np.zeros(0, np.intp)
    # Imported when needed: they compile.
    from splatview.edit.sample_views import sample_cameras
    from splatview.raster.contributions import contributions

    cameras = sample_cameras(gaussians, SceneEdits(marks=np.zeros(len(gaussians), np.uint32)))
    worth = contributions(gaussians, cameras, all_in_sight(gaussians))
    return np.argsort(-np.nan_to_num(worth, nan=0.0), kind="stable")
