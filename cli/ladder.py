"""`splatview ladder`: what accuracy costs in time, on this scene and this machine."""

from __future__ import annotations

import json
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from splatview.cli.arguments import (
    Orbit,
    Parser,
    add_camera_options,
    check_camera_options,
    chosen_orbit,
    count,
    orbit_of,
    positive,
)
from splatview.cli.main import make_console
from splatview.cli.render import check_output
from splatview.cli.train_setup import ready_kernels
from splatview.measure.knobs import KNOBS, Plan, knob
from splatview.measure.ladder import AGREEMENT, Ladder, disagreement, run_ladder, rungs_for
from splatview.measure.ladder_plot import plot
from splatview.measure.ladder_report import COLUMNS, as_json, bargains, cells, left_out_text
from splatview.measure.machine import describe_machine
from splatview.measure.training_ladder import (
    TRAINING_COLUMNS,
    TRAINING_RUNGS,
    Curve,
    Trained,
    TrainingRung,
    training_as_json,
    training_cells,
)
from splatview.renderers import automatic_choice, choices
from splatview.renderers.demo_cache import cached_demo_capture
from splatview.renderers.headless import HeadlessScene, make_headless
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.captures import Capture, load_capture
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.sh_bands import used_sh_degree
from splatview.scene.formats import load_scene
from splatview.scene.formats.cameras import camera_values
from splatview.scene.framing import robust_bounds
from splatview.trainer.evaluate import evaluate
from splatview.trainer.settings import (
    FULL_REG_LOSS,
    TrainSettings,
    automatic_dropout,
    automatic_limit,
    automatic_max_aspect,
    automatic_regularisation,
)
from splatview.trainer.torch_import import require_torch
from splatview.trainer.views import TrainView, TrainViews, train_views

if TYPE_CHECKING:  # torch is imported where something is trained
    from splatview.trainer.trainer import Trainer

# ---- `splatview ladder --train CAPTURE`: the same question asked of training, at equal seconds.


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
    require_torch()
    console = make_console()
    folder = cached_demo_capture() if name == DEMO else name
    with console.status("Reading photos"):
        capture = load_capture(folder, downscale=downscale)
        capture = capture.about(capture.centre)
    held_out = train_views(capture.held_out)
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
        print(json.dumps({**about, "seeds": seeds, "rungs": training_as_json(trained)}))
    else:
        print_training_ladder(
            make_console(stderr=False),
            trained,
            f"{Path(name).name}, {minutes:g} minutes a run, {seeds} seeds",
        )
    return 0


