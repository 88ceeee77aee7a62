"""What the window calls to train on photos: the run of `splatview train`, readied beside its frame loop."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from splatview.cli.main import make_console
from splatview.scene import InputError
from splatview.viewer.training.start import StartedTraining


class ReportingConsole:
    """Console of a run that a window shows: the work under way goes to `report`, whole lines to `lines`."""

    def __init__(self, report: Callable[[str], None]) -> None:
        self.lines: list[str] = []
        self._report = report

    def print(self, text: str, **_: Any) -> None:
        self.lines.append(text)

    @contextmanager
    def status(self, title: str) -> Iterator[ReportingConsole]:
        self.update(title)
        yield self

    def update(self, title: str) -> None:
        self._report(title)


def start_from_window(arguments: Sequence[str], report: Callable[[str], None]) -> StartedTraining:
    """A `viewer.training.start.Starter`."""
    started = time.perf_counter()
    from splatview.cli import train  # torch and numba come with it

    options = train.make_parser().parse(arguments)
    if options is None:
        raise InputError("the window asked for help on training")
    # Pillow reports damaged notes of cameras, of photos that can be read all the same.
    warnings.filterwarnings("ignore", category=UserWarning, module="PIL")
    console: Any = ReportingConsole(report)
    ready, thread = train.background_training(options, console, started, train.opening_lines)
    return StartedTraining(
        training=train.watched(ready, thread),
        notes=tuple(console.lines),
        finish=lambda: train.save_run(make_console(), ready, thread),
    )
