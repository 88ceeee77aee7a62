"""A whole run without a window: budgets, metrics, checkpoints, Ctrl-C, and what is written at the end."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np

from ..scene import InputError
from ..scene.files import save_scene
from .checkpoint import save_checkpoint
from .evaluate import Evaluation, evaluate, side_by_side
from .shots import Shot
from .training import StepReport, Trainer

CHECKPOINT_SECONDS = 60.0
"""A kill costs at most about so much of the work."""

METRICS_STEPS = 50
"""Steps between lines of metrics, besides those of evaluations."""

MOST_PICTURES = 8
"""Side-by-side pictures that are written."""


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
        if self.scene.suffix.lower() != ".ply":
            raise InputError(f"{self.scene}: scenes are saved as .ply; give it that suffix")
        for path in (self.scene, self.checkpoint, self.metrics):
            if path is not None:
                check_writable(path)
        if self.pictures.exists() and not self.pictures.is_dir():
            raise InputError(f"{self.pictures}: is in the way of the folder for pictures; move it")


class Progress(NamedTuple):
    """What a progress bar shows."""

    step: StepReport
    seconds: float
    evaluation: Evaluation | None
    """Of this step, if it was evaluated."""


def check_writable(path: Path) -> None:
    """Makes a file beside `path` and removes it. Raises InputError where the system refuses."""
    if path.is_dir():
        raise InputError(f"{path}: is a folder; name a file in it")
    try:
        with tempfile.NamedTemporaryFile(dir=path.resolve().parent, prefix=".splatview-") as file:
            file.write(bytes(4096))
            file.flush()
        if path.exists():
            with open(path, "ab"):
                pass
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


class Session:
    """Runs a trainer to its end and keeps what it learns safe on the way."""

    def __init__(
        self,
        trainer: Trainer,
        held_out: Sequence[Shot],
        outputs: Outputs,
        *,
        started: float,
        eval_every: int,
        notes: dict[str, Any] | None = None,
        on_progress: Callable[[Progress], None] = lambda progress: None,
        on_note: Callable[[str], None] = lambda note: None,
    ) -> None:
        """`started`: time.perf_counter() of when the run, or this part of it, began; `notes` go into
        checkpoints; `on_progress` is called after every step, `on_note` with a line for the user."""
        self.trainer, self.held_out, self.outputs = trainer, list(held_out), outputs
        self.eval_every, self.notes = eval_every, notes or {}
        self.on_progress, self.on_note = on_progress, on_note
        self.evaluation: Evaluation | None = None
        """The last one."""
        self._started = started - trainer.counters.seconds
        self._checkpointed = time.perf_counter()

    @property
    def seconds(self) -> float:
        """Wall-clock time of the run, earlier parts included."""
        return time.perf_counter() - self._started

    def run(self) -> bool:
        """Trains to the end, saves the scene, and returns true; false after Ctrl-C.

        A checkpoint is written every CHECKPOINT_SECONDS, and at the end. One that cannot be written is
        told and tried again: the disk may have room by then.

        Raises:
            InputError: the scene could not be saved where it should; the message says where it is.
        """
        completed = True
        with _appended(self.outputs.metrics) as metrics:
            try:
                while not self.trainer.done:
                    self._step(metrics)
            except KeyboardInterrupt:
                completed = False
        self.trainer.counters.seconds = self.seconds
        self._checkpoint()
        self._save_scene()
        return completed

    def final_evaluation(self) -> Evaluation | None:
        """Measures the scene as it is and writes side-by-side pictures; None without held-out photos.

        Raises:
            InputError: a picture cannot be written.
        """
        if not self.held_out:
            return None
        folder = self.outputs.pictures
        wanted = {shot.camera.name for shot in self.held_out[:: -(-len(self.held_out) // MOST_PICTURES)]}

        def write(shot: Shot, picture: np.ndarray) -> None:
            if shot.camera.name in wanted:
                name = Path(shot.camera.name.replace("/", "_").replace("\\", "_")).stem
                side_by_side(shot, picture).save(folder / f"{name}.png")

        try:
            folder.mkdir(parents=True, exist_ok=True)
            return self._evaluate(write)
        except OSError as error:
            raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None

    def _step(self, metrics: TextIO | None) -> None:
        report = self.trainer.step(self.seconds)
        evaluation = None
        if self.held_out and (report.iteration % self.eval_every == 0 or self.trainer.done):
            evaluation = self.evaluation = self._evaluate(None)
        if metrics and (evaluation or report.iteration % METRICS_STEPS == 0 or self.trainer.done):
            line: dict[str, Any] = {
                "iteration": report.iteration,
                "seconds": round(self.trainer.counters.seconds, 3),
                "loss": report.loss,
                "gaussians": report.gaussians,
            }
            if evaluation:
                line |= {"psnr": evaluation.psnr, "ssim": evaluation.ssim}
            if self.trainer.done:
                stages = self.trainer.clock.milliseconds
                line["stages"] = {name: round(spent, 1) for name, spent in stages.items()}
            metrics.write(json.dumps(line) + "\n")
        if time.perf_counter() - self._checkpointed >= CHECKPOINT_SECONDS:
            self._checkpoint()
        self.on_progress(Progress(report, self.seconds, evaluation))

    def _evaluate(self, on_picture: Callable[[Shot, np.ndarray], None] | None) -> Evaluation:
        trainer = self.trainer
        return evaluate(
            trainer.splats.parameters,
            self.held_out,
            trainer.render_settings,
            threads=trainer.threads,
            on_picture=on_picture,
        )

    def _checkpoint(self) -> None:
        try:
            save_checkpoint(self.trainer, self.outputs.checkpoint, self.notes)
        except InputError as error:
            self.on_note(f"no checkpoint written: {error}")
        self._checkpointed = time.perf_counter()

    def _save_scene(self) -> None:
        scene = self.trainer.snapshot()
        try:
            save_scene(scene, self.outputs.scene)
        except InputError as error:
            handle, refuge = tempfile.mkstemp(prefix="splatview-", suffix=".ply")
            with open(handle, "wb"):
                pass
            save_scene(scene, refuge)
            raise InputError(f"{error}; the trained scene is saved as {refuge}") from None


@contextmanager
def _appended(path: Path | None) -> Iterator[TextIO | None]:
    """The file of metrics, or None. Lines are added, so that a resumed run goes on."""
    if path is None:
        yield None
        return
    with open(path, "a", encoding="utf-8", buffering=1) as file:
        yield file
