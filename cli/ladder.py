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
    downscale,
    orbit_of,
    positive,
)
from splatview.cli.main import make_console
from splatview.cli.render import check_output
from splatview.cli.stability import describe_gl
from splatview.cli.training_ladder import run_training_ladder, training_knobs
from splatview.measure.knobs import KNOBS, Plan, knob
from splatview.measure.ladder import AGREEMENT, Ladder, disagreement, run_ladder, rungs_for
from splatview.measure.ladder_plot import plot
from splatview.measure.ladder_report import COLUMNS, as_json, bargains, cells, left_out_text
from splatview.renderers import BACKENDS, automatic_choice, choices
from splatview.renderers.headless import HeadlessScene, make_headless
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.effects.overrides import settings_for
from splatview.scene.effects.sh_bands import used_sh_degree
from splatview.scene.formats import load_scene
from splatview.scene.formats.cameras import camera_values
from splatview.scene.framing import robust_bounds

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
    names, of_training = ", ".join(k.name for k in KNOBS), ", ".join(training_knobs())
    group.add_argument(
        "--knobs", metavar="A,B", help=f"which (default: all): {names}; with --train: {of_training}"
    )
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
    training.add_argument(
        "--downscale",
        type=downscale,
        metavar="K",
        help="photos smaller by K each way (default: auto, by the minutes)",
    )
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
            downscale=args.downscale or "auto",
            knobs=None if args.knobs is None else args.knobs.split(","),
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
        "opengl": describe_gl() if any(BACKENDS[name].gl_version is not None for name in names) else None,
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
