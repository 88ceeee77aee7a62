"""`splatview train`: photos in, a scene out."""

from __future__ import annotations

import argparse
import math
import os
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table

from splatview.cli.arguments import Parser, colour, count, downscale, index, memory, positive
from splatview.cli.main import EXIT_BAD_INPUT, EXIT_INTERRUPTED, make_console, no_window
from splatview.cli.train_setup import Run, ToldElsewhere, prepare, process_age, ready_kernels, say
from splatview.scene import InputError
from splatview.scene.captures import DEFAULT_LENS_USE, LensUse, MaskUse
from splatview.scene.effects.effect import Effect
from splatview.scene.formats import named_output
from splatview.trainer.background import BackgroundTraining
from splatview.trainer.counters import PluginError
from splatview.trainer.distributed import (
    Alone,
    Group,
    PeerLost,
    Processes,
    is_launched,
    stopping_between_steps,
)
from splatview.trainer.evaluate import Evaluation
from splatview.trainer.photo_size import LARGEST_SIDE
from splatview.trainer.run import EVALUATE_EVERY, Outputs, RunProgress, TrainingRun
from splatview.trainer.settings import PAPER_ITERATIONS
from splatview.trainer.strategies import STRATEGIES

if TYPE_CHECKING:  # torch is imported while photos are read
    from splatview.trainer.trainer import Trainer

if TYPE_CHECKING:
    from splatview.viewer.training.live import LiveTraining
    from splatview.viewer.training.start import StartedTraining


def make_bar(console: Console) -> Bar:
    """Its tasks have a field "numbers", see `numbers`."""
    return Bar(
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[numbers]}"),
        console=console,
        refresh_per_second=4,
    )


def numbers(progress: RunProgress, evaluation: Evaluation | None) -> str:
    """The figures behind the bar; `evaluation` is the last one."""
    step = progress.step
    text = f"step {step.iteration:,}  loss {step.loss:.4f}  {step.gaussians:,} splats"
    if evaluation is not None:
        text += f"  {evaluation.psnr:.2f} dB"
    if 0.01 < step.progress < 1:
        left = progress.seconds_left
        text += f"  {math.ceil(left / 60)} min left" if left > 90 else f"  {math.ceil(left)} s left"
    return text


def effect_line(effect: Effect) -> str:
    """As `splatview info` prints it."""
    return f"  {'on ' if effect.in_force else 'off'}  {effect.name}: {effect.why}"


def evaluation_line(progress: RunProgress, photos: int) -> str:
    """Where a run stands that was just measured, by some of so many held-out photos."""
    step, evaluation = progress.step, progress.evaluation
    assert evaluation is not None
    some = f" ({len(evaluation.scores)} of {photos} photos)" if len(evaluation.scores) < photos else ""
    return (
        f"step {step.iteration:>7,}  {progress.seconds:7.1f} s  {progress.splats:>9,} splats"
        f"  held out: {evaluation.psnr:.2f} dB, SSIM {evaluation.ssim:.4f}{some}"
    )


def print_summary(
    console: Console, trainer: Trainer, evaluation: Evaluation | None, outputs: Outputs
) -> None:
    """The table of held-out photos, and where everything is."""
    counters = trainer.counters
    if evaluation is not None:
        table = Table("held-out photo", "PSNR dB", "SSIM")
        for score in evaluation.scores:
            table.add_row(score.name, f"{score.psnr:.2f}", f"{score.ssim:.4f}")
        table.add_row("mean", f"{evaluation.psnr:.2f}", f"{evaluation.ssim:.4f}", style="bold")
        console.print(table)
    say(
        console,
        f"{outputs.scene}: {len(trainer.scene):,} splats, {counters.iteration:,} steps in"
        f" {counters.seconds:.1f} s",
    )
    if evaluation is not None:
        say(console, f"side by side: {outputs.pictures}")


EVAL_SECONDS = 4.0
"""Between evaluations, if they cost little: a curve that somebody watches needs more points."""


