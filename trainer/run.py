"""A whole run, whoever drives it: budgets, metrics, checkpoints, Ctrl-C, and what is written at the end.

Without a window `run` does it all; with one, `background.BackgroundTraining` calls the parts between which a
user may pause.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import secrets
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TextIO

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from splatview.scene import Gaussians, InputError
from splatview.scene.effects.effect import Effect
from splatview.scene.formats import check_saving, place_beside, save_scene
from splatview.scene.formats.io import target_of
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.trainer.checkpoint import save_checkpoint
from splatview.trainer.counters import NothingSeen, PluginError, StepReport
from splatview.trainer.distributed import PeerLost
from splatview.trainer.effects import (
    EXPOSURE,
    FEW_PHOTOS,
    MORE_PHOTOS,
    OUTLIERS,
    PASSING,
    SCENES,
    TRANSIENTS,
    WITHHELD,
    with_easing,
    with_exposure,
    with_frozen,
    with_more_photos,
    with_outliers,
    with_passing,
    with_scenes,
    with_transients,
    with_withheld,
)
from splatview.trainer.evaluate import Evaluation, evaluation_of, pictures, side_by_side
from splatview.trainer.memory import MemoryPlan
from splatview.trainer.views import TrainView

if TYPE_CHECKING:
    from splatview.trainer.splats import Splats
    from splatview.trainer.trainer import Trainer

CHECKPOINT_SECONDS = 60.0
"""A kill costs at most about so much of the work."""

METRICS_STEPS = 50
"""Steps between lines of metrics, besides those of evaluations."""

EVALUATE_EVERY = 1000
"""Steps between evaluations where nothing else is asked for."""

EVALUATION_SHARE = 0.05
"""Share of the time for evaluations that nobody has asked for: of large photos one takes seconds."""

MOST_WATCHED = 16
"""Held-out photos, spread over all, that are measured on the way where nothing else is asked for. All 200 of
NeRF's synthetic set, 800x800, take 12 s: by them the thousandth step cost a fifth of a minute's run."""

MOST_PICTURES = 8
"""Side-by-side pictures that are written."""

PICTURE_MARK = "Software", "splatview train, side by side"
"""Text in their files, by which those of an earlier run are told from what somebody else has put there."""


@dataclass(frozen=True, kw_only=True)
class Outputs:
    """Where a run writes."""

    scene: Path
    checkpoint: Path
    metrics: Path | None
    pictures: Path
    """Folder of the side-by-side pictures, made when there are any."""

    def check(self) -> None:
        """Tries every place before any work is done.

        Raises:
            InputError: one cannot be written to.
        """
        check_saving(self.scene)
        target_of(self.checkpoint)
        if place_beside(self.scene) == self.scene:  # else it is a folder, made beside its place and renamed
            check_writable(self.scene)
        check_writable(self.checkpoint)
        if self.metrics is not None:
            check_metrics(self.metrics)
        if os.path.lexists(self.pictures) and not os.path.isdir(self.pictures):
            raise InputError(f"{self.pictures}: is in the way of the folder for pictures; move it")


class RunProgress(NamedTuple):
    """What a progress bar shows."""

    step: StepReport
    seconds: float
    evaluation: Evaluation | None
    """Scores of this step, if it was evaluated."""
    prepared: float = 0.0
    """Of the seconds, those before the first step."""
    splats: int = 0
    """Of the scene that is measured, shown and saved, which may be another than the one in training."""

    @property
    def seconds_left(self) -> float:
        """About how long the rest takes; infinite before the first step is done."""
        done = self.step.progress
        return (self.seconds - self.prepared) * (1 / done - 1) if done > 0 else math.inf


def check_writable(path: Path) -> None:
    """Makes a file beside `path` and removes it. Raises InputError where the system refuses."""
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder; name a file in it")
    if os.path.exists(path) and not os.path.isfile(path):
        raise InputError(f"{path}: is a device or a pipe, not a file; name a file")
    try:
        folder = os.path.dirname(os.path.realpath(path))
        with tempfile.TemporaryFile(dir=folder, prefix=".splatview-") as file:
            file.write(bytes(4096))
            file.flush()
        if os.path.isfile(path):
            with open(path, "ab"):
                pass
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


LONGEST_LINE = 1 << 20
"""Bytes of a line of metrics."""


def check_metrics(path: Path) -> None:
    """Raises InputError where no lines can be added to `path`, or where it holds something else."""
    if os.path.isdir(path):
        raise InputError(f"{path}: is a folder; name a file in it")
    line, is_new = b"", not os.path.lexists(path)
    try:
        with open(path, "ab", opener=_without_waiting):
            pass
        if is_new:
            os.unlink(path)
        elif os.path.isfile(path):
            with open(path, "rb") as file:
                line = file.readline(LONGEST_LINE)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    try:
        known = not line or "iteration" in dict(json.loads(line))
    except (ValueError, TypeError, RecursionError):
        known = False
    if not known:
        raise InputError(f"{path}: is no file of metrics, to which lines could be added; name another")


def _without_waiting(name: str, flags: int) -> int:
    """Opens a pipe that nobody reads, or does not read any more, without waiting for a reader."""
    return os.open(name, flags | getattr(os, "O_NONBLOCK", 0), 0o666)


class Stopwatch:
    """Seconds of a run, pauses left out. Only one thread may use it."""

    def __init__(self, started: float) -> None:
        """`started`: time.perf_counter() of its zero."""
        self._started = started
        self._paused: float | None = None

    @property
    def seconds(self) -> float:
        return (time.perf_counter() if self._paused is None else self._paused) - self._started

    def pause(self) -> None:
        if self._paused is None:
            self._paused = time.perf_counter()

    def resume(self) -> None:
        if self._paused is not None:
            self._started += time.perf_counter() - self._paused
            self._paused = None


class TrainingRun:
    """Takes a trainer through its run and keeps what it learns safe on the way."""

    def __init__(
        self,
        trainer: Trainer,
        held_out: Sequence[TrainView],
        outputs: Outputs,
        *,
        started: float,
        eval_every: int | None = None,
        eval_seconds: float | None = None,
        notes: dict[str, Any] | None = None,
        effects: tuple[Effect, ...] = (),
        memory: MemoryPlan | None = None,
        on_progress: Callable[[RunProgress], None] = lambda progress: None,
        on_note: Callable[[str], None] = lambda note: None,
        on_measured: Callable[[int, int], None] = lambda done, photos: None,
    ) -> None:
        """`started`: time.perf_counter() of when the run, or this part of it, began; `eval_every`: steps
        between evaluations, of all held-out photos, None: of MOST_WATCHED of them, every EVALUATE_EVERY, as
        far as EVALUATION_SHARE allows; `eval_seconds` makes them more frequent; `notes` go into
        checkpoints; `effects` and `memory` of the run are told in the metrics;
        `on_progress` is called after every step, `on_note` with a line for the user, `on_measured` as each
        of the held-out photos is measured."""
        self.trainer, self.held_out, self.outputs = trainer, list(held_out), outputs
        self.eval_every, self.eval_seconds, self.notes = eval_every, eval_seconds, notes or {}
        self.watched = self.held_out[:: max(-(-len(self.held_out) // MOST_WATCHED), 1)]
        """Those that are measured on the way where nothing else is asked for."""
        self.on_progress, self.on_note, self.on_measured = on_progress, on_note, on_measured
        self.effects = effects
        """What the run computes and why; replaced once exposures are decided."""
        self._effects_told: tuple[Effect, ...] = ()
        self.memory = memory
        """What the run takes, as it was stated."""
        self._needs = (1.0, 1.0)
        self._easing_told = self._more_photos_told = False
        """Share of the rules for few photos that is in force, in quarters."""
        self.evaluation: Evaluation | None = None
        """Latest scores on the held-out photos."""
        self.evaluated_at = 0
        """Step of `evaluation`."""
        self._first = trainer.counters.iteration
        self._report: StepReport | None = None
        """Of the last step."""
        self._memory_told = False
        self.stopwatch = Stopwatch(started - trainer.counters.seconds)
        # The first is due at once: a run killed in its first minute can be resumed too.
        self._checkpointed = -math.inf
        self._evaluated = time.perf_counter()
        self._evaluation_cost = 0.0
        self._measured: Splats | None = None
        """Scene of `evaluation`, where it is one that others follow."""
        self._metrics: TextIO | None = None

    @property
    def seconds(self) -> float:
        """Wall-clock time of the run, earlier parts included, pauses not."""
        return self.stopwatch.seconds

    @property
    def has_trained(self) -> bool:
        """Whether a step has been taken since the run, or this part of it, began."""
        return self.trainer.counters.iteration > self._first

    def run(self) -> bool:
        """Trains to the end, saves the scene, and returns true; false after Ctrl-C.

        A checkpoint is written every CHECKPOINT_SECONDS, and at the end. One that cannot be written is
        told and tried again: the disk may have room by then.

        Raises:
            PeerLost: another process of the run has ended; what was trained has been saved.
            PluginError: the user's loss failed; what was trained has been saved.
            NothingSeen: no photo shows the scene, which is not saved.
            InputError: the scene could not be saved where it should; the message says where it is.
        """
        completed = True
        try:
            while not self.trainer.done:
                self.step()
        except KeyboardInterrupt:
            completed = False
        except (PeerLost, PluginError):
            if self.has_trained:  # otherwise there is nothing that was not there before
                self.keep()
            raise
        except NothingSeen:  # such a scene is worth nothing
            raise
        except Exception as error:
            # The scene is worth more than the reason why it is not finished.
            try:
                self.keep()
            except Exception as unsaved:
                error.add_note(f"nor could the scene be saved: {unsaved}")
            else:
                self.on_note(f"the run failed; {self.outputs.scene} is the scene so far")
            raise
        finally:
            self.close()
        self.keep()
        return completed

    def step(self) -> RunProgress:
        """One step, and what is due after it: an evaluation, a line of metrics, a checkpoint."""
        exposures, outliers = self.trainer.exposures, self.trainer.outliers
        undecided, unsure = not exposures.is_decided, not outliers.is_decided
        masked, scenes = self.trainer.transients.is_decided, len(self.trainer.members)
        withheld = self.trainer.withheld
        watching = withheld.is_watching
        loss = self.trainer.loss
        unknown = loss is not None and loss.replaces is None
        report = self.trainer.step(self.seconds)
        if loss is not None and unknown and loss.replaces:
            self.on_note(f"{loss.name}: takes the place of the photo loss (step.photo_loss was not read)")
        if undecided and exposures.is_decided:
            self.effects = with_exposure(self.effects, exposures)
            if exposures.evidence:
                line = next((effect.why for effect in self.effects if effect.name == EXPOSURE), "")
                self.on_note(f"{EXPOSURE} {'on' if exposures.is_on else 'off'}: {line}")
        if unsure and outliers.is_decided:
            self.effects = with_outliers(self.effects, outliers)
            if outliers.left_out.any():
                self.on_note(f"{OUTLIERS}: {outliers.evidence}; --outliers off trains on them")
            elif outliers.disagree.any():
                self.on_note(f"{OUTLIERS}: none; {outliers.evidence}; check their poses if they look wrong")
            if outliers.doubt:
                self.on_note(f"photos agree little: {outliers.doubt}")
        if not masked and self.trainer.transients.is_decided:
            self._tell_transients()
        if not self._more_photos_told and "growth_batch" in self.trainer.state:
            self._tell_more_photos()
        if watching and not withheld.is_watching:
            self.effects = with_withheld(self.effects, withheld)
            for why in (effect.why for effect in self.effects if effect.name == WITHHELD):
                self.on_note(f"{WITHHELD}: {why}")
        if self.trainer.done and self.trainer.settings.most_of_one < 1:
            self.effects = with_passing(self.effects, self.trainer.passed)
            if self.trainer.passed:
                why = next((effect.why for effect in self.effects if effect.name == PASSING), "")
                self.on_note(f"{PASSING}: {why}; --passing stay leaves them in")
        if self.trainer.done and (frozen := self.trainer.frozen) is not None:
            self.effects = with_frozen(self.effects, frozen, len(self.trainer.splats))
        if len(self.trainer.members) > scenes:
            self._tell_scenes()
        self._tell_edit()
        self._tell_easing()
        evaluation = None
        self._report = report
        if self.held_out and self._evaluation_is_due(report.iteration):
            evaluation = self.evaluate(self.held_out if self.eval_every else self.watched)
        ends = self.trainer.done and not self.held_out  # else what is measured then is in the last line
        if evaluation or ends or (report.iteration % METRICS_STEPS == 0 and not self.trainer.done):
            self._write_metrics(report, evaluation)
        if time.perf_counter() - self._checkpointed >= CHECKPOINT_SECONDS:
            self.checkpoint()
        progress = RunProgress(
            report, self.seconds, evaluation, self.trainer.counters.prepared, len(self.trainer.scene)
        )
        self.on_progress(progress)
        return progress

    def _pictures(self, views: Sequence[TrainView]) -> Iterator[np.ndarray]:
        """What the scene as it is shows of held-out photos, in turn."""
        trainer = self.trainer
        return pictures(
            trainer.scene.arrays,
            views,
            trainer.shown_settings,
            threads=trainer.threads,
            exposures_differ=trainer.exposures.is_on,
        )

    def _told(self, drawn: Iterator[np.ndarray], photos: int) -> Iterator[np.ndarray]:
        """Pictures as they come, each of which is told when the one before it is measured."""
        for done, picture in enumerate(drawn):
            self.on_measured(done, photos)
            yield picture
        self.on_measured(photos, photos)

    def evaluate(self, views: Sequence[TrainView] | None = None) -> Evaluation:
        """Measures the scene as it is on these of the held-out photos, or on all, of which there must be
        some."""
        begun = time.perf_counter()
        views = views or self.held_out
        drawn = self._told(self._pictures(views), len(views))
        self.evaluation = evaluation_of(views, drawn, threads=self.trainer.threads)
        self.evaluated_at = self.trainer.counters.iteration
        self._measured = None if self.trainer.scene is self.trainer.splats else self.trainer.scene
        self._evaluated = time.perf_counter()
        self._evaluation_cost = self._evaluated - begun
        return self.evaluation

    def checkpoint(self) -> bool:
        """Writes the checkpoint; false, and a note, where it cannot be written."""
        self._checkpointed = time.perf_counter()
        try:
            save_checkpoint(self.trainer, self.outputs.checkpoint, self.notes)
        except InputError as error:
            self.on_note(f"no checkpoint written: {error}")
            return False
        return True

    def keep(self) -> None:
        """Writes checkpoint and scene as they stand.

        Raises:
            InputError: the scene could not be saved where it should; the message says where it is.
        """
        self.trainer.counters.seconds = self.seconds
        self._tell_edit()
        self.checkpoint()
        self.save_scene()

    def close(self) -> None:
        """Closes the file of metrics; a later step opens it again."""
        if self._metrics is not None:
            # What a full disk has not taken is tried again here, and has been told before.
            with contextlib.suppress(OSError):
                self._metrics.close()
            self._metrics = None

    def final_evaluation(self) -> Evaluation | None:
        """Measures the scene as it is on all held-out photos, in a line of the metrics too, and writes
        side-by-side pictures; None without held-out photos. For after the scene is saved: many photos take
        longer than a short run.

        Raises:
            InputError: a picture cannot be written.
        """
        if not self.held_out:
            return None
        folder = self.outputs.pictures
        measured = self.evaluation if self.evaluated_at == self.trainer.counters.iteration else None
        try:
            if measured is None or len(measured.scores) < len(self.held_out):
                measured = None
                measured = self.evaluate()
        finally:
            if self._report is not None and self.trainer.done:
                self._write_metrics(self._report, measured)
                self.close()
        shown = self.held_out[:: -(-len(self.held_out) // MOST_PICTURES)]
        marked = PngInfo()
        marked.add_text(*PICTURE_MARK)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            _remove_pictures(folder)
            for view, picture in zip(shown, self._pictures(shown), strict=True):
                name = Path(view.camera.name.replace("/", "_").replace("\\", "_")).stem
                side_by_side(view, picture).save(folder / f"{name}.png", pnginfo=marked)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None
        return measured

    def _evaluation_is_due(self, iteration: int) -> bool:
        if self.trainer.done:  # `final_evaluation`, once the scene is saved
            return False
        if self.eval_every and iteration % self.eval_every == 0:
            return True
        if self.trainer.scene is self._measured:  # it waits for others, see `ensemble`
            return False
        since = time.perf_counter() - self._evaluated
        if not since >= self._evaluation_cost / EVALUATION_SHARE:
            return False
        by_steps = self.eval_every is None and iteration % EVALUATE_EVERY == 0
        return by_steps or (self.eval_seconds is not None and since >= self.eval_seconds)

    def _tell_scenes(self) -> None:
        """Notes that a scene is whole, and what follows."""
        trainer = self.trainer
        count, taught = len(trainer.members), trainer.taught
        if trainer.done:
            self.effects = with_scenes(self.effects, count, taught=False)
            return
        follows = "another one is trained from the same photos"
        shown = "until that is done, the first one is shown and saved"
        if taught is not None:
            self.effects = with_scenes(self.effects, count, taught=True)
            follows = f"a last one learns from photos and from {len(taught)} pictures of all {count}"
            shown = "it goes on from that, and is shown" if trainer.scene is trainer.splats else shown
        self.on_note(
            f"{SCENES}: scene {count} is done at step {trainer.counters.iteration:,}; {follows}; {shown}"
        )

    def _tell_transients(self) -> None:
        transients = self.trainer.transients
        self.effects = with_transients(self.effects, transients)
        if transients.masked:
            self.on_note(f"{TRANSIENTS} masked: {transients.evidence}; --passing stay trains on them")
        elif transients.found:
            self.on_note(
                f"{TRANSIENTS}: none masked; {transients.evidence}: things may have moved or been turned, or"
                " poses be wrong, as where sides of a thing look alike"
            )

    def _tell_edit(self) -> None:
        if self.trainer.edited:
            members = len(self.trainer.members)
            self.effects = with_scenes(self.effects, members, taught=False, edited=True)

    def _tell_more_photos(self) -> None:
        self._more_photos_told, settings, state = True, self.trainer.settings, self.trainer.state
        self.effects = with_more_photos(self.effects, state["growth_batch"], settings, state["growth_by"])
        for line in (one.why for one in self.effects if one.name == MORE_PHOTOS and one.in_force):
            self.on_note(f"{MORE_PHOTOS}: {line}; --batch {settings.batch} takes no more")

    def _tell_easing(self) -> None:
        """Notes by what shares the rules for few photos are in force, where one has changed by a quarter.
        Said the first time alone: a loss that wavers may cross such a share many times."""
        needs = tuple(
            math.ceil(4 * share) / 4 for share in (self.trainer.need_of_reg, self.trainer.ease_of_faint)
        )
        if needs == self._needs:
            return
        self._needs = needs
        self.effects = with_easing(self.effects, *needs)
        told = (one.why for one in self.effects if one.name == FEW_PHOTOS and (one.in_force or needs[1] < 1))
        line = next(told, "")
        if line and not self._easing_told:
            self._easing_told = True
            self.on_note(f"{FEW_PHOTOS}: {line}")

    def _write_metrics(self, report: StepReport, evaluation: Evaluation | None) -> None:
        if self.outputs.metrics is None:
            return
        line: dict[str, Any] = {
            "iteration": report.iteration,
            "seconds": round(self.trainer.counters.seconds, 3),
            "loss": report.loss,
            "gaussians": report.gaussians,
        }
        if self.memory is not None and not self._memory_told:
            self._memory_told = True
            bound = self.memory.bound
            told = {"bytes": self.memory.peak, "splats": self.memory.splats}
            line["memory"] = told | {"bound": bound.bytes if bound.asked else None}
        if self.effects != self._effects_told:
            named = [{"name": one.name, "on": one.in_force, "why": one.why} for one in self.effects]
            line["effects"], self._effects_told = named, self.effects
        if evaluation:
            line |= {"psnr": evaluation.psnr, "ssim": evaluation.ssim, "held_out": len(evaluation.scores)}
        if self.trainer.done:
            stages = self.trainer.clock.milliseconds
            line["stages"] = {name: round(spent, 1) for name, spent in stages.items()}
        try:
            if self._metrics is None:
                # Lines are added, so that a resumed run goes on.
                self._metrics = open(  # noqa: SIM115
                    self.outputs.metrics, "a", encoding="utf-8", buffering=1, opener=_without_waiting
                )
            self._metrics.write(json.dumps(line) + "\n")
        except OSError as error:
            # The scene is worth more than the curve of how it came about.
            self.on_note(f"{self.outputs.metrics}: a line could not be written: {error.strerror or error}")

    def save_scene(self) -> None:
        """Writes the scene, beside the system's temporary files if need be.

        Raises:
            InputError: it could not be saved where it should; the message says where it is.
        """
        scene = _with_all_bands(self.trainer.snapshot(), self.trainer.settings.sh_degree)
        try:
            save_scene(scene, self.outputs.scene)
        except InputError as error:
            refuge = _saved_elsewhere(scene)
            where = "nor elsewhere" if refuge is None else f"the trained scene is saved as {refuge}"
            raise InputError(f"{error}; {where}") from None


def _remove_pictures(folder: Path) -> None:
    """Side-by-side pictures that an earlier run has left: they may be of other photos."""
    key, text = PICTURE_MARK
    for path in folder.glob("*.png"):
        try:
            with Image.open(path) as picture:
                is_ours = picture.info.get(key) == text
        except (OSError, ValueError):
            continue
        if is_ours:
            path.unlink()


def _with_all_bands(scene: Gaussians, degree: int) -> Gaussians:
    """The same with coefficients up to `degree`, also of bands not unlocked yet: the viewers that came with
    the first trainer read files of a fixed layout."""
    missing = SH_COEFFICIENTS[degree] - scene.sh.shape[1]
    return replace(scene, sh=np.pad(scene.sh, ((0, 0), (0, max(missing, 0)), (0, 0))))


def _saved_elsewhere(scene: Gaussians) -> Path | None:
    """The file in the first place that takes it; None where none does."""
    for folder in (Path(tempfile.gettempdir()), Path.home(), Path.cwd()):
        path = folder / f"splatview-{secrets.token_hex(4)}.ply"
        with contextlib.suppress(InputError):
            save_scene(scene, path)
            return path
    return None
