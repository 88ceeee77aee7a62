"""`splatview ladder --train CAPTURE`: the same question asked of training, at equal seconds."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from ...measure.tables import describe_machine
from ...measure.training_ladder import (
    COLUMNS,
    TRAINING_RUNGS,
    Curve,
    Trained,
    TrainingRung,
    as_json,
    cells,
)
from ...scene import InputError
from ...scene.captures import Capture, load_capture
from ...trainer.evaluate import evaluate
from ...trainer.initialise import initial_parameters
from ...trainer.settings import (
    TrainSettings,
    automatic_drop,
    automatic_elongation,
    automatic_limit,
    automatic_pull,
)
from ...trainer.shots import Shot, Shots, shots_of
from ...trainer.training import Trainer
from ..demo_capture import cached_demo_capture
from .train_setup import ready_kernels

EVALUATIONS = 6
"""Points of a curve; the time they take is not the run's."""

PRECISIONS: dict[str, type[np.floating]] = {"float32": np.float32, "float64": np.float64}

DEMO = "demo"
"""For the capture's name: the photos that the program makes itself."""


def run_training_ladder(name: str, *, minutes: float, seeds: int, downscale: int, as_text: bool) -> int:
    """Trains every rung once a seed, in turn, and prints PSNR at equal seconds: a table, or JSON.
    `name`: the capture's folder, or DEMO.

    Raises:
        InputError: the capture is at fault, or has no held-out photos.
    """
    console = Console(stderr=True)
    folder = cached_demo_capture() if name == DEMO else name
    with console.status("Reading photos"):
        capture = load_capture(folder, downscale=downscale)
    held_out = shots_of(capture.held_out)
    if not held_out:
        raise InputError(f"{name}: has no held-out photos to measure by")
    ready_kernels(console)
    for rung in TRAINING_RUNGS:
        if "precision" in rung.changes:
            with console.status(f"Compiling for {rung.value}"):
                make_trainer(capture, rung, minutes, 0).step(0.0)
    trained = [Trained(rung=rung) for rung in TRAINING_RUNGS]
    runs = len(trained) * seeds
    console.print(f"{runs} runs of {minutes:g} minutes: about {runs * minutes:.0f} minutes in all")
    with Progress(
        BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"), console=console
    ) as progress:
        task = progress.add_task("", total=float(runs))
        for seed in range(seeds):
            for number, one in enumerate(trained):
                done = seed * len(trained) + number
                text = f"{one.rung.knob}: {one.rung.value}, seed {seed}"

                def show(share: float, done: int = done, text: str = text) -> None:
                    progress.update(task, completed=done + share, description=text)

                one.curves.append(train_rung(capture, held_out, one.rung, minutes, seed, show))
    if not as_text:
        about = {"machine": describe_machine(), "capture": Path(name).name, "minutes": minutes}
        print(json.dumps({**about, "seeds": seeds, "rungs": as_json(trained)}))
    else:
        print_training_ladder(
            Console(), trained, f"{Path(name).name}, {minutes:g} minutes a run, {seeds} seeds"
        )
    return 0


def train_rung(
    capture: Capture,
    held_out: list[Shot],
    rung: TrainingRung,
    minutes: float,
    seed: int,
    show: Callable[[float], None],
) -> Curve:
    """One run of so many minutes of training, evaluations not counted."""
    trainer = make_trainer(capture, rung, minutes, seed)
    begun, seconds, paused = time.perf_counter(), [], 0.0
    scores: list[float] = []
    while not trainer.done:
        now = time.perf_counter() - begun - paused
        trainer.step(now)
        show(trainer.progress)
        due = (len(scores) + 1) / EVALUATIONS
        if trainer.progress >= due or trainer.done:
            stopped = time.perf_counter()
            seconds.append(stopped - begun - paused)
            scores.append(
                evaluate(
                    trainer.splats.parameters, held_out, trainer.render_settings, threads=trainer.threads
                ).psnr
            )
            paused += time.perf_counter() - stopped
    return Curve(
        seconds=np.array(seconds),
        psnr=np.array(scores),
        steps=trainer.counters.iteration,
        gaussians=len(trainer.splats),
    )


def make_trainer(capture: Capture, rung: TrainingRung, minutes: float, seed: int) -> Trainer:
    """A trainer of the recipe that `splatview train` would take, with the rung's changes."""
    changes = dict(rung.changes)
    factor, early_stop = float(changes.pop("splats", 1.0)), changes.pop("early_stop", None)
    precision = changes.pop("precision", "float32")
    shots = Shots(shots_of(capture.train), seed)
    pull = automatic_pull(len(shots))
    settings = TrainSettings(
        iterations=None,
        minutes=minutes,
        seed=seed,
        opacity_pull=pull,
        scale_pull=pull,
        drop=automatic_drop(len(shots)),
        elongation=automatic_elongation(len(shots)),
        background=capture.background or (0.0, 0.0, 0.0),
        max_splats=max(1, round(factor * automatic_limit(shots.pixel_count, minutes))),
    )
    settings = replace(settings, **changes)
    parameters = initial_parameters(
        capture.points, capture.point_colours, capture.scene_radius, limit=settings.max_splats, seed=seed
    )
    trainer = Trainer(shots, parameters, capture.scene_radius, settings)
    trainer.picture_dtype = PRECISIONS[precision]
    if early_stop is not None:
        trainer.render_settings = replace(trainer.render_settings, early_stop=early_stop)
    return trainer


def print_training_ladder(console: Console, trained: list[Trained], title: str) -> None:
    baseline = trained[0]
    # Without lines between columns it fits a terminal of 80.
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(COLUMNS[0], no_wrap=True)
    for column in COLUMNS[1:]:
        table.add_column(column, justify="right", no_wrap=True)
    for one in trained:
        table.add_row(*cells(one, baseline), style="bold" if one is baseline else None)
    console.print(table)
    console.print(
        "Gain: against the baseline, seed by seed; “same” where the 95 % interval over seeds holds 0."
        " Seconds (s) to equal: until the PSNR that the baseline ended with. ±: 95 % by Student's t, wide for"
        " few seeds: --seeds.",
        highlight=False,
    )
