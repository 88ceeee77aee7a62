"""`splatview ladder --train CAPTURE`: what each part of the training recipe brings, at equal seconds."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from splatview.cli.main import make_console
from splatview.cli.train_setup import ready_kernels
from splatview.measure.machine import describe_machine
from splatview.measure.training_ladder import (
    BASELINE,
    TRAINING_COLUMNS,
    TRAINING_RUNGS,
    Curve,
    Trained,
    TrainingRung,
    training_as_json,
    training_cells,
)
from splatview.raster.compiling import available_threads
from splatview.renderers.demo_cache import cached_demo_capture
from splatview.scene import InputError
from splatview.scene.captures import Capture, load_capture
from splatview.trainer.evaluate import evaluate
from splatview.trainer.memory import begins_by_stereo, own_points
from splatview.trainer.photo_size import downscale_for
from splatview.trainer.settings import TrainSettings
from splatview.trainer.torch_import import require_torch
from splatview.trainer.views import TrainView, TrainViews, train_views

if TYPE_CHECKING:  # torch is imported where something is trained
    from splatview.trainer.trainer import Trainer

EVALUATIONS = 6
"""Points of a curve; the time they take is not the run's."""

PRECISIONS: dict[str, type[np.floating]] = {"float32": np.float32, "float64": np.float64}

DEMO = "demo"
"""For the capture's name: the photos that the program makes itself."""


def run_training_ladder(
    name: str,
    *,
    minutes: float,
    seeds: int,
    downscale: int | Literal["auto"],
    knobs: list[str] | None,
    as_text: bool,
) -> int:
    """Trains every rung once a seed, in turn, and prints PSNR at equal seconds: a table, or JSON.
    `name`: the capture's folder, or DEMO; `knobs`: those to measure beside the baseline, None: all.

    Raises:
        InputError: the capture is at fault, or has no held-out photos; or there is no such knob.
    """
    asked = chosen_training_rungs(knobs)
    require_torch()
    console = make_console()
    folder = cached_demo_capture() if name == DEMO else name
    with console.status("Reading photos"):
        by_time = partial(downscale_for, minutes=minutes, threads=available_threads())
        capture = load_capture(folder, downscale=by_time if downscale == "auto" else downscale)
        capture = capture.about(capture.centre)
    held_out = train_views(capture.held_out)
    if not held_out:
        raise InputError(f"{name}: has no held-out photos to measure by")
    ready_kernels(console)
    with console.status("Looking at what the capture calls for"):
        rungs, without = rungs_with_effect(asked, capture, minutes)
    for text in without:
        console.print(text, highlight=False)
    for rung in rungs:
        if "precision" in rung.changes:
            with console.status(f"Compiling for {rung.value}"):
                make_trainer(capture, rung, minutes, 0).step(0.0)
    trained = [Trained(rung=rung) for rung in rungs]
    runs = len(trained) * seeds
    console.print(f"{runs} runs of {minutes:g} minutes: about {runs * minutes:.0f} minutes in all")
    fits: bool | None = None
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

                curve, fits = train_rung(capture, held_out, one.rung, minutes, seed, show, fits)
                one.curves.append(curve)
    if not as_text:
        about = {"machine": describe_machine(), "capture": Path(name).name, "minutes": minutes}
        found = {"seeds": seeds, "without_effect": without, "exposures_fitted": bool(fits)}
        print(json.dumps({**about, **found, "rungs": training_as_json(trained)}))
    else:
        print_training_ladder(
            make_console(stderr=False),
            trained,
            f"{Path(name).name}, {minutes:g} minutes a run, {seeds} seeds",
        )
    return 0


def slug(knob: str) -> str:
    """A knob's name as it is typed."""
    return knob.lower().replace(" ", "-")


def training_knobs() -> list[str]:
    """The names that `--knobs` takes with `--train`, in the order of the ladder."""
    return list(dict.fromkeys(slug(rung.knob) for rung in TRAINING_RUNGS if rung is not BASELINE))


def chosen_training_rungs(knobs: list[str] | None) -> list[TrainingRung]:
    """The baseline and the rungs of these knobs, in the order of the ladder. Raises InputError."""
    names = training_knobs()
    for name in knobs or ():
        if name not in names:
            raise InputError(f"--knobs {name}: with --train, choose from {', '.join(names)}")
    return [rung for rung in TRAINING_RUNGS if rung is BASELINE or knobs is None or slug(rung.knob) in knobs]


