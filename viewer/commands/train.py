"""`splatview train`: photos in, a scene out."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table

from ...scene import InputError
from ...scene.captures import Capture, load_capture
from ...trainer.checkpoint import Checkpoint, load_checkpoint, restore
from ...trainer.evaluate import Evaluation
from ...trainer.initialise import initial_parameters
from ...trainer.session import Outputs, Progress, Session
from ...trainer.settings import PAPER_ITERATIONS, TrainSettings, automatic_limit, automatic_pull
from ...trainer.shots import Shots, shots_of
from ...trainer.training import Trainer
from ...trainer.warm_up import warm_up
from .arguments import Parser, count, index, positive

EXIT_INTERRUPTED = 130

COMPILED_SECONDS = 10.0
"""Loading kernels from the cache takes about two seconds; when it takes this long, they were compiled."""

EVAL_EVERY = 1000
"""Steps between evaluations where nothing else is asked for."""


def make_parser() -> Parser:
    parser = Parser(
        "train",
        "Trains a scene on the photos of CAPTURE: a folder with a COLMAP model or a transforms.json.\n\n"
        "Every 8th photo is held out and measured by. Beside the scene are written a checkpoint, from\n"
        "which --resume goes on, and held-out photos side by side with what the scene shows.",
    )
    parser.add_argument("capture", metavar="CAPTURE")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="OUT.ply", help="scene to write (default: CAPTURE's name)"
    )
    parser.add_argument("--headless", action="store_true", help="train without a window")
    group = parser.add_argument_group("length")
    group.add_argument(
        "--iterations", type=count, metavar="N", help=f"steps (default: {PAPER_ITERATIONS:,}, or --minutes)"
    )
    group.add_argument("--minutes", type=positive, metavar="M", help="end after M minutes, all included")
    group = parser.add_argument_group("recipe")
    group.add_argument("--downscale", type=count, metavar="K", help="photos smaller by K (default: 1)")
    group.add_argument("--strategy", choices=("mcmc", "classic"), help="density control (default: mcmc)")
    group.add_argument(
        "--max-splats", type=count, metavar="N", help="most splats (default: by the photos' pixels)"
    )
    group.add_argument("--seed", type=index, metavar="S", help="of all that is random (default: 0)")
    group.add_argument("--threads", type=count, metavar="T", help="default: all cores")
    group = parser.add_argument_group("report")
    group.add_argument(
        "--eval-every", type=count, default=EVAL_EVERY, metavar="N", help=f"steps (default: {EVAL_EVERY})"
    )
    group.add_argument("--metrics", type=Path, metavar="M.jsonl", help="one JSON object a line, added to it")
    group.add_argument("--resume", type=Path, metavar="CKPT", help="go on from a checkpoint")
    return parser


def run(arguments: Sequence[str]) -> int:
    """Trains; returns the exit code. Raises InputError for a user's mistake."""
    started = time.perf_counter() - process_age()
    options = make_parser().parse(arguments)
    if options is None:
        return 0
    if not options.headless:
        raise InputError("training has no window yet; add --headless")
    console = Console(stderr=True)
    checkpoint = None if options.resume is None else load_checkpoint(options.resume)
    if checkpoint is not None:
        for name in ("seed", "strategy", "max_splats"):
            if getattr(options, name) is not None:
                raise InputError(f"--{name.replace('_', '-')} is the checkpoint's; leave it out to resume")
    downscale = options.downscale or (int(checkpoint.notes.get("downscale", 1)) if checkpoint else 1)
    outputs = _outputs(options.capture, options.output, options.metrics)
    outputs.check()
    with console.status("Reading photos"):
        capture = load_capture(options.capture, downscale=downscale)
        seed = options.seed or 0 if checkpoint is None else checkpoint.settings.seed
        shots = Shots(shots_of(capture.train), seed)
        held_out = shots_of(capture.held_out)
    for warning in capture.warnings:
        console.print(f"[yellow]{warning}", highlight=False, soft_wrap=True)
    if checkpoint is None:
        trainer = _new_trainer(capture, shots, seed, options)
    else:
        trainer = _resumed_trainer(shots, checkpoint, options)
    console.print(
        f"{capture.name}: {len(trainer.shots)} photos to train on, {len(held_out)} held out,"
        f" {shots.names()[0][1]}x{shots.names()[0][2]} px; {len(trainer.splats):,} splats to begin with",
        highlight=False,
        soft_wrap=True,
    )
    started += _compile(console)
    with _bar(console) as bar:
        task = bar.add_task("", total=1.0, numbers="")

        def show(progress: Progress) -> None:
            step = progress.step
            if progress.evaluation is not None:
                bar.console.print(_evaluation_line(progress), highlight=False, soft_wrap=True)
            bar.update(task, completed=step.progress, numbers=_numbers(progress, session.evaluation))

        session = Session(
            trainer,
            held_out,
            outputs,
            started=started,
            eval_every=options.eval_every,
            notes={"downscale": downscale},
            on_progress=show,
            on_note=lambda note: bar.console.print(f"[yellow]{note}", highlight=False, soft_wrap=True),
        )
        completed = session.run()
    if not completed:
        console.print(
            f"stopped at step {trainer.counters.iteration:,}: {outputs.scene} is as far as it came;"
            f" go on with --resume {outputs.checkpoint}",
            highlight=False,
            soft_wrap=True,
        )
        return EXIT_INTERRUPTED
    evaluation = session.final_evaluation()
    _print_summary(Console(), trainer, evaluation, outputs)
    return 0


