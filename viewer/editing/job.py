"""Slow work on the document of an edit session."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal

from splatview.scene.compiling import be_nicer
from splatview.scene.errors import printable
from splatview.scene.progress import Progress
from splatview.viewer.tasks import Task

Yields = Literal["no", "silently", "with a word"]
"""Whether work is dropped where the user edits or starts other work: silently only what nobody asked for."""


NICER = 5
"""Linux weighs such a thread 335 against 1,024 (sched(7)). While splats were counted on all cores, which draw
the window too where there is no GPU, a click was answered after 118 ms at equal priority, 68 at this."""


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

        def begin(_: Task[Any]) -> Any:
            be_nicer(NICER)
            return work(Progress(report=self.report, cancelled=lambda: self.cancelled))

        super().__init__(begin, name="splatview-edit")
