"""What `splatview train` prints: a bar while it runs, lines of evaluations, a table at the end."""

from __future__ import annotations

import math

from rich.console import Console
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar
from rich.table import Table

from ...scene.effects import Effect
from ...trainer.evaluate import Evaluation
from ...trainer.session import Outputs, Progress
from ...trainer.training import Trainer


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


def numbers(progress: Progress, evaluation: Evaluation | None) -> str:
    """The figures behind the bar; `evaluation` is the last one."""
    step = progress.step
    text = f"step {step.iteration:,}  loss {step.loss:.4f}  {step.gaussians:,} splats"
    if evaluation is not None:
        text += f"  {evaluation.psnr:.2f} dB"
    if 0.01 < step.progress < 1:
        left = progress.seconds * (1 / step.progress - 1)
        text += f"  {math.ceil(left / 60)} min left" if left > 90 else f"  {math.ceil(left)} s left"
    return text


def effect_line(effect: Effect) -> str:
    """As `splatview info` prints it."""
    return f"  {'on ' if effect.in_force else 'off'}  {effect.name}: {effect.why}"


def evaluation_line(progress: Progress) -> str:
    step, evaluation = progress.step, progress.evaluation
    assert evaluation is not None
    return (
        f"step {step.iteration:>7,}  {progress.seconds:7.1f} s  {step.gaussians:>9,} splats"
        f"  held out: {evaluation.psnr:.2f} dB, SSIM {evaluation.ssim:.4f}"
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
    console.print(
        f"{outputs.scene}: {len(trainer.splats):,} splats, {counters.iteration:,} steps in"
        f" {counters.seconds:.1f} s",
        highlight=False,
        soft_wrap=True,
    )
    if evaluation is not None:
        console.print(f"side by side: {outputs.pictures}", highlight=False, soft_wrap=True)
