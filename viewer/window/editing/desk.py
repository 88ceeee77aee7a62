"""Where the window's edits pass: one scene's document, the tool in hand, and slow work under way.

Nothing here imports ImGui, so that all of it is tested without a display.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ....edit.document import Document, Planned
from ....edit.operations.operation import Operation
from ....edit.selecting.colour import TOLERANCE
from ....edit.watch import Cancelled, Watch
from ....scene import Gaussians, InputError
from ...gl.overlay import Overlay
from .measuring import Measured
from .strokes import Stroke
from .tool_names import Depth, Place, ToolName

BRUSH_RADIUS = 24.0
"""px of the picture."""


class Job:
    """Work that may take seconds, in a thread of its own: its progress, its end, its result."""

    def __init__(self, title: str, work: Callable[[Watch], Any], done: Callable[[Any], None]):
        self.title = title
        self.progress = 0.0
        self.result: Any = None
        self.error: BaseException | None = None
        self.finish = done
        """Called with the result on the GL thread."""
        self._cancelled = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(work,), name="splatview-edit", daemon=True)
        self._thread.start()

    def _run(self, work: Callable[[Watch], Any]) -> None:
        try:
            self.result = work(Watch(progress=self._note, cancelled=self._cancelled.is_set))
        except BaseException as error:
            # Every end is the GL thread's to tell of.
            self.error = error

    def _note(self, share: float) -> None:
        self.progress = share

    def cancel(self) -> None:
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        return self._cancelled.is_set()

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()


@dataclass(eq=False, kw_only=True)
class Desk:
    """Edits of the open scene. Panels read it freely; what changes the document runs between frames."""

    document: Document
    overlay: Overlay = field(default_factory=Overlay)
    tool: ToolName = "none"
    depth: Depth = "through"
    """Whether screen tools take what is behind the surface too."""
    brush_radius: float = BRUSH_RADIUS
    tolerance: float = TOLERANCE
    """How much colours may differ, for the magic wand and the eyedropper; Oklab, black to white being 1."""
    stroke: Stroke | None = None
    """What is being drawn on the picture."""
    picked: list[Place] = field(default_factory=list)
    """Points picked so far, for the tape measure or the ground."""
    measured: Measured | None = None
    """What the tape measure said last."""
    job: Job | None = None
    problem: str | None = None
    """A line for the user, taken by the window."""
    news: str | None = None
    """Likewise, of less weight."""

    @property
    def gaussians(self) -> Gaussians:
        return self.document.gaussians

    def apply(self, operation: Operation | Planned) -> bool:
        """Does it now; returns whether something came of it. What is wrong becomes `problem`."""
        if self.job is not None:
            self.problem = f"{self.job.title} is still under way; wait for it or cancel it"
            return False
        try:
            change = self.document.apply(operation)
        except InputError as error:
            self.problem = str(error)
            return False
        self.news = change.title
        return True

    def apply_slowly(self, operation: Operation, title: str) -> None:
        """Plans it in a thread, with progress, and applies it between two frames when that is done."""
        self.start(title, lambda watch: self.document.plan(operation), self._apply_planned)

    def _apply_planned(self, planned: Planned) -> None:
        self.apply(planned)

    def start(self, title: str, work: Callable[[Watch], Any], done: Callable[[Any], None]) -> None:
        """Runs `work(watch)` in a thread and `done(result)` between frames; one job at a time."""
        if self.job is not None:
            self.problem = f"{self.job.title} is still under way; wait for it or cancel it"
            return
        self.job = Job(title, work, done)

    def advance(self) -> None:
        """Called every frame: ends a job that is done."""
        job = self.job
        if job is None or not job.done:
            return
        self.job = None
        if isinstance(job.error, Cancelled) or job.cancelled:
            self.news = f"{job.title}: cancelled, nothing was changed"
        elif isinstance(job.error, InputError):
            self.problem = str(job.error)
        elif job.error is not None:
            self.problem = f"{job.title} failed inside the program: {type(job.error).__name__}: {job.error}"
        else:
            job.finish(job.result)

    def undo(self) -> None:
        step = self.document.undo()
        self.news = f"Undone: {step.title}" if step else "Nothing to undo"

    def redo(self) -> None:
        step = self.document.redo()
        self.news = f"Redone: {step.title}" if step else "Nothing to redo"

    def close(self) -> None:
        """Ends what is under way."""
        if self.job is not None:
            self.job.cancel()
