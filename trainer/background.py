"""Training in a thread of its own, while somebody watches.

The thread alone touches the trainer. What others want of it is posted and done between two steps; what
they may see is published: immutable snapshots of the scene in a slot where the latest wins, a `Status`
that is replaced as a whole, and curves that are only ever added to. No lock is held across a step.
"""

from __future__ import annotations

import math
import queue
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from splatview.raster import available_threads
from splatview.scene import Gaussians, InputError
from splatview.scene.effects.effect import Effect
from splatview.scene.formats import save_scene
from splatview.trainer.checkpoint import save_checkpoint
from splatview.trainer.counters import History, PluginError
from splatview.trainer.evaluate import Evaluation
from splatview.trainer.run import TrainingRun
from splatview.trainer.settings import TrainSettings
from splatview.trainer.views import TrainView

State = Literal["training", "paused", "done", "failed"]

MEASURING = "Measuring held-out photos"

LEAST_SHARE = 0.02
"""Smallest share of the cores: less would look like a program that hangs."""


class Pace(NamedTuple):
    """How a share of the cores is kept to."""

    threads: int
    duty: float
    """Share of the time in which the threads work; they sleep in between."""


def pace_of(share: float, cores: int) -> Pace:
    """As few threads as have the share, asleep for what they are too many."""
    wanted = min(max(share, LEAST_SHARE), 1.0) * cores
    threads = max(math.ceil(wanted - 1e-9), 1)
    return Pace(threads, min(wanted / threads, 1.0))


