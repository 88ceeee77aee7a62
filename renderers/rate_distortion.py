"""The smallest file of a quality, or the best picture in a size: a search over what a format can vary.

A file gets smaller by coarser numbers (what `Format.knobs` names), fewer SH bands, and fewer splats. Errors
of independent roundings add up as squares, and a file's parts are packed one by one, so both are measured
for each knob alone, on few views; the best combination of those curves is then written, read back and
measured on all views, and what it shows the predictions to be off by corrects the next one. Splats are left
out by what they contribute to views that the quality is not measured on.
"""

from __future__ import annotations

import copy
import itertools
import math
import re
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatview import raster
from splatview.edit.document import Document
from splatview.edit.sample_views import sample_cameras
from splatview.raster.contributions import contributions
from splatview.scene import Camera, Gaussians, InputError, look_at
from splatview.scene.effects.overrides import all_in_sight
from splatview.scene.errors import bytes_in_words, parse_bytes
from splatview.scene.formats import FORMATS, Format, load_scene, save_scene, stored_bytes, trial_path
from splatview.scene.framing import WORLD_UP, robust_bounds
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.progress import NO_PROGRESS, Progress


def size_in_words(size: int) -> str:
    """As `bytes_in_words`, with small ones in bytes."""
    return f"{size:,} bytes" if size < 10240 else bytes_in_words(size)


@dataclass(frozen=True, kw_only=True)
class Target:
    """What a file is to reach: one of the two."""

    psnr: float | None = None
    """dB at least."""
    bytes: int | None = None
    """At most."""

    @property
    def in_words(self) -> str:
        return f"{self.psnr:g} dB" if self.psnr is not None else size_in_words(self.bytes or 0)


def parse_target(text: str) -> Target:
    """``40dB``, ``5 MB``, ``800kB``, ``1.5MiB``. Raises InputError."""
    found = re.fullmatch(r"\s*(\d+(?:\.\d*)?|\.\d+)\s*db\s*", text, re.IGNORECASE)
    if found and 0 < float(found[1]) <= 200:
        return Target(psnr=float(found[1]))
    if (size := parse_bytes(text)) is not None:
        return Target(bytes=size)
    raise InputError(f"{text!r} is no target: give a quality such as 40dB or a size such as 5MB or 800kB")


CURVE_VIEWS = 2
"""Of the views, those that each knob alone is measured on: one from afar, one from near."""

RANKED_VIEWS = 18
"""Views that tell what each splat contributes; none of them is measured on."""

RANKED_SIZE = 256
"""Width and height of those, px."""

INSIDE = 0.01
"""Weight of contributions to views from the middle outwards, which decide among splats that are seen from
there alone."""

KEPT = (1.0, 0.97, 0.94, 0.9, 0.85, 0.8, 0.7, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1, 0.05, 0.02, 0.01)
"""Shares of the splats at which pruning is measured."""

ROUNDS = 7
"""Files written at most to correct the predictions."""