def train_rung(
    capture: Capture,
    held_out: list[TrainView],
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
                    trainer.splats.arrays, held_out, trainer.render_settings, threads=trainer.threads
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
    views = TrainViews(train_views(capture.train), seed)
    regularisation = automatic_regularisation(len(views))
    settings = TrainSettings(
        iterations=None,
        minutes=minutes,
        seed=seed,
        opacity_reg=regularisation,
        scale_reg=regularisation,
        full_reg_loss=FULL_REG_LOSS,
        dropout=automatic_dropout(len(views)),
        max_aspect=automatic_max_aspect(len(views)),
        background=capture.background or (0.0, 0.0, 0.0),
        max_splats=max(1, round(factor * automatic_limit(views.pixel_count, minutes))),
    )
    settings = replace(settings, **changes)
    from splatview.trainer.setup import trainer_for

    trainer = trainer_for(capture, views, settings, centre=np.zeros(3))
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


SECONDS, THOROUGH_SECONDS = 50.0, 300.0

TRAIN_MINUTES, TRAIN_SEEDS = 0.5, 2

VIEW_TURN = 40.0
"""Degrees between the views."""

FRAME_TURN = 1e-3
"""Degrees by which timed frames differ: enough that nothing is kept from the one before."""

PLOTS = (".png", ".svg", ".pdf")

EXIT_INTERRUPTED = 130


def make_parser() -> Parser:
    parser = Parser(
        "ladder",
        "Draws SCENE with each shortcut this program has, and prints what it saves in time and what it\n"
        "costs in accuracy: PSNR, SSIM and the largest error against a float64 truth. Times are taken\n"
        "beside the baseline's, pair by pair; differences below the noise floor are called the same.",
    )
    parser.add_argument("scene", metavar="SCENE", nargs="?")
    add_camera_options(parser)
    group = parser.add_argument_group("ladder")
    group.add_argument(
        "--views",
        type=count,
        metavar="N",
        help=f"on an orbit, {VIEW_TURN:g} degrees apart (default: 2; 1 where a camera is given)",
    )
    group.add_argument(
        "--renderers",
        metavar="A,B",
        help="which, the first with its defaults being the baseline (default: all, the automatic one first)",
    )
    names = ", ".join(k.name for k in KNOBS)
    group.add_argument("--knobs", metavar="A,B", help=f"which (default: all): {names}")
    group.add_argument(
        "--seconds",
        type=positive,
        metavar="S",
        help=f"how long to measure (default: {SECONDS:g}); what does not fit is left out, and named",
    )
    group.add_argument(
        "--rounds",
        type=count,
        metavar="N",
        help="instead, every shortcut so many times, however long it takes",
    )
    group.add_argument(
        "--thorough", action="store_true", help=f"{THOROUGH_SECONDS:g} seconds, for less noise"
    )
    group.add_argument("--json", action="store_true", help="results as one JSON object")
    training = parser.add_argument_group("training's ladder, instead of a scene's")
    training.add_argument(
        "--train", metavar="CAPTURE", help="train short runs, one a shortcut and seed (demo: our own photos)"
    )
    training.add_argument(
        "--minutes", type=positive, metavar="M", help=f"of each run (default: {TRAIN_MINUTES:g})"
    )
    training.add_argument(
        "--seeds", type=count, metavar="N", help=f"runs of each shortcut (default: {TRAIN_SEEDS})"
    )
    training.add_argument("--downscale", type=count, metavar="K", help="photos smaller by K (default: 1)")
    group.add_argument("--plot", type=Path, metavar="P.png", help="time against accuracy, drawn")
    return parser


def run(arguments: list[str]) -> int:
    begun = time.perf_counter()
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    if args.train is not None:
        if args.scene is not None or args.plot is not None:
            raise InputError("--train measures training: it takes neither a SCENE nor --plot")

        return run_training_ladder(
            args.train,
            minutes=args.minutes or TRAIN_MINUTES,
            seeds=args.seeds or TRAIN_SEEDS,
            downscale=args.downscale or 1,
            as_text=not args.json,
        )
    if args.scene is None:
        raise InputError("name a SCENE, or --train CAPTURE (see splatview ladder --help)")
    for name in ("minutes", "seeds", "downscale"):
        if getattr(args, name) is not None:
            raise InputError(f"--{name} goes with --train")
    check_camera_options(args)
    if args.plot is not None:
        check_output(args.plot, PLOTS)
        if find_spec("matplotlib") is None:
            raise InputError("--plot needs matplotlib: pip install 'splatview[plot]'")
    lengths = {
        "--thorough": args.thorough,
        "--seconds": args.seconds is not None,
        "--rounds": args.rounds is not None,
    }
    if sum(lengths.values()) > 1:
        given = " and ".join(name for name, is_given in lengths.items() if is_given)
        raise InputError(f"{given} all say how long; give one of them")
    knobs = None if args.knobs is None else [knob(name).name for name in args.knobs.split(",")]
    names = chosen_renderers(args.renderers)
    gaussians = load_scene(args.scene)
    orbit = chosen_orbit(args, gaussians)
    plan = Plan(settings=settings_for(gaussians))
    console = make_console()
    count_of_views = args.views or (2 if args.camera is None and args.eye is None else 1)
    views = [orbit.camera, *(orbit.turned(VIEW_TURN * number) for number in range(1, count_of_views))]
    centre, _ = robust_bounds(gaussians.means)

    def turned(camera: Camera, degrees: float) -> Camera:
        # One view is what `render` draws with the same options; of several each is in a file of cameras.
        path = orbit if len(views) == 1 else orbit_of(camera, centre)
        return path.turned_from(camera, degrees)

    scenes = [HeadlessScene(make_headless(name), gaussians, turned) for name in names]
    with console.status("Drawing the truth in float64"):
        truths, apart = draw_truths(gaussians, views, plan.settings)
    if not apart <= AGREEMENT:
        raise InputError(
            f"{args.scene}: the float64 rasteriser and the reference are {apart:.1e} apart on this scene; "
            "without a truth there is nothing to measure against"
        )
    seconds = THOROUGH_SECONDS if args.thorough else args.seconds or SECONDS
    rungs = rungs_for(scenes, plan, used_sh_degree=used_sh_degree(gaussians), knobs=knobs)
    ladder = run_with_progress(
        console,
        rungs,
        views,
        truths,
        orbit=orbit,
        seconds=max(seconds - (time.perf_counter() - begun), 1.0),
        rounds=args.rounds,
    )
    shown = f"{views[0].width}x{views[0].height}, {len(views)} view{'s' * (len(views) > 1)}"
    title = f"{Path(args.scene).name}, {len(gaussians):,} splats, {shown}"
    about = {
        "scene": Path(args.scene).name,
        "splats": len(gaussians),
        "size": [views[0].width, views[0].height],
        "cameras": [camera_values(view) for view in views],
        "truth": {"by": "float64 rasteriser", "largest_difference_from_reference": apart},
    }
    if args.json:
        print(json.dumps(as_json(ladder, about)))
    else:
        print_ladder(make_console(stderr=False), ladder, title, apart)
    if args.plot is not None:
        plot(ladder, args.plot, title=title)
        print(f"{args.plot}: the plot", file=sys.stderr)
    return 0 if ladder.complete else EXIT_INTERRUPTED


def chosen_renderers(given: str | None) -> list[str]:
    """Names of the renderers to measure, the baseline's first."""
    measured = choices("ladder")
    if given is not None:
        names = list(dict.fromkeys(given.split(",")))
        for name in names:
            if name not in measured:
                raise InputError(f"--renderers {name}: choose from {', '.join(measured)}")
        return names
    first, why = automatic_choice()
    others = [name for name in measured if name != first]
    if first == "cpu":
        from splatview.renderers.gl.context import create_headless_context, discard

        try:
            discard(create_headless_context())
        except InputError as error:
            print(f"splatview: only cpu is measured: {error} ({why})", file=sys.stderr)
            return [first]
    return [first, *others]


def draw_truths(
    gaussians: Gaussians, views: list[Camera], settings: RenderSettings
) -> tuple[list[np.ndarray], float]:
    """The float64 pictures of `views`, and how far the first is from the reference in sampled blocks.

    All stored SH bands, no early stop: the truth leaves out nothing, not even what cannot be seen.
    """
    from splatview.raster import Workspace, draw_frame, parameters_of

    exact = replace(settings, sh_degree=None, early_stop=0.0)
    workspace = Workspace()
    truths = [
        draw_frame(parameters_of(gaussians), view, exact, workspace, dtype=np.float64).image for view in views
    ]
    return truths, disagreement(truths[0], gaussians, views[0], exact)


def run_with_progress(
    console: Console, rungs, views, truths, *, orbit: Orbit, seconds: float, rounds: int | None
) -> Ladder:
    """Measures with a progress bar. Ctrl-C ends it early: what was measured by then is the result."""
    stopped = threading.Event()

    def moved(view: int, number: int) -> Camera:
        return orbit.turned(VIEW_TURN * view + FRAME_TURN * (number + 1))

    with Progress(
        BarColumn(), TimeElapsedColumn(), TextColumn("{task.description}"), console=console
    ) as progress:
        task = progress.add_task("", total=1.0)

        def show(share: float, text: str) -> None:
            progress.update(task, completed=share, description=text)

        with on_interrupt(stopped.set):
            return run_ladder(
                rungs,
                views,
                truths,
                moved=moved,
                seconds=seconds,
                rounds=rounds,
                on_progress=show,
                cancelled=stopped.is_set,
            )


@contextmanager
def on_interrupt(action: Callable[[], None]) -> Iterator[None]:
    """Ctrl-C does `action` instead of raising, so that no picture is left half drawn. Main thread only."""
    previous = signal.signal(signal.SIGINT, lambda *_: action())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)