@dataclass(frozen=True, eq=False, kw_only=True)
class Snapshot:
    """The scene as it stood after a step. Nothing changes it any more."""

    gaussians: Gaussians
    ids: np.ndarray
    """(N,) int64: numbers of the splats, see `Splats.ids`."""
    iteration: int
    seconds: float
    exposures_differ: bool = False
    """Whether photos are measured at the exposures that fit, see `evaluate`."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Status:
    """Where the run stands."""

    state: State
    settings: TrainSettings
    iteration: int
    progress: float
    """Share of the run that is over, 0 to 1."""
    seconds: float
    """Seconds of the run, pauses left out."""
    gaussians: int
    sh_degree: int
    """SH degree in training by now."""
    loss: float
    """Loss of the latest step; NaN before the first."""
    rate: float = 0.0
    """Steps a second, sleep included; 0 while not known."""
    evaluation: Evaluation | None = None
    """Latest scores on the held-out photos."""
    evaluated_at: int = 0
    """Step of `evaluation`."""
    failure: str | None = None
    """One line on what ended the training."""
    activity: str = ""
    """What takes longer than a step, while it lasts: "Saving"."""
    saved_at: int | None = None
    """Step at which scene and checkpoint were last written by this thread."""
    left_out: frozenset[str] = frozenset()
    """Names of the photos that are not trained on, as they disagree with the others."""
    in_part: Mapping[str, TrainView] = field(default_factory=dict)
    """Photos that are trained on without some of their pixels, which others contradict, by name."""
    scene: int = 1
    """Number of the scene in training, see `ensemble`: of later ones than the first, minutes tell the end."""

    @property
    def seconds_left(self) -> float | None:
        """Seconds left of the run at the present pace; None where that cannot be told."""
        left = []
        if self.settings.trains_several:
            if self.progress > 0:
                left.append(self.seconds * (1 / self.progress - 1))
        elif self.settings.iterations is not None and self.rate > 0:
            left.append((self.settings.iterations - self.iteration) / self.rate)
        if self.settings.minutes is not None:
            left.append(60 * self.settings.minutes - self.seconds)
        return max(min(left), 0.0) if left else None


Answer = TypeVar("Answer")

PUBLISH_SHARE = 0.02
"""Share of the time that making snapshots may take: a large scene is shown less often, not trained slower."""

RATE_SECONDS = 3.0
"""Over about so long are steps a second averaged."""


class BackgroundTraining:
    """Trains, pauses, saves and publishes. Everything but `close` returns at once, in any thread."""

    def __init__(
        self,
        training_run: TrainingRun,
        *,
        share: float = 1.0,
        cores: int | None = None,
        snapshot_seconds: float | None = 0.25,
        on_change: Callable[[], object] = lambda: None,
    ) -> None:
        """`share` of `cores` (None: all) goes into training; a snapshot is made every `snapshot_seconds` at
        most (None: only when training stands); `on_change` is called, in the thread, when the state has
        changed. It waits for `begin`, but has the priority of the thread that makes this: a window may lower
        its own in between."""
        self.share = share
        """Share of the cores, 0 to 1. May be set at any time."""
        self.cores = cores or available_threads()
        self.snapshot_seconds = snapshot_seconds
        """May be set at any time."""
        self.outputs = training_run.outputs
        self.history = History(("iteration", "seconds", "loss", "gaussians"))
        """One row a step."""
        self.evaluations = History(("iteration", "seconds", "psnr", "ssim"))
        """One row an evaluation."""
        self.publishing_seconds = 0.0
        """What snapshots have cost so far."""
        self.published = 0
        """Snapshots made."""
        self._training_run = training_run
        self.on_change = on_change
        """May be set at any time."""
        self._commands: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._notes: deque[str] = deque(maxlen=100)
        self._slot: deque[Snapshot] = deque(maxlen=1)
        self._thread = threading.Thread(target=self._work, name="splatview-train", daemon=True)
        # Of the thread alone:
        self._closing = False
        self._steps_wanted = 0
        self._shown_at = training_run.trainer.counters.iteration
        """Step of what is shown."""
        self._step_due = self._snapshot_due = 0.0
        self._step_ended: float | None = None
        self._unseen = self._unsaved = False
        self._sound = False
        """Whether the trainer is whole after a failure."""
        trainer = training_run.trainer
        self.status = Status(
            state="training",
            settings=trainer.settings,
            iteration=trainer.counters.iteration,
            progress=trainer.progress,
            seconds=trainer.counters.seconds,
            gaussians=len(trainer.splats),
            sh_degree=trainer.splats.sh_degree,
            loss=math.nan,
        )
        """Replaced, never changed."""
        training_run.on_note, training_run.on_measured = self._notes.append, self._measured
        self._publish()
        self._begun = threading.Event()
        self._thread.start()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What the run computes and why."""
        return self._training_run.effects

    def begin(self) -> None:
        """Starts to train."""
        self._begun.set()

    # ---- what others may ask for

    def post(self, command: Callable[[TrainingRun], Answer], *, changes: bool = False) -> Future[Answer]:
        """Runs `command(training_run)` in the thread, between two steps; the future holds its answer.

        `changes`: the command changes the scene, so that a snapshot is published and the scene is saved
        when the window closes. A command that fails is noted; training goes on.
        """
        answer: Future[Answer] = Future()

        def obey() -> None:
            try:
                result = command(self._training_run)
            except Exception as error:
                self._note(error)
                answer.set_exception(error)
                return
            if changes:
                self._unseen = self._unsaved = True
                self._tell()
                self._publish()
            answer.set_result(result)
            if changes and self.status.state == "paused" and self._training_run.trainer.done:
                self._finish()  # an edit has ended the run, and there is no step that would

        self._commands.put(obey)
        return answer

    def pause(self) -> None:
        self._commands.put(self._pause)

    def resume(self) -> None:
        """Goes on after a pause, a failure, or an end that has been moved."""
        self._commands.put(self._resume)

    def step_once(self) -> None:
        """One step, and a pause after it."""
        self._commands.put(self._want_step)

    def stop(self) -> None:
        """Pauses, and writes scene and checkpoint."""
        self._commands.put(self._stop)

    def show_now(self, *, again: bool = False) -> None:
        """Publishes a snapshot, whatever the pace of snapshots is; `again`: even of a scene already shown."""

        def show() -> None:
            self._unseen = self._unseen or again
            self._publish()

        self._commands.put(show)

    def change(self, **settings: Any) -> Future[None]:
        """Changes fields of `TrainSettings`. A value that makes no sense is noted and changes nothing."""

        def apply(training_run: TrainingRun) -> None:
            training_run.trainer.change(**settings)
            self._tell()

        return self.post(apply)

    def export(self, path: Path) -> Future[Path]:
        """Writes the scene as it stands, in the format of the suffix."""

        def save(training_run: TrainingRun) -> Path:
            with self._doing("Saving"):
                save_scene(training_run.trainer.snapshot(), path)
            self._notes.append(f"Scene saved at step {training_run.trainer.counters.iteration:,}: {path}")
            return path

        return self.post(save)

    def save_checkpoint(self, path: Path | None = None) -> Future[Path]:
        """Writes a checkpoint, where the run has its own if no other place is named."""
        place = path or self.outputs.checkpoint

        def save(training_run: TrainingRun) -> Path:
            save_checkpoint(training_run.trainer, place, training_run.notes)
            self._notes.append(
                f"Checkpoint saved at step {training_run.trainer.counters.iteration:,}: {place}"
            )
            return place

        return self.post(save)

    def evaluate(self) -> Future[Evaluation | None]:
        """Measures the held-out photos now; None where there are none."""

        def measure(training_run: TrainingRun) -> Evaluation | None:
            if not training_run.held_out:
                return None
            with self._doing(MEASURING):
                evaluation = training_run.evaluate()
            self._note_evaluation(evaluation)
            return evaluation

        return self.post(measure)

    def close(self) -> None:
        """Ends the thread after the step it is at; a scene that was trained on is saved first.

        Raises:
            InputError: the scene could not be saved where it should; the message says where it is.
        """
        if self._thread.is_alive():
            self._commands.put(self._end)
            self._begun.set()
            self._thread.join()
        self._training_run.close()
        # However the thread ended, the trainer is this thread's now.
        if self._unsaved:
            self._keep()

    # ---- what others may see

    def take_snapshot(self) -> Snapshot | None:
        """The latest one, if there is one that nobody has taken yet."""
        try:
            return self._slot.pop()
        except IndexError:
            return None

    def take_notes(self) -> list[str]:
        """Lines for the user since the last call."""
        notes = []
        while self._notes:
            notes.append(self._notes.popleft())
        return notes

    # ---- in the thread

    def _work(self) -> None:
        self._begun.wait()
        if self._training_run.trainer.done:  # resumed from its last checkpoint
            self._finish()
        while not self._closing:
            self._obey()
            if not self._closing and self._steps_are_wanted and time.perf_counter() >= self._step_due:
                self._step()

    @property
    def _steps_are_wanted(self) -> bool:
        return self.status.state == "training" or self._steps_wanted > 0

    def _obey(self) -> None:
        """Runs what was posted; sleeps until the next step is due or something is posted."""
        wait = max(self._step_due - time.perf_counter(), 0.0) if self._steps_are_wanted else None
        try:
            command = self._commands.get(timeout=wait) if wait != 0 else self._commands.get_nowait()
            while True:
                try:
                    command()
                except Exception as error:
                    self._note(error)
                command = self._commands.get_nowait()
        except queue.Empty:
            pass

    def _end(self) -> None:
        self._closing = True

    def _step(self) -> None:
        """A step and what is due after it; what fails stops the run and is told of, and the thread lives."""
        try:
            self._take_step()
        except Exception as error:
            if not isinstance(error, InputError):
                traceback.print_exc()
            self._steps_wanted = 0
            self._training_run.stopwatch.pause()
            self._unseen = True
            self._sound = isinstance(error, PluginError)  # a step with such a loss has not happened
            self._tell(state="failed", failure=one_line(error), rate=0.0, activity="")
            try:
                self._publish()
            except Exception as again:  # what is shown stays
                self._note(again)
            self.on_change()

    def _take_step(self) -> None:
        trainer = self._training_run.trainer
        if trainer.done:  # by what was posted: no step moves a scene that is whole
            self._finish()
            return
        pace = pace_of(self.share, self.cores)
        trainer.threads = pace.threads
        begun, is_shown = time.perf_counter(), trainer.scene is trainer.splats
        progress = self._training_run.step()
        ended = time.perf_counter()
        self._step_due = ended + (ended - begun) * (1 / pace.duty - 1)
        self._unseen = self._unsaved = True
        step = progress.step
        if is_shown or trainer.scene is trainer.splats:
            self._shown_at = step.iteration
        self.history.add(step.iteration, trainer.counters.seconds, step.loss, step.gaussians)
        if progress.evaluation is not None:
            self._note_evaluation(progress.evaluation)
        self._tell(loss=step.loss, rate=self._rate_after(ended), activity="")
        if trainer.done:
            self._finish()
        elif self._steps_wanted > 0:
            self._steps_wanted -= 1
            if self._steps_wanted == 0:
                self._training_run.stopwatch.pause()
                self._publish()
                self.on_change()
        elif (
            self.snapshot_seconds is not None and not self._slot and time.perf_counter() >= self._snapshot_due
        ):
            self._publish()

    def _rate_after(self, ended: float) -> float:
        """Steps a second, a running average that forgets over RATE_SECONDS."""
        last, self._step_ended = self._step_ended, ended
        if last is None:
            return 0.0
        took = max(ended - last, 1e-6)
        if self.status.rate <= 0:
            return 1 / took
        weight = 1 - math.exp(-took / RATE_SECONDS)
        return 1 / ((1 - weight) / self.status.rate + weight * took)

    def _publish(self) -> None:
        """Makes a snapshot of a scene that has changed since the last one."""
        if self.published and not self._unseen:
            return
        begun = time.perf_counter()
        trainer = self._training_run.trainer
        counters = trainer.counters
        self._slot.append(
            Snapshot(
                gaussians=trainer.snapshot(),
                ids=trainer.scene.ids,
                iteration=self._shown_at,
                seconds=counters.seconds,
                exposures_differ=trainer.exposures.is_on,
            )
        )
        self._unseen = False
        took = time.perf_counter() - begun
        self.published += 1
        self.publishing_seconds += took
        self._snapshot_due = begun + took + max(self.snapshot_seconds or 0.0, took / PUBLISH_SHARE)

    def _tell(self, **changes: Any) -> None:
        """Publishes where the run stands."""
        trainer = self._training_run.trainer
        self.status = replace(
            self.status,
            settings=trainer.settings,
            iteration=trainer.counters.iteration,
            progress=trainer.progress,
            seconds=trainer.counters.seconds,
            gaussians=len(trainer.scene),
            sh_degree=trainer.scene.sh_degree,
            left_out=trainer.outliers.names_left_out,
            in_part=trainer.views.in_part,
            scene=1
            if trainer.scene is trainer.splats and trainer.taught is None
            else len(trainer.members) + 1,
            **changes,
        )

    def _note(self, error: Exception) -> None:
        if not isinstance(error, InputError | ValueError):
            traceback.print_exception(error)
        self._notes.append(one_line(error))

    def _note_evaluation(self, evaluation: Evaluation) -> None:
        counters = self._training_run.trainer.counters
        watched = evaluation.among({view.camera.name for view in self._training_run.watched})
        self.evaluations.add(counters.iteration, counters.seconds, watched.psnr, watched.ssim)
        self._tell(evaluation=evaluation, evaluated_at=counters.iteration)

    def _pause(self) -> None:
        self._steps_wanted = 0
        self._training_run.stopwatch.pause()
        if self.status.state == "training":
            self._tell(state="paused", rate=0.0)
        self._publish()
        self.on_change()

    def _resume(self) -> None:
        if self._training_run.trainer.done and self.status.state == "done":
            self._notes.append("The run is over: make it longer to train on")
            return
        self._step_ended = None
        self._step_due = 0.0
        self._training_run.stopwatch.resume()
        self._tell(state="training", failure=None, rate=0.0)
        self.on_change()

    def _want_step(self) -> None:
        if self.status.state == "training":
            self._pause()
        if self._training_run.trainer.done or self.status.state == "failed":
            return
        self._step_ended = None
        self._step_due = 0.0
        self._steps_wanted += 1
        self._training_run.stopwatch.resume()

    def _stop(self) -> None:
        self._pause()
        self._keep()
        self.on_change()

    def _finish(self) -> None:
        """The run is over: everything that a run without a window writes, is written."""
        self._steps_wanted = 0
        self._training_run.stopwatch.pause()
        self._publish()
        self._tell(state="done", rate=0.0)
        self.on_change()
        try:
            self._keep()
            with self._doing(MEASURING):
                evaluation = self._training_run.final_evaluation()
            if evaluation is not None:
                self._note_evaluation(evaluation)
                self._notes.append(
                    f"Held out: {evaluation.psnr:.2f} dB; side by side in {self.outputs.pictures}"
                )
        except Exception as error:
            self._note(error)
        self.on_change()

    @contextmanager
    def _doing(self, activity: str) -> Iterator[None]:
        self._tell(activity=activity)
        try:
            yield
        finally:
            self._tell(activity="")

    def _measured(self, done: int, photos: int) -> None:
        self._tell(activity=f"{MEASURING} ({done} of {photos})")

    def _keep(self) -> None:
        """Writes scene and checkpoint. After a failure, but of the user's loss, the checkpoint is left as it
        was before: that one is known to be good. Raises InputError: the scene could not be saved where it
        should."""
        with self._doing("Saving"):
            try:
                if self.status.state == "failed" and not self._sound:
                    self._training_run.save_scene()
                else:
                    self._training_run.keep()
            finally:
                self._unsaved = False  # where it went elsewhere, it is saved all the same
        iteration = self._training_run.trainer.counters.iteration
        self._tell(saved_at=iteration)
        self._notes.append(f"Saved at step {iteration:,}: {self.outputs.scene}")


def one_line(error: BaseException) -> str:
    """What went wrong, for the user."""
    text = " ".join(str(error).split())
    return text if isinstance(error, InputError) else f"{type(error).__name__}: {text}"