CLOSE = 0.98
"""A file of more than this share of the size, or of the squared error (0.09 dB), that is allowed is taken."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """One file of a scene."""

    kept: float = 1.0
    """Share of the splats."""
    sh_degree: int
    knobs: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class Trial:
    """What came of writing and reading back a choice."""

    choice: Choice
    number: int
    file: Path
    bytes: int
    splats: int
    error: float
    """Mean squared, of colours in [0, 1]."""
    largest: float

    @property
    def psnr(self) -> float:
        return decibels(self.error)


def decibels(error: float) -> float:
    return math.inf if error == 0 else -10 * math.log10(error)


class Judge:
    """How far pictures of a scene are from those of `gaussians`, drawn once."""

    def __init__(self, gaussians: Gaussians, cameras: Sequence[Camera]) -> None:
        self.cameras = list(cameras)
        self._pictures = [picture_of(gaussians, camera) for camera in self.cameras]

    def of_first(self, count: int) -> Judge:
        """The judge of the first `count` views."""
        fewer = copy.copy(self)
        fewer.cameras, fewer._pictures = self.cameras[:count], self._pictures[:count]
        return fewer

    def error(self, gaussians: Gaussians, progress: Progress = NO_PROGRESS) -> tuple[float, float]:
        """Mean squared and largest error over all pixels."""
        squares, largest = [0.0], 0.0
        for done, (camera, wanted) in enumerate(zip(self.cameras, self._pictures, strict=True)):
            progress.step(done / len(self.cameras))
            difference = np.abs(wanted - picture_of(gaussians, camera))
            squares.append(float(np.square(difference, dtype=np.float64).mean()))
            largest = max(largest, float(difference.max(initial=0.0)))
        mean = sum(squares) / max(len(self.cameras), 1)
        return (mean if math.isfinite(mean) else math.inf), largest


def picture_of(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """(H, W, 3) float32 in [0, 1], drawn as the scene's own tags say, but for a near plane."""
    return np.clip(raster.render(gaussians, camera, all_in_sight(gaussians))[..., :3], 0, 1)


def with_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """The scene without SH bands above `degree`."""
    if degree >= gaussians.sh_degree:
        return gaussians
    return replace(gaussians, sh=np.ascontiguousarray(gaussians.sh[:, : SH_COEFFICIENTS[degree]]))


def ranking(gaussians: Gaussians, progress: Progress, *, skipped: int) -> np.ndarray:
    """(N,) indices, those first that contribute most to sample views beyond the `skipped` first ones.

    Half of the splats of train-1000.ply kept so give 42.0 dB, by opacity times area 39.0, by opacity 40.3.
    """
    if not len(gaussians):
        return np.zeros(0, np.int64)
    edits = Document(gaussians).edits
    outside = sample_cameras(gaussians, edits, skipped + RANKED_VIEWS, size=RANKED_SIZE)[skipped:]
    settings, score = all_in_sight(gaussians), np.zeros(len(gaussians))
    inside = _from_within(gaussians)
    for done, camera in enumerate((*outside, *inside)):
        progress.step(done / (len(outside) + len(inside)))
        weight = 1.0 if done < len(outside) else INSIDE
        score += weight * contributions(gaussians, [camera], settings)
    # Of those that no view sees, the large and opaque ones are kept longest.
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.nan_to_num(gaussians.log_scales.sum(axis=1) + np.minimum(gaussians.opacity_logits, 0))
    return np.lexsort((-size, -score))


def _from_within(gaussians: Gaussians) -> list[Camera]:
    centre, radius = robust_bounds(gaussians.means)
    if not radius > 0:
        return []
    size = RANKED_SIZE // 2
    directions = ((0, 0, 1), (1, 0, 0), (0, 0, -1), (-1, 0, 0))
    return [
        look_at(centre, centre + radius * np.array(d), up=WORLD_UP, fov_y=90.0, width=size, height=size)
        for d in directions
    ]


