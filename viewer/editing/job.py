"""Slow work on the document of an edit session."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from splatview.scene.errors import printable
from splatview.scene.progress import Progress
from splatview.viewer.tasks import Task

Yields = Literal["no", "silently", "with a word"]
"""Whether work is dropped where the user edits or starts other work: silently only what nobody asked for."""


class Job(Task[Any]):
    """Slow work for a session: `work(progress)` in a thread, then `finish(result)` on the GL thread."""

    ended = False
    """Whether it is over for its session: it has succeeded, failed, or the user has cancelled it."""

    def __init__(
        self,
        title: str,
        work: Callable[[Progress], Any],
        finish: Callable[[Any], None],
        *,
        yields: Yields = "no",
    ):
        self.title = printable(title)
        self.finish = finish
        self.yields: Yields = yields
        super().__init__(
            lambda _: work(Progress(report=self.report, cancelled=lambda: self.cancelled)),
            name="splatview-edit",
        )