def check_window() -> None:
    """Raises InputError: there can be no window here."""
    if is_launched():
        raise InputError("several processes train without a window; add --headless")
    problem = no_window()
    if problem is not None:
        raise InputError(f"{problem}; add --headless to train without a window")


def train_in_window(
    options: argparse.Namespace, started: float, opening: Callable[[Run], str], **window: Any
) -> int:
    """Trains while somebody watches, until the window is closed; returns the exit code.

    `started`: time.perf_counter() of the process's begin; `opening` says what is about to be trained;
    `window` goes to `run_window`.
    """
    console = make_console()
    ready, thread = background_training(options, console, started, opening)
    with _undisturbed():
        try:
            code = _watch(ready, thread, {"rescue": lambda: save_run(console, ready, thread), **window})
        except BaseException:
            save_run(console, ready, thread)
            raise
        save_run(console, ready, thread)
    return code


def background_training(
    options: argparse.Namespace, console: Console, started: float, opening: Callable[[Run], str]
) -> tuple[Run, BackgroundTraining]:
    """The run that a window watches, its thread waiting to begin; arguments as of `train_in_window`."""
    ready = prepare(options, console, Alone(), window=True)
    say(console, opening(ready))
    strategies = (ready.trainer.settings.strategy,)
    started += ready.uncounted + ready_kernels(console, lens=ready.has_lens, strategies=strategies)
    run = TrainingRun(
        ready.trainer,
        ready.held_out,
        ready.outputs,
        started=started,
        eval_every=options.eval_every,
        eval_seconds=EVAL_SECONDS,
        notes=ready.notes,
        effects=ready.effects,
        memory=ready.memory,
    )
    return ready, BackgroundTraining(run, cores=options.threads)


def save_run(console: Console, ready: Run, thread: BackgroundTraining) -> None:
    """Writes what was trained, and says where it is."""
    try:
        with console.status("Saving the scene"):
            thread.close()
    finally:
        for note in thread.take_notes():
            say(console, note, "yellow")
    _conclude(console, ready, thread)


def _watch(ready: Run, thread: BackgroundTraining, options: dict[str, Any]) -> int:
    from splatview.viewer.app import run_window
    from splatview.viewer.platform import give_way

    training = watched(ready, thread)
    give_way()  # the training's thread is there already, and keeps its priority
    return run_window([], training=training, starter=start_from_window, **options)


def watched(ready: Run, thread: BackgroundTraining) -> LiveTraining:
    """The run as a window shows it."""
    from splatview.viewer.training.live import LiveTraining, watched_photos

    return LiveTraining(
        thread=thread,
        name=ready.name,
        photos=watched_photos(ready.trainer.views.all, ready.held_out, ready.trainer.centre),
        settings=ready.trainer.shown_settings,
        memory=ready.memory,
    )