@dataclass(eq=False)
class Search:
    """Files of one scene in one format, and what they make of it."""

    gaussians: Gaussians
    path: Path
    """Name of the file; the format's."""
    known: Format
    folder: Path
    """Folder for trials."""
    judge: Judge
    progress: Progress = NO_PROGRESS
    written: int = 0
    """Number of trials."""
    order: np.ndarray | None = None
    """Splats, those first that are kept longest."""

    def finest(self) -> Choice:
        knobs = {name: values[-1] for name, values in self.known.all_knobs.items()}
        return Choice(sh_degree=self.gaussians.sh_degree if self.known.sh else 0, knobs=knobs)

    def scene_of(self, choice: Choice) -> Gaussians:
        scene = with_degree(self.gaussians, choice.sh_degree)
        if choice.kept < 1:
            assert self.order is not None
            count = max(1, round(choice.kept * len(scene)))
            scene = scene.take(np.sort(self.order[:count]))
        return scene

    def trial(
        self,
        choice: Choice,
        judge: Judge | None = None,
        scene: Gaussians | None = None,
        progress: Progress | None = None,
    ) -> Trial:
        """Writes `choice` (of `scene`, else of the whole one), reads it and measures it."""
        progress = progress or Progress(cancelled=self.progress.cancelled)
        progress.check()
        self.written += 1
        folder = self.folder / str(self.written)
        folder.mkdir()
        file = trial_path(folder, self.path)
        written = self.scene_of(choice) if scene is None else scene
        save_scene(written, file, progress=progress.part(0.0, 0.5), knobs=self._used(choice, written))
        read = load_scene(file, progress=progress.part(0.5, 0.7))
        error, largest = (judge or self.judge).error(read, progress.part(0.7, 1.0))
        return Trial(
            choice=choice,
            number=self.written,
            file=file,
            bytes=stored_bytes(file),
            splats=len(read),
            error=error,
            largest=largest,
        )

    def _used(self, choice: Choice, scene: Gaussians) -> dict[str, Any]:
        return {
            name: value for name, value in choice.knobs.items() if name in self.known.knobs or scene.sh_degree
        }

    def measure_alone(self, trial: Trial, judge: Judge, scene: Gaussians | None, **knobs: Any) -> Trial:
        """The trial that differs from `trial` in `knobs` alone; its file is not kept."""
        found = self.trial(replace(trial.choice, knobs=trial.choice.knobs | knobs), judge, scene)
        self.drop(found)
        return found

    def drop(self, trial: Trial | None) -> None:
        if trial is not None:
            shutil.rmtree(self.folder / str(trial.number), ignore_errors=True)


@dataclass(kw_only=True)
class Curves:
    """Bytes and squared errors of each knob alone."""

    fixed: float
    """Bytes that a file without splats would have."""
    rest_bytes: float
    """Of everything else but SH, as fine as it gets."""
    base_error: float
    options: dict[str, list[tuple[Any, float, float]]]
    """Knob -> (value, bytes saved, error added)."""
    sh: list[tuple[int, dict[str, Any], float, float]]
    """(degree, knobs, bytes, error)."""
    kept: tuple[np.ndarray, np.ndarray]
    """Shares, falling, and the errors, rising."""

    def combinations(self) -> Iterator[tuple[int, dict[str, Any], float, float]]:
        """(degree, knobs, bytes, error) of every combination with all splats."""
        names = list(self.options)
        for degree, sh_knobs, sh_bytes, sh_error in self.sh:
            for values in itertools.product(*self.options.values()):
                knobs = dict(zip(names, (value for value, _, _ in values), strict=True))
                size = self.rest_bytes - sum(saved for _, saved, _ in values) + sh_bytes
                error = self.base_error + sum(added for _, _, added in values) + sh_error
                yield degree, knobs | sh_knobs, max(size, 1.0), error

    def error_of(self, kept: float) -> float:
        shares, errors = self.kept
        return float(np.interp(-kept, -shares, errors))

    def fewest(self, budget: float) -> float:
        """The least share of the splats whose error is at most `budget`, above 0."""
        shares, errors = self.kept
        return float(np.interp(budget, errors, shares)) if budget > 0 else 1.0


