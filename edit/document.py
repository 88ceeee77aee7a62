"""A document: a scene under edit with its history, applied, previewed and undone step by step."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from splatview.edit.changes import Change
from splatview.edit.operations.base import Operation
from splatview.edit.operations.select import SelectNone
from splatview.edit.state import MAX_SPLATS, State
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import bake
from splatview.scene.formats import format_of, save_scene
from splatview.scene.formats.ply_body import free_memory
from splatview.scene.progress import NO_PROGRESS, Progress


@dataclass(eq=False)
class Step:
    operation: Operation
    change: Change
    nbytes: int = 0
    """What it takes as a step of the history."""

    @property
    def title(self) -> str:
        return self.change.title


class History:
    """Undo and redo: `steps[:position]` are in force, the others can be redone.

    The position moves only after the state has been altered: a failure leaves both as they were.
    """

    def __init__(self) -> None:
        self.steps: list[Step] = []
        self.position = 0
        self.floor = 0
        """Steps that can no longer be undone, for their changes took too much memory. Recipes have them."""
        self.nbytes = 0
        """Approximate memory of all steps."""
        self._saved: Step | None = None

    def add(self, step: Step) -> None:
        """Adds a step that is in force, in place of those that could be redone."""
        self.nbytes = self.nbytes_done
        del self.steps[self.position :]
        step.nbytes = step.change.nbytes
        self.nbytes += step.nbytes
        self.steps.append(step)
        self.position += 1

    def trim(self, most: float, *, keep: int) -> None:
        """Forgets the changes of the oldest steps until all take at most `most` bytes; the last `keep` steps
        in force can always be undone."""
        while self.nbytes > most and self.floor < self.position - keep:
            step = self.steps[self.floor]
            step.change = replace(step.change, parts=())
            self.nbytes -= step.nbytes
            self.floor += 1

    def undo(self, state: State) -> Step | None:
        """The step that was undone; None where there is none."""
        if not self.can_undo:
            return None
        step = self.steps[self.position - 1]
        step.change.revert(state)
        self.position -= 1
        return step

    def redo(self, state: State) -> Step | None:
        """The step that was redone; None where there is none."""
        if not self.can_redo:
            return None
        step = self.steps[self.position]
        step.change.apply(state)
        self.position += 1
        return step

    @property
    def can_undo(self) -> bool:
        return self.position > self.floor

    @property
    def can_redo(self) -> bool:
        return self.position < len(self.steps)

    @property
    def done(self) -> list[Step]:
        """The steps in force."""
        return self.steps[: self.position]

    @property
    def nbytes_done(self) -> int:
        """Of those in force: the others go when a step is added."""
        return self.nbytes - sum(undone.nbytes for undone in self.steps[self.position :])

    def mark_saved(self, position: int | None = None) -> None:
        """Notes that the steps in force, or the first `position` of them, are in a file."""
        at = self.position if position is None else position
        self._saved = self.steps[at - 1] if at else None

    def mark_changed(self) -> None:
        """Notes that the last saved file is not what any of these steps made."""
        self._saved = ELSEWHERE

    @property
    def modified(self) -> bool:
        """Whether the steps in force differ from those last saved, or loaded."""
        return (self.steps[self.position - 1] if self.position else None) is not self._saved

    @property
    def unsaved(self) -> bool:
        """Whether a file written now would differ from the one last saved, or loaded: as `modified`, but for
        steps that only select, hide or lock."""
        if not self.modified:
            return False
        saved = 0
        if self._saved is not None:
            places = (place for place, step in enumerate(self.steps, 1) if step is self._saved)
            if (saved := next(places, -1)) < 0:
                return True  # undone, and replaced by another step
        first, last = sorted((saved, self.position))
        return any(
            step.operation.alters_file and not step.change.same_file for step in self.steps[first:last]
        )


ELSEWHERE = Step(SelectNone(), Change(title="", count=0))
"""Stands for a saved state that no step leads to."""

ROWS = 1 << 14
"""Splats that a fingerprint is made of, evenly spread: enough to tell scenes apart, in milliseconds."""


def fingerprint(gaussians: Gaussians) -> str:
    """32 hexadecimal digits that identify a scene, made of the values of ROWS splats, their number and SH
    degree; comments, extras and the byte order of the machine do not matter."""
    n = len(gaussians)
    rows = np.unique(np.linspace(0, n - 1, min(n, ROWS)).astype(np.int64)) if n else np.zeros(0, np.int64)
    digest = hashlib.blake2b(f"{n} {gaussians.sh_degree}".encode(), digest_size=16)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        values = getattr(gaussians, name)[rows]
        digest.update(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Planned:
    """An operation and the change that it would make to the document at `revision`."""

    operation: Operation
    change: Change
    revision: int


Event = Literal["apply", "undo", "redo", "preview", "cancel"]

Listener = Callable[[Event, Step], None]
"""Called after the document has changed."""


class Document(State):
    """A scene under edit, with undo and previews. Belongs to one thread, but for `plan`, which only reads.

    A selected splat is never hidden, deleted or locked; operations that change splats pass over deleted and
    locked ones.
    """

    def __init__(
        self, gaussians: Gaussians, *, name: str = "scene", budget: float = 0, **options: Any
    ) -> None:
        """`name` is that of the scene's file; `budget` is set by `allow`; the options are those of `State`.

        Raises:
            InputError: the scene has more splats than can be edited.
        """
        if len(gaussians) > MAX_SPLATS:
            raise InputError(f"{name}: has {len(gaussians):,} splats; at most {MAX_SPLATS:,} can be edited")
        options.setdefault("files", ((name, len(gaussians)),))
        super().__init__(gaussians, **options)
        self.name = name
        self.listeners: list[Listener] = []
        # Now, rather than keeping the unedited scene.
        self.identity: dict[str, Any] = {
            "name": name,
            "count": len(gaussians),
            "fingerprint": fingerprint(gaussians),
        }
        """Name, count and fingerprint of the unedited scene."""
        self.history = History()
        self.allow(budget)
        self._preview: Step | None = None

    def allow(self, budget: float) -> None:
        """Sets `budget`, in bytes; 0: half of the machine's free memory."""
        self.budget = budget or free_memory() / 2
        """Memory for what edits make beyond the scene that was opened: splats and, up to half of it, undo."""

    @property
    def room(self) -> float:
        grown = (len(self.gaussians) - self.identity["count"]) * self.gaussians.row_bytes
        return self.budget - grown - self.history.nbytes_done

    def name_files(self, name: str, paths: Sequence[Path]) -> None:
        """Before the first step: the scene is `name`, and its files are `paths`, though it was read from
        copies of them."""
        self.name = self.identity["name"] = name
        pairs = zip(self.files, paths, strict=True)
        self.set_files(tuple(replace(file, name=path.name, source=str(path)) for file, path in pairs))

    def plan(self, operation: Operation, *, progress: Progress = NO_PROGRESS) -> Planned:
        """The change that `operation` would make now; for slow ones in another thread, while nothing is
        changed.

        Raises:
            InputError: it cannot be done here.
            Cancelled: nobody waits for it any more.
        """
        revision = self.revision
        return Planned(operation, operation.plan(self, progress), revision)

    def apply(self, operation: Operation | Planned, *, keep: int = 1) -> Change:
        """Applies an operation as the next step of the history, unless it alters nothing; cancels a preview.
        Where undo would take more than half of the budget, the oldest steps can no longer be undone, but for
        the last `keep`.

        Raises:
            InputError: it cannot be done here, or the plan is out of date. Nothing has changed then.
        """
        self.cancel_preview()
        planned = operation if isinstance(operation, Planned) else self.plan(operation)
        if planned.revision != self.revision:
            raise InputError("the scene was edited in the meantime; do it again")
        step = Step(planned.operation, planned.change)
        self.highlight(None)
        if not step.change.parts:
            return step.change
        step.change.apply(self)
        return self._add(step, keep)

    def _add(self, step: Step, keep: int = 1) -> Change:
        self.history.add(step)
        self.history.trim(self.budget / 2, keep=keep)
        self._tell("apply", step)
        return step.change

    def undo(self) -> Step | None:
        """Undoes the last step, or the preview if there is one; returns it, or None."""
        if self._preview is not None:
            return self.cancel_preview()
        self.highlight(None)
        return self._told("undo", self.history.undo(self))

    def redo(self) -> Step | None:
        self.cancel_preview()
        self.highlight(None)
        return self._told("redo", self.history.redo(self))

    def jump(self, position: int) -> None:
        """Undoes or redoes until `position` steps are in force.

        Raises:
            InputError: steps before it can no longer be undone.
        """
        self.cancel_preview()
        if not 0 <= position <= len(self.history.steps):
            raise ValueError(f"position must be in 0 to {len(self.history.steps)}, got {position}")
        if position < self.history.floor:
            raise InputError(f"the oldest steps ({self.history.floor:,}) can no longer be undone")
        while self.history.position > position:
            self.undo()
        while self.history.position < position:
            self.redo()

    def preview(self, operation: Operation) -> Change:
        """Applies `operation` as a preview, in place of the one before: for gizmos and sliders being dragged.
        It becomes a step of the history only by `commit_preview`.

        Raises:
            InputError: it cannot be done here; no preview is in force then.
        """
        self.cancel_preview()
        step = Step(operation, operation.plan(self))
        self.highlight(None)
        step.change.apply(self)
        self._preview = step
        self._tell("preview", step)
        return step.change

    @property
    def previewed(self) -> Step | None:
        return self._preview

    def commit_preview(self) -> Change | None:
        """Makes the preview the next step of the history."""
        step, self._preview = self._preview, None
        if step is None or not step.change.parts:
            return None
        return self._add(step)

    def cancel_preview(self) -> Step | None:
        """Reverts the preview; returns it."""
        step = self._preview
        if step is not None:
            step.change.revert(self)
            self._preview = None
            self._tell("cancel", step)
        return step

    def _told(self, event: Event, step: Step | None) -> Step | None:
        if step is not None:
            self._tell(event, step)
        return step

    def _tell(self, event: Event, step: Step) -> None:
        for listener in tuple(self.listeners):
            listener(event, step)


def exported(document: Document) -> Gaussians:
    """The edited scene: deleted and cropped splats left out, hidden ones kept, adjustments applied to the
    values, comments and extras as they were. A preview is cancelled.

    Raises:
        InputError: no splats would be left.
    """
    document.cancel_preview()
    scene = bake(document.gaussians, document.edits, hidden=True)
    if not len(scene):
        raise InputError("everything is deleted or cropped away; there is nothing to export")
    return scene


def export(document: Document, path: Path, *, write: Callable[[Gaussians, Path], object] = save_scene) -> int:
    """Writes the edited scene to `path`, wholly or not at all, in the format of the suffix; it may be the
    very file that the scene came from. Returns the number of splats. The edits count as saved where the
    format keeps every number.

    Raises:
        InputError: no splats would be left, or the file cannot be written; an older file is still whole.
    """
    scene = exported(document)
    write(scene, path)
    known = format_of(path)
    if known is not None and known.exact:
        document.history.mark_saved()
    return len(scene)