class ReportingConsole:
    """Console of a run that a window shows: the work under way goes to `report`, whole lines to `lines`."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self.lines: list[str] = []
        self._report = report

    def print(self, text: str, **_: Any) -> None:
        self.lines += text.split("\n")

    @contextmanager
    def status(self, title: str) -> Iterator[ReportingConsole]:
        self.update(title)
        yield self

    def update(self, title: str) -> None:
        self._report(title)


def start_from_window(arguments: Sequence[str], report: Callable[[str], None]) -> StartedTraining:
    """What the window calls to train on photos: a `viewer.training.start.Starter`."""
    from splatview.viewer.training.start import StartedTraining

    started = time.perf_counter()
    options = make_parser().parse(arguments)
    if options is None:
        raise InputError("the window asked for help on training")
    warnings.filterwarnings("ignore", category=UserWarning, module="PIL")
    console: Any = ReportingConsole(report)
    ready, thread = background_training(options, console, started, opening_lines)
    return StartedTraining(
        training=watched(ready, thread),
        notes=tuple(console.lines),
        finish=lambda: save_run(make_console(), ready, thread),
    )


NOTHING_TRAINED = "nothing was trained, and nothing written"


def _conclude(console: Console, ready: Run, thread: BackgroundTraining) -> None:
    """Says where everything is."""
    status, outputs = thread.status, ready.outputs
    if status.state == "done":
        print_summary(make_console(stderr=False), ready.trainer, status.evaluation, outputs)
    elif status.saved_at is None:
        console.print(NOTHING_TRAINED)
    else:
        say(console, f"stopped at step {status.iteration:,}: {_as_far(outputs)}")


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Within, a signal that asks for an end does nothing: the window, while there is one, heeds it as a click
    on its cross, and what was trained is saved whole after that."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    numbers = (signal.SIGINT, signal.SIGTERM)
    before = [signal.signal(number, lambda *_: None) for number in numbers]
    try:
        yield
    finally:
        for number, handler in zip(numbers, before, strict=True):
            signal.signal(number, handler)


def make_parser() -> Parser:
    parser = Parser(
        "train",
        "Trains a scene on the photos of CAPTURE: a folder with a COLMAP model, a transforms.json\n"
        "or a poses_bounds.npy.\n\n"
        "A window shows the scene as it grows; closing it saves what was trained.\n\n"
        "Every 8th photo is held out and measured by. Beside the scene are written a checkpoint, from\n"
        "which --resume goes on, and held-out photos side by side with what the scene shows.\n\n"
        "Several processes, on one machine or more, share each batch of photos:\n"
        "torchrun --nproc-per-node 2 --no-python splatview train CAPTURE --headless",
    )
    parser.add_argument("capture", metavar="CAPTURE", nargs="?")
    parser.add_argument("--demo", action="store_true", help="train on pictures of the demo scene instead")
    parser.add_argument(
        "-o",
        "--output",
        type=output_path,
        metavar="OUT",
        help="scene to write, in any format; NAME/: a folder of .sog (default: CAPTURE's name)",
    )
    parser.add_argument("--headless", action="store_true", help="train without a window")
    group = parser.add_argument_group("length")
    group.add_argument(
        "--iterations",
        type=count,
        metavar="N",
        help=f"steps (default: {PAPER_ITERATIONS:,}, fewer for few photos)",
    )
    group.add_argument(
        "--minutes",
        type=positive,
        metavar="M",
        help="train for M minutes, all included but what is compiled once and the last measurement",
    )
    group = parser.add_argument_group("recipe")
    group.add_argument(
        "--downscale",
        type=downscale,
        metavar="K",
        help=f"photos smaller by K each way (default: auto: to {LARGEST_SIDE} px at most, and smaller where"
        " --minutes or memory ask for it)",
    )
    group.add_argument(
        "--lens",
        choices=get_args(LensUse),
        help="photos whose lens is no pinhole: train through it, or take its distortion out of them first "
        f"(default: {DEFAULT_LENS_USE})",
    )
    group.add_argument(
        "--masks",
        choices=get_args(MaskUse),
        help="where a photo's mask is black it is not compared, or nothing is there, as in a transparent "
        "photo (default: ignore)",
    )
    group.add_argument("--strategy", choices=tuple(STRATEGIES), help="density control (default: mcmc)")
    group.add_argument(
        "--max-splats", type=count, metavar="N", help="most splats (default: by the photos' pixels)"
    )
    group.add_argument(
        "--batch",
        type=count,
        metavar="B",
        help="photos a step (default: 1, or up to 4 where there is time for it, or one for each process)",
    )
    group.add_argument(
        "--coarse",
        type=levels,
        metavar="SHARE:K,..",
        help="photos smaller by K until this share of the run, or none or auto, for as long as they teach"
        " (default: 0.3:2, and smaller ones until 0.8 where --minutes has no steps enough for all pixels)",
    )
    group.add_argument(
        "--start",
        choices=("auto", "points", "stereo"),
        help="where splats begin: at the capture's points, or also where stereo finds surfaces"
        " (default: auto: by stereo where the capture has few points)",
    )
    group.add_argument(
        "--exposure",
        choices=("auto", "on", "off"),
        help="learn each photo's exposure (default: auto, where photos differ)",
    )
    group.add_argument(
        "--shading",
        choices=("auto", "on", "off"),
        help="learn a coarse map of gains for each photo, for shadows and other light that falls on it alone"
        " (default: auto, where few photos show each place)",
    )
    group.add_argument(
        "--outliers",
        choices=("auto", "off"),
        help="leave out photos that disagree with the others, as those of a wrong pose do (default: auto)",
    )
    group.add_argument(
        "--passing",
        choices=("auto", "stay"),
        help="what becomes of what one photo alone shows in front of what others do, as somebody passing by"
        " (default: auto: that part of the photo is masked, and its splats go as the run ends)",
    )
    group.add_argument(
        "--ensemble",
        choices=("auto", "off"),
        help="train other scenes, and a last one that learns from all of them: where photos are few and steps"
        " end before the minutes do, or where photos that are withheld for a while show that one scene learns"
        " single ones by heart (default: auto)",
    )
    group.add_argument(
        "--sky",
        choices=("auto", "on", "off"),
        help="far splats for what photos show at infinity (default: auto, where enough of it is above the"
        " horizon)",
    )
    group.add_argument(
        "--background",
        type=backdrop,
        metavar="BACK",
        help="what is behind the scene and under transparent photos: auto or r,g,b, 0 to 1 each (default:"
        " auto: the plain colour before which photos stand, where they do, black under transparent ones, and"
        " the mean colour of all others, where few show each place)",
    )
    group.add_argument(
        "--antialiased",
        choices=("auto", "on", "off"),
        help="train for all scales, with a kernel of 0.1 px² (default: auto, where photos differ in scale)",
    )
    group.add_argument(
        "--abs-grad",
        action="store_true",
        default=None,
        help="with --strategy classic: gradients by absolute value decide what is split",
    )
    group.add_argument(
        "--plugin",
        type=Path,
        metavar="LOSS.py",
        help="a Python file whose function loss(step) is the loss of each step; with --resume, none goes on"
        " without the one before",
    )
    group.add_argument("--seed", type=index, metavar="S", help="of all that is random (default: 0)")
    group.add_argument("--threads", type=count, metavar="T", help="default: all cores")
    group.add_argument(
        "--memory",
        type=memory,
        metavar="2GB",
        help="most memory of the run, of each process where there are several: fewer splats where it has room"
        " for no more (default: what the machine has left)",
    )
    group = parser.add_argument_group("report")
    group.add_argument(
        "--eval-every",
        type=count,
        metavar="N",
        help=f"steps (default: {EVALUATE_EVERY}, where that costs little)",
    )
    group.add_argument("--metrics", type=Path, metavar="M.jsonl", help="one JSON object a line, added to it")
    group.add_argument("--resume", type=Path, metavar="CKPT", help="go on from a checkpoint")
    return parser


def output_path(text: str) -> Path:
    """The scene to write; a slash at the end means a folder of .sog, as for `convert`."""
    return named_output(text) if text.endswith(("/", os.sep)) else Path(text)


def backdrop(text: str) -> tuple[float, float, float] | Literal["auto"]:
    """The value of --background."""
    return "auto" if text == "auto" else colour(text)


def levels(text: str) -> tuple[tuple[float, int], ...] | Literal["auto"]:
    """`0.1:4,0.3:2` or `none` as `TrainSettings.resolution`, or `auto`."""
    if text == "auto":
        return "auto"
    if text == "none":
        return ()
    pairs = [part.split(":") for part in text.split(",")]
    if not all(len(pair) == 2 for pair in pairs):
        raise argparse.ArgumentTypeError(f"must be like 0.1:4,0.3:2, none or auto, got {text!r}")
    coarse = tuple((positive(share), count(factor)) for share, factor in pairs)
    shares = [share for share, _ in coarse]
    if not (shares == sorted(set(shares)) and shares[-1] <= 1):
        raise argparse.ArgumentTypeError(f"shares of the run must grow and be at most 1, got {text!r}")
    return coarse


def run(arguments: Sequence[str]) -> int:
    """Trains; returns the exit code. Raises InputError for a user's mistake."""
    started = time.perf_counter() - process_age()
    options = make_parser().parse(arguments)
    if options is None:
        return 0
    if options.demo == (options.capture is not None):
        raise InputError("name the folder of a capture, or --demo (see splatview train --help)")
    if not options.headless:
        if is_launched():
            raise InputError("several processes train without a window; add --headless")
        check_window()
    # Pillow reports damaged notes of cameras, of photos that can be read all the same.
    warnings.filterwarnings("ignore", category=UserWarning, module="PIL")
    if not options.headless:
        return train_in_window(options, started, opening_lines)
    group = Processes() if is_launched() else Alone()
    try:
        return _train(options, group, started)
    finally:
        group.leave()