def search(
    gaussians: Gaussians,
    path: Path,
    known: Format,
    target: Target,
    judge: Judge,
    folder: Path,
    progress: Progress = NO_PROGRESS,
) -> Trial:
    """The smallest file of the format in `folder` that reaches `target.psnr`, or the best one of at most
    `target.bytes`.

    Raises:
        InputError: the format cannot; says the best that it can.
        Cancelled: nobody waits for it any more.
    """
    found = Search(gaussians, path, known, folder, judge, progress)
    finest = found.trial(found.finest())
    progress.step(0.08)
    if target.psnr is not None and not finest.psnr >= target.psnr:
        raise InputError(
            f"{path}: {known.suffix.removeprefix('/')} reaches {finest.psnr:.1f} dB with this scene at most ("
            f"{size_in_words(finest.bytes)}), and {target.in_words} are asked for; ask for less, or take "
            f"{_finer(known)}"
        )
    if target.bytes is not None and finest.bytes <= target.bytes:
        return finest
    found.order = ranking(gaussians, progress.part(0.08, 0.2), skipped=len(judge.cameras))
    curves = measure_curves(found, finest, progress.part(0.2, 0.7))
    wanted = 10 ** (-target.psnr / 10) if target.psnr is not None else float(target.bytes or 0)
    best, aim = (finest if target.psnr is not None else None), Aim(wanted)
    for round_ in range(ROUNDS):
        progress.step(0.7 + 0.3 * round_ / ROUNDS)
        choice = (smallest if target.psnr is not None else best_within)(curves, aim.next())
        if choice is None:
            break
        trial = found.trial(choice)
        came = trial.error if target.psnr is not None else float(trial.bytes)
        aim.note(came)
        better = best is None or (
            trial.bytes < best.bytes if target.psnr is not None else trial.error < best.error
        )
        if came <= wanted and better:
            found.drop(best)
            best = trial
        else:
            found.drop(trial)
        if CLOSE * wanted <= came <= wanted:
            break
    if best is None:
        raise InputError(_too_large(found, curves, target))
    return best


class Aim:
    """What to ask of the curves so that a file comes to `wanted`, by those that came before: the false
    position between the nearest one below and above, on logarithms."""

    def __init__(self, wanted: float) -> None:
        self._wanted = wanted
        self._asked = wanted
        self._below: tuple[float, float] | None = None
        """(asked, came) of the largest that was allowed."""
        self._above: tuple[float, float] | None = None
        self._was_below: bool | None = None

    def next(self) -> float:
        return self._asked

    def note(self, came: float) -> None:
        """Takes in what came of the last one."""
        came, asked = max(came, 1e-30), self._asked
        aimed = self._wanted * (1 + CLOSE) / 2
        again = self._was_below is (came <= self._wanted)
        self._was_below = came <= self._wanted
        if self._was_below:
            self._below = asked, came
        else:
            self._above = asked, came
        if self._below is None or self._above is None:
            self._asked = asked * min(max(aimed / came, 0.1), 10.0)
            return
        (low, low_came), (high, high_came) = self._below, self._above
        steepness = math.log(high_came / low_came)
        # Twice on one side: it is no line, and halving is safer.
        share = math.log(aimed / low_came) / steepness if steepness > 0 and not again else 0.5
        self._asked = low * (high / low) ** min(max(share, 0.1), 0.9)


def smallest(curves: Curves, budget: float) -> Choice | None:
    """The choice of the fewest bytes with an error of at most `budget`."""
    best, least = None, math.inf
    for degree, knobs, size, error in curves.combinations():
        if not error <= budget:
            continue
        kept = curves.fewest(budget - error)
        if curves.fixed + kept * size < least:
            best, least = Choice(kept=kept, sh_degree=degree, knobs=knobs), curves.fixed + kept * size
    return best


def best_within(curves: Curves, most: float) -> Choice | None:
    """The choice of the least error with at most `most` bytes."""
    best, least = None, math.inf
    for degree, knobs, size, error in curves.combinations():
        kept = min(1.0, (most - curves.fixed) / size)
        if not kept >= KEPT[-1]:
            continue
        error += curves.error_of(kept)
        if error < least:
            best, least = Choice(kept=kept, sh_degree=degree, knobs=knobs), error
    return best


