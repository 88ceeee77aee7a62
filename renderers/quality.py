"""What a picture may leave out while the camera moves: fewer pixels, fewer splats, each at a known price.

A scene that takes too long is merged into ever fewer splats (`scene.merging`), and every level is drawn
once, so that its time and its error are measured on this scene, from this view, on this machine. What is
learnt while moving is one number: by how much pictures take longer there than when they were priced.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from splatview.measure.governor import Governor
from splatview.renderers.request import FrameRequest, FrameStats, Renderer
from splatview.scene import Gaussians
from splatview.scene.gaussians import concatenate
from splatview.scene.lod import chances, levels_and_cells

# ---- Scenes between two levels of merging: some parts of the finer one, the others of the coarser.


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


MOVING_MS = 36.0
"""What a picture may take while the camera moves. With the window's own work that is over 20 a second."""

SCALES = tuple(2 ** (-k / 8) for k in range(17))
"""Of the picture's sides, that are used; below a quarter nothing can be recognised. Times of neighbours are
at most 16 % apart: one of them is near any budget that lies between."""

UNPRICED_SCALE = 0.5
"""Before prices are known."""

MOST_BYTES = 256 << 20
"""Of a level: larger ones would cost more memory than their time is worth."""

PROMPTNESS = 0.3
"""The share of the latest picture in what is learnt: a single late one changes nothing."""

SLACK = 1.25
"""A shortcut is kept until a coarser one is so much overdue or a finer one so easily afforded: pictures
that changed their sharpness with every measurement would be seen to flicker."""

FINE_STEP = 1.1
"""Time of one mixture of levels to the next."""

SAME_WORK = 1.5
"""Prices hold for views that differ by less than this in the splats and pixels drawn."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Shortcut:
    """One way to draw in less time."""

    gaussians: Gaussians
    """What is drawn; of a mixture the finer level."""
    share: float
    """Splats, of the scene's."""
    scale: float
    """Of the picture's sides."""
    ms: float
    error: float
    """Mean squared error of colours, 0 to 1 being black to white."""
    mixer: Mixer | None = None
    merged: float = 0.0
    """Of a mixture, the share that is of the coarser level."""

    @property
    def scene(self) -> Gaussians:
        """What is drawn, made where it is a mixture that is not there."""
        return self.gaussians if self.mixer is None else self.mixer.scene(self.merged)

    @property
    def exact(self) -> bool:
        return self.share == 1 and self.scale == 1

    @property
    def note(self) -> str:
        """For the user: "71 % of the size, 29 % of the splats, about 35 dB"."""
        parts = []
        if self.scale < 1:
            parts.append(f"{self.scale:.0%} of the size")
        if self.share < 1:
            parts.append(f"{self.share:.0%} of the splats")
        if self.error > 0:
            parts.append(f"about {-10 * np.log10(self.error):.0f} dB")
        return ", ".join(parts)


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
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


@dataclass(frozen=True, eq=False)
class Level:
    """One of ever coarser scenes."""

    gaussians: Gaussians
    mixer: Mixer | None = None
    """Of the level before and this one, if this one was made of it."""


def price(
    levels: tuple[Level, ...], request: FrameRequest, renderer: Renderer, stop: Callable[[], bool]
) -> Plan | None:
    """Draws every level twice, in full and in half size; None where `stop()` became true."""
    full_picture: np.ndarray | None = None
    halving = 0.0
    work = (0, 0)
    shortcuts: list[Shortcut] = []
    whole: list[Shortcut] = []
    """Of each level, in full size."""
    for each in levels:
        level = each.gaussians
        if stop():
            return None
        full = replace(request, gaussians=level)
        picture, stats = drawn(renderer, full)
        if stop():
            return None
        half_picture, half = drawn(renderer, replace(full, resolution=0.5 * full.resolution))
        if full_picture is None:
            full_picture, work = picture, (stats.visible, stats.pixel_splats)
            halving = squared_error(doubled(half_picture), picture)
        full_ms = stats.milliseconds
        of_pixels = max(full_ms - half.milliseconds, 0.0) / (1 - 0.5**2)
        merging = 0.0 if each is levels[0] else squared_error(picture, full_picture)
        shortcuts += [
            Shortcut(
                gaussians=level,
                share=len(level) / max(len(levels[0].gaussians), 1),
                scale=scale,
                ms=max(full_ms - of_pixels, 0.0) + of_pixels * scale**2,
                # Blur grows with the size of pixels: none at 1, what was measured at 1/2.
                error=merging + halving * (1 / scale - 1),
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
    return Plan(
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
                share=finer.share + merged * (coarser.share - finer.share),
                scale=1.0,
                ms=ms,
                error=finer.error + merged * (coarser.error - finer.error),
                mixer=mixer,
                merged=merged,
            )
        )
    return mixtures


def best_of(shortcuts: list[Shortcut]) -> tuple[Shortcut, ...]:
    """Those that no other beats in time and error both, slowest first."""
    best: list[Shortcut] = []
    for shortcut in sorted(shortcuts, key=lambda one: (one.ms, one.error)):
        if not best or shortcut.error < best[-1].error:
            best.append(shortcut)
    return tuple(reversed(best))


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


class Pace:
    """Chooses the shortcut that the time allows, from what moving pictures were seen to take."""

    def __init__(self) -> None:
        self.plan: Plan | None = None
        self.shortcut: Shortcut | None = None
        self.budget_ms: float | None = None
        """What a picture may take, where the user has said so; None: MOVING_MS."""
        self._slowness = 1.0
        self._governor: Governor[Shortcut] = Governor(MOVING_MS)

    def follow(self, plan: Plan | None) -> None:
        """Prices have become known, or no longer hold. How slow the machine is stays known."""
        self.plan, self.shortcut = plan, None
        self._choose()

    def learn(self, shortcut: Shortcut, milliseconds: float) -> None:
        """A moving picture by `shortcut` took so long."""
        if shortcut.ms > 0 and self.plan is not None and shortcut in (*self.plan.shortcuts, *self.plan.fine):
            ratio = milliseconds / shortcut.ms
            self._slowness += PROMPTNESS * (ratio - self._slowness)
            if self.budget_ms is not None:
                self._governed(self.plan, self.budget_ms).learn(shortcut, milliseconds)
            self._choose()

    def _choose(self) -> None:
        if self.plan is None:
            return
        if self.budget_ms is not None:
            self.shortcut = self._governed(self.plan, self.budget_ms).step
            return
        shortcuts, allowed = self.plan.shortcuts, MOVING_MS / self._slowness
        best = next((one for one in shortcuts if one.ms <= allowed), shortcuts[-1])
        now = self.shortcut
        if now is not None:
            coarser_in_haste = best.ms < now.ms <= SLACK * allowed
            finer_in_haste = best.ms > now.ms and best.ms > allowed / SLACK
            best = now if coarser_in_haste or finer_in_haste else best
        self.shortcut = best

    def hold(self, budget_ms: float | None) -> None:
        """The user has set a budget, or given it up."""
        if budget_ms != self.budget_ms:
            self.budget_ms, self.shortcut = budget_ms, None
            self._choose()

    def _governed(self, plan: Plan, budget_ms: float) -> Governor[Shortcut]:
        governor = self._governor
        steps = plan.fine or plan.shortcuts
        if governor.steps != steps:
            governor.follow(steps)
        governor.set_budget(budget_ms)
        return governor