def _compile(console: Console) -> float:
    """Readies the kernels; returns the seconds that compiling took, which count against no budget."""
    begun = time.perf_counter()
    with console.status("Readying the kernels (once per installation: about a minute)"):
        warm_up()
    seconds = time.perf_counter() - begun
    if seconds < COMPILED_SECONDS:
        return 0.0
    console.print(
        f"compiling took {seconds:.0f} s, once per installation; --minutes does not count it",
        highlight=False,
        soft_wrap=True,
    )
    return seconds


def process_age() -> float:
    """Seconds since this process began, so that a budget of minutes counts starting up; 0 if unknown."""
    try:
        with open("/proc/self/stat", encoding="ascii") as file:
            ticks = int(file.read().rpartition(")")[2].split()[19])
        return max(time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK"), 0.0)
    except (OSError, AttributeError, ValueError, IndexError):  # not on Linux
        return 0.0


def _outputs(capture: str, output: Path | None, metrics: Path | None) -> Outputs:
    scene = output or Path(f"{Path(capture).resolve().name}.ply")
    return Outputs(
        scene=scene,
        checkpoint=scene.with_suffix(".checkpoint.safetensors"),
        metrics=metrics,
        pictures=scene.with_name(f"{scene.stem}-held-out"),
    )


def _new_trainer(capture: Capture, shots: Shots, seed: int, options) -> Trainer:
    iterations, minutes = options.iterations, options.minutes
    if iterations is None and minutes is None:
        iterations = PAPER_ITERATIONS
    pull = automatic_pull(len(shots))
    settings = TrainSettings(
        iterations=iterations,
        minutes=minutes,
        seed=seed,
        opacity_pull=pull,
        scale_pull=pull,
        strategy=options.strategy or "mcmc",
        background=capture.background or (0.0, 0.0, 0.0),
        max_splats=options.max_splats
        or automatic_limit(shots.pixel_count, minutes if iterations is None else None),
    )
    extent = capture.scene_radius
    parameters = initial_parameters(
        capture.points, capture.point_colours, extent, limit=settings.max_splats, seed=seed
    )
    return Trainer(shots, parameters, extent, settings, threads=options.threads)


def _resumed_trainer(shots: Shots, checkpoint: Checkpoint, options) -> Trainer:
    settings = checkpoint.settings
    if options.iterations is not None or options.minutes is not None:
        settings = replace(settings, iterations=options.iterations, minutes=options.minutes)
    trainer = Trainer(
        shots, checkpoint.splats.parameters, checkpoint.extent, settings, threads=options.threads
    )
    restore(trainer, checkpoint)
    if trainer.done:
        raise InputError(
            f"{options.resume}: its run is over; give --iterations above {trainer.counters.iteration}"
            " or more --minutes to train on"
        )
    return trainer


def _bar(console: Console) -> Bar:
    return Bar(
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        TextColumn("{task.fields[numbers]}"),
        console=console,
        refresh_per_second=4,
    )


def _numbers(progress: Progress, evaluation: Evaluation | None) -> str:
    step = progress.step
    text = f"step {step.iteration:,}  loss {step.loss:.4f}  {step.gaussians:,} splats"
    if evaluation is not None:
        text += f"  {evaluation.psnr:.2f} dB"
    if 0.01 < step.progress < 1:
        left = progress.seconds * (1 / step.progress - 1)
        text += f"  {math.ceil(left / 60)} min left" if left > 90 else f"  {math.ceil(left)} s left"
    return text


def _evaluation_line(progress: Progress) -> str:
    step, evaluation = progress.step, progress.evaluation
    assert evaluation is not None
    return (
        f"step {step.iteration:>7,}  {progress.seconds:7.1f} s  {step.gaussians:>9,} splats"
        f"  held out: {evaluation.psnr:.2f} dB, SSIM {evaluation.ssim:.4f}"
    )


def _print_summary(
    console: Console, trainer: Trainer, evaluation: Evaluation | None, outputs: Outputs
) -> None:
    counters = trainer.counters
    if evaluation is not None:
        table = Table("held-out photo", "PSNR dB", "SSIM")
        for score in evaluation.scores:
            table.add_row(score.name, f"{score.psnr:.2f}", f"{score.ssim:.4f}")
        table.add_row("mean", f"{evaluation.psnr:.2f}", f"{evaluation.ssim:.4f}", style="bold")
        console.print(table)
    console.print(
        f"{outputs.scene}: {len(trainer.splats):,} splats, {counters.iteration:,} steps in"
        f" {counters.seconds:.1f} s",
        highlight=False,
        soft_wrap=True,
    )
    if evaluation is not None:
        console.print(f"side by side: {outputs.pictures}", highlight=False, soft_wrap=True)