def measure_curves(found: Search, finest: Trial, progress: Progress) -> Curves:
    """Each knob alone, on few views: those of SH with all bands, the others without any."""
    known, few, gaussians = found.known, found.judge.of_first(CURVE_VIEWS), found.gaussians
    degree = finest.choice.sh_degree
    bare = with_degree(gaussians, 0)
    bare_judge = few if gaussians.sh_degree == 0 else Judge(bare, few.cameras)
    steps = sum(len(values) - 1 for values in known.all_knobs.values()) + degree + 3
    done = itertools.count(1)

    def step() -> None:
        progress.step(next(done) / steps)

    rest = found.measure_alone(replace(finest, choice=replace(finest.choice, sh_degree=0)), bare_judge, bare)
    step()
    options: dict[str, list[tuple[Any, float, float]]] = {}
    for name, values in known.knobs.items():
        options[name] = [(values[-1], 0.0, 0.0)]
        for value in reversed(values[:-1]):
            alone = found.measure_alone(rest, bare_judge, bare, **{name: value})
            step()
            options[name].append((value, rest.bytes - alone.bytes, max(alone.error - rest.error, 0.0)))
    sh = [(0, {name: values[-1] for name, values in known.sh_knobs.items()}, 0.0, 0.0)]
    base = few.error(load_scene(finest.file))[0]
    if degree:
        sh = _sh_curve(found, finest, base, float(rest.bytes), few, step)
    tiny = bare.take(slice(0, max(1, round(KEPT[-1] * len(bare)))))
    fixed = max(found.measure_alone(rest, few, tiny).bytes - rest.bytes * len(tiny) / max(len(bare), 1), 0.0)
    whole = few.error(gaussians)[0]
    errors = [few.error(found.scene_of(Choice(kept=share, sh_degree=3)))[0] - whole for share in KEPT]
    step()
    return Curves(
        fixed=fixed,
        rest_bytes=rest.bytes - fixed,
        base_error=base,
        options=options,
        sh=sh,
        kept=(np.array(KEPT), np.maximum.accumulate(np.maximum(errors, 0))),
    )


def _sh_curve(
    found: Search, finest: Trial, base: float, rest_bytes: float, few: Judge, step: Callable[[], None]
) -> list[tuple[int, dict[str, Any], float, float]]:
    """SH at every degree and with every value of its knob: all bands are measured, fewer are as their share
    of the coefficients."""
    degree, known = finest.choice.sh_degree, found.known
    full = [({}, finest.bytes - rest_bytes, 0.0)]
    for name, values in known.sh_knobs.items():
        full = [({name: values[-1]}, finest.bytes - rest_bytes, 0.0)]
        for value in reversed(values[:-1]):
            alone = found.measure_alone(finest, few, None, **{name: value})
            step()
            full.append(({name: value}, alone.bytes - rest_bytes, max(alone.error - base, 0.0)))
    curve, whole = [], few.error(found.gaussians)[0]
    for fewer in range(degree + 1):
        # Error of the bands themselves: nothing is written for it.
        dropped = few.error(with_degree(found.gaussians, fewer))[0] - whole if fewer < degree else 0.0
        step()
        share = (SH_COEFFICIENTS[fewer] - 1) / (SH_COEFFICIENTS[degree] - 1)
        choices = full if fewer else full[:1]
        curve += [
            (fewer, knobs, share * size, max(dropped, 0.0) + share * error) for knobs, size, error in choices
        ]
    return curve


def _finer(known: Format) -> str:
    """Formats that hold more than `known`, for messages."""
    if known.exact:
        return ".ply"
    rows = [row for row in FORMATS.values() if row.write and not row.folder and (row.exact or row.sh_knobs)]
    return " or ".join(row.suffix for row in rows if row is not known)


def _too_large(found: Search, curves: Curves, target: Target) -> str:
    """What to say where no file is small enough."""
    degree, knobs, _, _ = min(curves.combinations(), key=lambda one: one[2])
    least = found.trial(Choice(kept=KEPT[-1], sh_degree=degree, knobs=knobs))
    return (
        f"{found.path}: the smallest {found.known.suffix} of this scene that is tried has "
        f"{size_in_words(least.bytes)} ({least.splats:,} splats, {least.psnr:.1f} dB), and {target.in_words} "
        "are asked for; ask for more, or take splats out first"
    )