def print_ladder(console: Console, ladder: Ladder, title: str, apart: float) -> None:
    """The table that a person reads: by renderer, the Pareto front starred and bold."""
    # Without lines between columns it fits a terminal of 80.
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column(COLUMNS[0], no_wrap=True)
    for column in COLUMNS[1:]:
        table.add_column(column, justify="right", no_wrap=True)
    last = None
    for one in ladder.rungs:
        renderer = one.rung.renderer.name
        if last not in (None, renderer):
            table.add_section()
        last = renderer
        name, *rest = cells(one, ladder)
        star = "* " if one.pareto else "  "
        table.add_row(star + name, *rest, style="bold" if one.pareto else None)
    console.print(table)
    base = ladder.baseline.rung.renderer.name
    console.print(
        f"ms: of a frame; time: of {base} with its defaults, drawn in turn with it; same: not to be told"
        f" from chance. Noise floor: ±{ladder.noise:.0%} ({base} against itself, {ladder.rounds} pairs;"
        " more for slow rungs, which have fewer)."
        " ±: half the quartiles' distance. PSNR (dB), SSIM and largest error: against a float64 truth,"
        f" which is within {apart:.0e} of the reference in sampled blocks. Popping: the largest change of"
        f" a pixel when the eye turns by {2 * FRAME_TURN:g}°. *: the front: faster, by more than the noise,"
        " than every * nearer to the truth; nothing else here is both faster and nearer.",
        highlight=False,
    )
    for line in bargains(ladder):
        console.print(line, style="bold")
    if ladder.left_out:
        console.print(left_out_text(ladder))
    if not ladder.complete:
        console.print("Stopped early: fewer pairs than planned.")