def _train(options: argparse.Namespace, group: Group, started: float) -> int:
    console = make_console(quiet=group.rank > 0)
    try:
        ready = prepare(options, console, group)
    except ToldElsewhere:
        return EXIT_BAD_INPUT
    say(console, opening_lines(ready))
    strategies = (ready.trainer.settings.strategy,)
    started += ready.uncounted + ready_kernels(console, lens=ready.has_lens, strategies=strategies)
    return _follow(ready.trainer) if group.rank > 0 else _lead(ready, options, console, started)


def opening_lines(ready: Run) -> str:
    trainer, (_, width, height) = ready.trainer, ready.trainer.views.names()[0]
    text = (
        f"{ready.name}: {len(trainer.views)} photos to train on, {len(ready.held_out)} held out,"
        f" {width}x{height} px; {len(trainer.splats):,} splats to begin with"
    )
    if trainer.group.size > 1:
        text += f"; {trainer.group.size} processes share batches of {trainer.settings.batch}"
    elif trainer.settings.batch > 1:
        text += f"; {trainer.settings.batch} photos a step"
    return "\n".join([text, f"  {ready.memory.line}", *map(effect_line, ready.effects)])


def _lead(ready: Run, options: argparse.Namespace, console: Console, started: float) -> int:
    """The run of the process that writes."""
    trainer, outputs = ready.trainer, ready.outputs
    with make_bar(console) as bar:
        task = bar.add_task("", total=1.0, numbers="")

        def show(progress: RunProgress) -> None:
            if progress.evaluation is not None:
                say(bar.console, evaluation_line(progress, len(ready.held_out)))
            bar.update(task, completed=progress.step.progress, numbers=numbers(progress, session.evaluation))

        def show_measured(done: int, photos: int) -> None:
            if trainer.done:
                step = f"step {trainer.counters.iteration:,}"
                bar.update(task, numbers=f"{step}  {done} of {photos} held-out photos measured")

        session = TrainingRun(
            trainer,
            ready.held_out,
            outputs,
            started=started,
            eval_every=options.eval_every,
            notes=ready.notes,
            effects=ready.effects,
            memory=ready.memory,
            on_progress=show,
            on_note=lambda note: say(bar.console, note, "yellow"),
            on_measured=show_measured,
        )
        try:
            with stopping_between_steps(trainer.group):
                completed = session.run()
        except (PeerLost, PluginError) as error:
            kept = _as_far(outputs) if session.has_trained else NOTHING_TRAINED
            raise InputError(f"{error}; {kept}") from None
        evaluation, is_measured = None, False
        if completed:
            with suppress(KeyboardInterrupt):
                evaluation, is_measured = session.final_evaluation(), True
    if not completed:
        say(console, f"stopped at step {trainer.counters.iteration:,}: {_as_far(outputs)}")
        return EXIT_INTERRUPTED
    if not is_measured:
        say(console, f"{outputs.scene} is whole, and was not measured on the held-out photos")
        return EXIT_INTERRUPTED
    print_summary(make_console(stderr=False), trainer, evaluation, outputs)
    return 0


def _as_far(outputs: Outputs) -> str:
    return f"{outputs.scene} is as far as it came; go on with --resume {outputs.checkpoint}"


def _follow(trainer: Trainer) -> int:
    """The run of every other process."""
    try:
        with stopping_between_steps(trainer.group):
            while not trainer.done:
                trainer.step(0.0)
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    return 0