def rungs_with_effect(
    rungs: Sequence[TrainingRung], capture: Capture, minutes: float
) -> tuple[list[TrainingRung], list[str]]:
    """Those that change a run on this capture, and of the others a line each that says why not."""
    baseline = make_trainer(capture, BASELINE, minutes, 0)
    present = {
        "a sky": baseline.sky is not None and baseline.sky.count > 0,
        "photos that show something everywhere, few of them each place": baseline.settings.surround
        is not None,
        "transparent photos": any(one.alpha is not None and one.alpha_known for one in baseline.views.all),
        "a plain backdrop": any(one.alpha is not None and not one.alpha_known for one in baseline.views.all),
        "points that photos show": bool((baseline.nearest_depths > 0).any()),
        "points enough of its own": not begins_by_stereo("auto", **own_points(capture)),
    }
    kept, without = [], []
    for rung in rungs:
        named = f"{rung.knob}: {rung.value} is left out:"
        if rung.needs and not present[rung.needs]:
            without.append(f"{named} the capture has not {rung.needs}")
        elif rung is not BASELINE and changed(baseline.settings, rung) == (baseline.settings, None, None):
            without.append(f"{named} that is what this capture calls for")
        else:
            kept.append(rung)
    return kept, without


def train_rung(
    capture: Capture,
    held_out: list[TrainView],
    rung: TrainingRung,
    minutes: float,
    seed: int,
    show: Callable[[float], None],
    fits: bool | None = None,
) -> tuple[Curve, bool]:
    """One run of so many minutes, in which what is done before the first step counts and evaluations do not,
    and whether held-out photos were measured after a fit of exposures: None asks for what the run says."""
    begun, seconds, paused = time.perf_counter(), [], 0.0
    trainer = make_trainer(capture, rung, minutes, seed)
    scores: dict[bool, list[float]] = {False: [], True: []}
    while not trainer.done:
        now = time.perf_counter() - begun - paused
        trainer.step(now)
        show(trainer.progress)
        due = (len(seconds) + 1) / EVALUATIONS
        if trainer.progress >= due or trainer.done:
            stopped = time.perf_counter()
            seconds.append(stopped - begun - paused)
            for fitted in (False, True) if fits is None else (fits,):
                scores[fitted].append(
                    evaluate(
                        trainer.scene.arrays,
                        held_out,
                        trainer.shown_settings,
                        threads=trainer.threads,
                        exposures_differ=fitted,
                    ).psnr
                )
            paused += time.perf_counter() - stopped
    fits = trainer.exposures.is_on if fits is None else fits
    return Curve(
        seconds=np.array(seconds),
        psnr=np.array(scores[fits]),
        steps=trainer.counters.iteration,
        gaussians=len(trainer.scene),
    ), fits


def changed(settings: TrainSettings, rung: TrainingRung) -> tuple[TrainSettings, str | None, float | None]:
    """The recipe with a rung's changes; the dtype of pictures and the early stop, None: as they are."""
    changes = dict(rung.changes)
    factor, early_stop = float(changes.pop("splats", 1.0)), changes.pop("early_stop", None)
    precision = changes.pop("precision", None)
    limit = max(1, round(factor * settings.max_splats))
    return replace(settings, max_splats=limit, **changes), precision, early_stop


def make_trainer(capture: Capture, rung: TrainingRung, minutes: float, seed: int) -> Trainer:
    """A trainer of the recipe that `splatview train` would take, with the rung's changes."""
    from splatview.trainer.setup import settings_for, trainer_for

    views = TrainViews(train_views(capture.train), seed)
    settings = settings_for(capture, views, minutes=minutes, seed=seed)
    settings, precision, early_stop = changed(settings, rung)
    trainer = trainer_for(capture, views, settings, centre=np.zeros(3), asked=rung.changes)
    if precision is not None:
        trainer.picture_dtype = PRECISIONS[precision]
    if early_stop is not None:
        trainer.render_settings = replace(trainer.render_settings, early_stop=early_stop)
    return trainer


def print_training_ladder(console: Console, trained: list[Trained], title: str) -> None:
    baseline = trained[0]
    # Without lines between columns it fits a terminal of 80.
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(TRAINING_COLUMNS[0], no_wrap=True)
    for column in TRAINING_COLUMNS[1:]:
        table.add_column(column, justify="right", no_wrap=True)
    for one in trained:
        table.add_row(*training_cells(one, baseline), style="bold" if one is baseline else None)
    console.print(table)
    console.print(
        "Gain: against the baseline, seed by seed; “same” where the 95 % interval over seeds holds 0."
        " Seconds (s) to equal: until the PSNR that the baseline ended with. ±: 95 % by Student's t, wide for"
        " few seeds: --seeds.",
        highlight=False,
    )
