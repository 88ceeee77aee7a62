"""`splatview train` with a window: the scene is seen to grow, and may be steered."""

from __future__ import annotations

import argparse
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console

from ...scene import InputError
from ...trainer.distributed import Alone, is_launched
from ...trainer.session import Session
from ...trainer.thread import TrainingThread
from .open_window import no_window
from .train_report import print_summary
from .train_setup import Run, prepare, ready_kernels

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
    console = Console(stderr=True)
    ready = prepare(options, console, Alone())
    console.print(opening(ready), highlight=False, soft_wrap=True)
    started += ready.uncounted + ready_kernels(console, lens=ready.has_lens)
    session = Session(
        ready.trainer,
        ready.held_out,
        ready.outputs,
        started=started,
        eval_every=options.eval_every,
        eval_seconds=EVAL_SECONDS,
        notes=ready.notes,
        effects=ready.effects,
    )
    thread = TrainingThread(session, cores=options.threads)
    with _undisturbed():
        try:
            code = _watch(ready, thread, {"rescue": lambda: _save(console, ready, thread), **window})
        except BaseException:
            _save(console, ready, thread)
            raise
        _save(console, ready, thread)
    return code


def _save(console: Console, ready: Run, thread: TrainingThread) -> None:
    """Writes what was trained, and says where it is."""
    try:
        with console.status("Saving the scene"):
            thread.close()
    finally:
        for note in thread.take_notes():
            console.print(f"[yellow]{note}", highlight=False, soft_wrap=True)
    _conclude(console, ready, thread)


def _watch(ready: Run, thread: TrainingThread, options: dict[str, Any]) -> int:
    from ..window.app import run_window
    from ..window.training.watching import Training, watched_photos
    from ..window.yielding import give_way

    training = Training(
        thread=thread,
        name=ready.capture.name,
        photos=watched_photos(ready.trainer.shots.all, ready.held_out),
        settings=ready.trainer.render_settings,
    )

    give_way()  # the training's thread is there already, and keeps its priority
    return run_window([], training=training, **options)


def _conclude(console: Console, ready: Run, thread: TrainingThread) -> None:
    """Says where everything is."""
    status, outputs = thread.status, ready.outputs
    if status.state == "done":
        print_summary(Console(), ready.trainer, status.evaluation, outputs)
    elif status.saved_at is None:
        console.print("nothing was trained, and nothing written", highlight=False)
    else:
        console.print(
            f"stopped at step {status.iteration:,}: {outputs.scene} is as far as it came;"
            f" go on with --resume {outputs.checkpoint}",
            highlight=False,
            soft_wrap=True,
        )


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
