"""The session of a scene under edit: its document, its tool, its slow work.

Nothing here imports ImGui, so that all of it is tested without a display.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from splatview.edit.document import Document, Planned
from splatview.edit.impact import frozen
from splatview.edit.journal import Journal
from splatview.edit.operations import (
    Grow,
    Operation,
    Select,
    SelectAll,
    SelectDetected,
    SelectFile,
    SelectInverse,
)
from splatview.edit.operations.base import Scope
from splatview.edit.selectors.attributes import TOLERANCE
from splatview.edit.state import SceneFile
from splatview.renderers.request import Highlight, Tint
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import PREVIEW, SceneEdits
from splatview.scene.progress import Cancelled, Progress
from splatview.viewer.editing.job import Job, Yields
from splatview.viewer.editing.selection_colour import selection_tint
from splatview.viewer.editing.target import EditTarget, SceneTarget
from splatview.viewer.editing.tool_state import (
    CROPPING,
    TRANSFORMING,
    Depth,
    Forms,
    Measured,
    Mode,
    MoveForm,
    Place,
    Stroke,
    Subject,
    ToolName,
)
from splatview.viewer.loading import Stamp

LOOK = "look"
"""Section whose previews change opacity, size and colour."""

TRANSFORM = "Transform"
"""Section and handles that move, rotate and scale."""

BRUSH_RADIUS = 24.0
"""px of the picture."""


SELECTS = (Select, SelectAll, SelectInverse, SelectDetected, SelectFile, Grow)
"""Operations after which a transform is of the selection."""


@dataclass(eq=False, kw_only=True)
class EditSession:
    """Edits of the open scene. Panels read it freely; what changes the document runs between frames."""

    document: Document
    tool: ToolName = "none"
    mode: Mode = "set"
    """How the tools that select combine with the selection, where no key is held."""
    depth: Depth = "through"
    """Whether screen tools take what is behind the surface too."""
    brush_radius: float = BRUSH_RADIUS
    tolerance: float = TOLERANCE
    """How much colours may differ, for the magic wand and the eyedropper; Oklab, black to white being 1."""
    forms: Forms = field(default_factory=Forms)
    preview_mask: np.ndarray | None = None
    """(N,) bool: splats that a tool would take, highlighted until the next edit; never written to."""
    preview_of: str = ""
    """Title of the section that the highlight belongs to and is seen with; "" where it is always seen."""
    target: EditTarget = field(default_factory=SceneTarget)
    journal: Journal | None = None
    stamps: dict[Path, Stamp] = field(default_factory=dict)
    """Stamps of the open files, as they were read or last exported over."""
    pivot: tuple[object, Place] | None = None
    """Centre of transforms, after the scope and versions that it is of."""
    told_floor: int = 0
    """Steps that the user knows to be past undoing."""
    seen_position: int = -1
    """Position in the history when its panel was drawn last."""
    loading: tuple[Gaussians, Generator[float]] | None = None
    """Changed scene on its way to the picture, and the steps left."""
    loaded: Gaussians | None = None
    """Splats that the picture holds; None before the first frame."""
    stroke: Stroke | None = None
    """Stroke being drawn on the picture."""
    picked: list[Place] = field(default_factory=list)
    """Points picked so far, for the tape measure or the ground."""
    measured: Measured | None = None
    """Last distance of the tape measure."""
    job: Job | None = None
    problem: str | None = None
    """Error for the user, in one line, taken by the window."""
    _shown: tuple[object, SceneEdits] | None = None
    _latest: SceneEdits | None = None
    _held: SceneEdits | None = None
    _previewed: np.ndarray | None = None
    _previewed_at: object = None
    news: str | None = None
    """Message for the user, in one line, taken by the window."""
    given_up: str | None = None
    """The same of a job that was dropped."""

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
        mask = self.preview_mask
        versions = self.document.versions
        if mask is not None and self._previewed is not mask:
            self._previewed, self._previewed_at = mask, versions
        if mask is None or self._previewed_at != versions:
            self.preview_mask = self._previewed = None
            return edits
        if self.preview_of and self.preview_of not in self.forms.sections:
            return edits
        key = (versions, id(mask))
        if self._shown is None or self._shown[0] != key:
            marks = edits.marks | np.where(mask, np.uint32(PREVIEW), np.uint32(0))
            lit = replace(edits, marks=marks, changes=(), flags=edits.flags | PREVIEW)
            self._shown = (key, lit)
        return self._shown[1]

    @property
    def active_file(self) -> SceneFile | None:
        """The file whose row is active; None where none is."""
        at, files = self.forms.file, self.document.files
        return files[at] if 0 <= at < len(files) and not files[at].removed else None

    def activate_file(self, number: int) -> None:
        """Makes a row active, and its file what handles transform; -1: none."""
        self.cancel_preview()
        self.forms.file, self.forms.move = number, MoveForm()
        self.forms.scope = "file" if number >= 0 else "selection"

    @property
    def highlight(self) -> Highlight:
        """Tints of the picture: none of the selection while its look is changed, which they would hide."""
        selected = (0, 0, 0, 0) if self.forms.previewing == LOOK else self.selection_tint
        return Highlight(selected=selected)

    @cached_property
    def selection_tint(self) -> Tint:
        """Tint of selected splats, which stays as long as the session."""
        return selection_tint(self.document.gaussians)

    @property
    def handles(self) -> str:
        """Handles on the picture: "Transform", "Crop", or "" where there are none."""
        forms = self.forms
        if self.tool in TRANSFORMING:
            file = self.active_file if self.subject == "file" else None
            return TRANSFORM if self.target.at_rest and not (file and file.locked) else ""
        chosen = 0 <= forms.crop < len(self.document.crops)
        in_hand = self.tool in CROPPING or "Crop" in forms.sections
        return "Crop" if chosen and in_hand else ""

    @property
    def scope(self) -> Scope:
        """Splats that a change of colours is of: all where none is selected."""
        return "selection" if self.document.counts.selected and self.forms.scope != "scene" else "scene"

    @property
    def subject(self) -> Subject:
        """What a transform is of: the active file, as long as nothing else was chosen or selected."""
        return "file" if self.forms.scope == "file" and self.active_file is not None else self.scope

    def preview(self, section: str, operation: Operation) -> None:
        """Shows what `operation` would do, until it is committed or cancelled."""
        if (self.job is not None and self.job.yields == "no") or self._refused(operation):
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
        if self.job is not None and self.job.yields != "no":
            if self.job.yields == "with a word":
                self.given_up = f"{self.job.title} was given up for what followed"
            self.give_way()
        if self.job is not None:
            self.problem = f"{self.job.title} is still under way; wait for it or cancel it"
        return self.job is not None

    def _refused(self, operation: Operation) -> bool:
        """Says so where it cannot be done in training."""
        refusal = self.target.refusal(operation)
        self.news = refusal or self.news
        return refusal is not None

    def _final(self) -> bool:
        """Says so where the trainer has been told of what would be undone."""
        final = self.target.final
        self.news = final or self.news
        return final is not None

    def jump(self, position: int) -> None:
        """Undoes or redoes until `position` steps are in force."""
        if self._busy() or self._final():
            return
        try:
            self.document.jump(position)
        except InputError as error:
            self.problem = str(error)

    def apply(self, operation: Operation | Planned) -> bool:
        """Does it now; returns whether something came of it. What is wrong becomes `problem`."""
        of = operation.operation if isinstance(operation, Planned) else operation
        if self._busy() or self._refused(of):
            return False
        try:
            change = self.document.apply(operation)
        except InputError as error:
            self.problem = str(error)
            return False
        self.news = change.title
        if isinstance(of, SELECTS) and self.forms.scope == "file":
            self.forms.scope = "selection"  # what was chosen last counts
        self.target.edited(self.document)
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

        self.start(title, lambda progress: self.document.plan(operation, progress=progress), done)

    def start(
        self,
        title: str,
        work: Callable[[Progress], Any],
        done: Callable[[Any], None],
        *,
        edits: bool = False,
        yields: Yields = "no",
    ) -> bool:
        """Runs `work(progress)` in a thread and `done(result)` between frames; one job at a time. Where it
        `edits` the document, the picture stays as it was until it has ended. One that `yields` is dropped
        where the user edits or starts another. Whether it has begun."""
        if self._busy():
            return False
        if edits:
            self._held = frozen(self.edits)
        self.job = Job(title, work, done, yields=yields)
        return True

    def give_way(self) -> None:
        """Drops work that yields."""
        if self.job is not None and self.job.yields != "no":
            self.job.cancel()
            self.job = None

    def advance(self) -> None:
        """Called every frame: ends a job that is done, forgets a preview that undo or a step has ended, and
        tells of steps that are past undoing now."""
        if self.document.previewed is None:
            self.forms.previewing = ""
        history = self.document.history
        if history.floor > self.told_floor:
            self.told_floor = history.floor
            forgotten = f"undo has used up its memory: the oldest steps ({history.floor:,}) are final now"
            self.news = "; ".join(filter(None, (self.news, forgotten)))
        job = self.job
        if job is None or not job.done:
            return
        self.job, self._held, job.ended = None, None, True
        if isinstance(job.error, Cancelled) or job.cancelled:
            self.news = f"{job.title}: cancelled, nothing was changed"
        elif isinstance(job.error, InputError):
            self.problem = str(job.error)
        elif job.error is not None:
            self.problem = f"{job.title} failed inside the program: {type(job.error).__name__}: {job.error}"
        else:
            job.finish(job.result)

    def take_tool(self, tool: ToolName) -> None:
        self.tool = tool
        self.stroke = None
        self.picked.clear()

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

    def before_writing(self, target: Path) -> None:
        """What steps start from stays, if it is in `target`. To be called in the thread that writes."""
        if self.journal is not None:
            self.journal.keep(target)

    def written(self, target: Path) -> None:
        """`target` holds the steps in force, if those count as saved."""
        if self.journal is not None and not self.document.history.modified:
            self.journal.saved(target)

    def close(self) -> None:
        """Ends what is under way. Edits that are in no file stay in the journal, for the next start."""
        if self.job is not None:
            self.job.cancel()
        if self.journal is not None:
            self.journal.close(keep=self.document.history.unsaved)
