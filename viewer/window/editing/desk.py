"""Where the window's edits pass: one scene's document, the tool in hand, and slow work under way.

Nothing here imports ImGui, so that all of it is tested without a display.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ....edit.document import Document, Planned
from ....edit.journal import Journal
from ....edit.operations.operation import Operation
from ....edit.price import unchanging
from ....edit.selecting.colour import TOLERANCE
from ....edit.watch import Cancelled, Watch
from ....scene import Gaussians, InputError
from ....scene.edits import PREVIEW, SceneEdits
from ...gl.overlay import Overlay
from ..loading import Stamp
from .forms import Forms
from .measuring import Measured
from .strokes import Stroke
from .tool_names import Depth, Place, ToolName

if TYPE_CHECKING:
    from ..training.held import Trainee

BRUSH_RADIUS = 24.0
"""px of the picture."""


class Job:
    """Work that may take seconds, in a thread of its own: its progress, its end, its result."""

    def __init__(
        self,
        title: str,
        work: Callable[[Watch], Any],
        done: Callable[[Any], None],
        *,
        gives_way: bool = False,
    ):
        self.title = title
        self.gives_way = gives_way
        """Nobody asked for it: it is dropped where the user edits."""
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

    def join(self, timeout: float) -> None:
        self._thread.join(timeout)

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
    forms: Forms = field(default_factory=Forms)
    highlight: np.ndarray | None = None
    """(N,) bool: splats that a tool would take, lit up on the picture until the next edit; never written
    to."""
    trainee: Trainee | None = None
    """Where the scene is in training: what edits mean to the trainer."""
    journal: Journal | None = None
    stamps: dict[Path, Stamp] = field(default_factory=dict)
    """Of the files that are open, as they were read or as they were exported over since."""
    pivot: tuple[object, Place] | None = None
    """What it is of, and the middle that transforms turn about."""
    seen_position: int = -1
    """Of the history, when its panel was drawn last."""
    loading: tuple[Gaussians, Generator[float]] | None = None
    """A changed scene on its way to the picture."""
    loaded: Gaussians | None = None
    """What the picture holds; None: the document's own scene."""
    stroke: Stroke | None = None
    """What is being drawn on the picture."""
    picked: list[Place] = field(default_factory=list)
    """Points picked so far, for the tape measure or the ground."""
    measured: Measured | None = None
    """What the tape measure said last."""
    job: Job | None = None
    problem: str | None = None
    """A line for the user, taken by the window."""
    _shown: tuple[object, SceneEdits] | None = None
    _latest: SceneEdits | None = None
    _held: SceneEdits | None = None
    _highlighted: np.ndarray | None = None
    _highlighted_at: object = None
    news: str | None = None
    """Likewise, of less weight."""

    @property
    def gaussians(self) -> Gaussians:
        return self.document.gaussians

    @property
    def edits(self) -> SceneEdits:
        """Those of the document, and the highlight: what the picture is drawn with."""
        if self._held is not None:
            return self._held
        if (
            self.loaded is not None
            and self.loaded is not self.document.gaussians
            and self._latest is not None
        ):
            # The picture still holds the scene of before: it is shown as it was until the new one is there.
            return self._latest
        self._latest = edits = self.document.edits
        mask = self.highlight
        versions = self.document.versions
        if mask is not None and self._highlighted is not mask:
            self._highlighted, self._highlighted_at = mask, versions
        if mask is None or self._highlighted_at != versions:
            self.highlight = self._highlighted = None
            return edits
        key = (versions, id(mask))
        if self._shown is None or self._shown[0] != key:
            marks = edits.marks | np.where(mask, np.uint32(PREVIEW), np.uint32(0))
            lit = replace(edits, marks=marks, changes=(), flags=edits.flags | PREVIEW)
            self._shown = (key, lit)
        return self._shown[1]

    def preview(self, section: str, operation: Operation) -> None:
        """Shows what `operation` would do, until it is committed or cancelled."""
        if (self.job is not None and not self.job.gives_way) or self._refused(operation):
            return
        self._busy()
        try:
            self.document.preview(operation)
            self.forms.previewing = section
        except InputError as error:
            self.forms.previewing = ""
            self.problem = str(error)

    def commit_preview(self) -> None:
        change = self.document.commit_preview()
        self.forms.previewing = ""
        if change is not None:
            self.news = change.title

    def cancel_preview(self) -> None:
        self.document.cancel_preview()
        self.forms.previewing = ""

    def _busy(self) -> bool:
        """Says so where a job is under way: nothing may change beneath it, unless it gives way."""
        if self.job is not None and self.job.gives_way:
            self.job.cancel()
            self.job = None
        if self.job is not None:
            self.problem = f"{self.job.title} is still under way; wait for it or cancel it"
        return self.job is not None

    def _refused(self, operation: Operation) -> bool:
        """Says so where it cannot be done in training."""
        refusal = self.trainee.refusal(operation) if self.trainee else None
        self.news = refusal or self.news
        return refusal is not None

    def _final(self) -> bool:
        """Says so where the trainer has been told of what would be undone."""
        final = self.trainee.final if self.trainee else None
        self.news = final or self.news
        return final is not None

    def jump(self, position: int) -> None:
        """Undoes or redoes until `position` steps are in force."""
        if not self._busy() and not self._final():
            self.document.jump(position)

    def apply(self, operation: Operation | Planned) -> bool:
        """Does it now; returns whether something came of it. What is wrong becomes `problem`."""
        if self._busy() or self._refused(
            operation.operation if isinstance(operation, Planned) else operation
        ):
            return False
        try:
            change = self.document.apply(operation)
        except InputError as error:
            self.problem = str(error)
            return False
        self.news = change.title
        if self.trainee is not None:
            self.trainee.edited(self.document)
        return True

    def apply_slowly(
        self, operation: Operation, title: str, *, then: Callable[[], object] = lambda: None
    ) -> None:
        """Plans it in a thread, with progress, and applies it between two frames when that is done; `then`
        is called if something came of it."""
        if self._refused(operation):
            return

        def done(planned: Planned) -> None:
            if self.apply(planned):
                then()

        self.start(title, lambda watch: self.document.plan(operation, watch=watch), done)

    def start(
        self,
        title: str,
        work: Callable[[Watch], Any],
        done: Callable[[Any], None],
        *,
        edits: bool = False,
        gives_way: bool = False,
    ) -> None:
        """Runs `work(watch)` in a thread and `done(result)` between frames; one job at a time. Where it
        `edits` the document, the picture stays as it was until it has ended. One that `gives_way` is dropped
        without a word where the user edits or starts another."""
        if self._busy():
            return
        if edits:
            self._held = unchanging(self.edits)
        self.job = Job(title, work, done, gives_way=gives_way)

    def advance(self) -> None:
        """Called every frame: ends a job that is done."""
        job = self.job
        if job is None or not job.done:
            return
        self.job, self._held = None, None
        if isinstance(job.error, Cancelled) or job.cancelled:
            self.news = f"{job.title}: cancelled, nothing was changed"
        elif isinstance(job.error, InputError):
            self.problem = str(job.error)
        elif job.error is not None:
            self.problem = f"{job.title} failed inside the program: {type(job.error).__name__}: {job.error}"
        else:
            job.finish(job.result)

    def undo(self) -> None:
        if self._busy() or self._final():
            return
        step = self.document.undo()
        self.news = f"Undone: {step.title}" if step else "Nothing to undo"

    def redo(self) -> None:
        if self._busy() or self._final():
            return
        step = self.document.redo()
        self.news = f"Redone: {step.title}" if step else "Nothing to redo"

    def close(self) -> None:
        """Ends what is under way. Edits that are in no file stay in the journal, for the next start."""
        if self.job is not None:
            self.job.cancel()
        if self.journal is not None:
            self.journal.close(keep=self.document.history.modified)
