"""A scene under edit: what is in force, and how it came about."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from splatview.edit.changes import Change
from splatview.edit.detectors import Detector, contributions, sample_cameras
from splatview.edit.kernels import marks as kernels
from splatview.edit.kernels.compiling import in_pieces
from splatview.edit.operations.base import Operation
from splatview.edit.serialization import to_json
from splatview.edit.state import SplatSet, State
from splatview.edit.tools import NoTools, Tools
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import (
    DELETED,
    HIDDEN,
    LOCKED,
    PREVIEW,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    adjustment_rows,
    crop_rows,
)
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.progress import NO_PROGRESS, Progress

# ---- Undo and redo without end: the steps that were done, and where in them the document stands.


@dataclass(frozen=True, eq=False)
class Step:
    operation: Operation
    change: Change

    @property
    def title(self) -> str:
        return self.change.title


class History:
    """`steps[:position]` are in force; the others wait to be redone.

    The position moves only after the state has been altered: what fails leaves both as they were.
    """

    def __init__(self, state: State) -> None:
        self._state = state
        self.steps: list[Step] = []
        self.position = 0
        self._saved: Step | None = None

    def do(self, step: Step, *, applied: bool = False) -> None:
        """Puts `step` in force (unless it is `applied` already) and forgets what waited to be redone."""
        if not applied:
            step.change.apply(self._state)
        del self.steps[self.position :]
        self.steps.append(step)
        self.position += 1

    def undo(self) -> Step | None:
        """The step that was undone; None where there is none."""
        if not self.can_undo:
            return None
        step = self.steps[self.position - 1]
        step.change.revert(self._state)
        self.position -= 1
        return step

    def redo(self) -> Step | None:
        """The step that was redone; None where there is none."""
        if not self.can_redo:
            return None
        step = self.steps[self.position]
        step.change.apply(self._state)
        self.position += 1
        return step

    @property
    def can_undo(self) -> bool:
        return self.position > 0

    @property
    def can_redo(self) -> bool:
        return self.position < len(self.steps)

    @property
    def done(self) -> list[Step]:
        """The steps in force."""
        return self.steps[: self.position]

    @property
    def nbytes(self) -> int:
        """Memory of all steps, about."""
        return sum(step.change.nbytes for step in self.steps)

    def mark_saved(self) -> None:
        """What is in force now is in a file."""
        self._saved = self.steps[self.position - 1] if self.position else None

    @property
    def modified(self) -> bool:
        """Whether what is in force differs from what was last saved, or loaded."""
        return (self.steps[self.position - 1] if self.position else None) is not self._saved


# ---- A short name for the values of a scene, by which a recipe knows the scene that it was made for.


ROWS = 1 << 14
"""Splats looked at, evenly spread: enough to tell scenes apart, and done in milliseconds for any."""


def fingerprint(gaussians: Gaussians) -> str:
    """32 hexadecimal digits of the values of ROWS splats, their number and SH degree; comments, extras and
    the byte order of the machine do not matter."""
    n = len(gaussians)
    rows = np.unique(np.linspace(0, n - 1, min(n, ROWS)).astype(np.int64)) if n else np.zeros(0, np.int64)
    digest = hashlib.blake2b(f"{n} {gaussians.sh_degree}".encode(), digest_size=16)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        values = getattr(gaussians, name)[rows]
        digest.update(np.ascontiguousarray(values, values.dtype.newbyteorder("<")).tobytes())
    return digest.hexdigest()


MAX_SPLATS = 2**31 - 1
"""Runs are counted in 32 bits."""


@dataclass(frozen=True, kw_only=True)
class Counts:
    total: int
    selected: int
    hidden: int
    """Not counting deleted ones, as `locked`."""
    deleted: int
    locked: int
    shown: int
    """Neither hidden nor deleted; crops apart."""
    selectable: int
    """Shown and not locked; crops apart."""

    @property
    def kept(self) -> int:
        """Not deleted; crops apart."""
        return self.total - self.deleted


@dataclass(frozen=True, eq=False)
class Planned:
    """An operation and what it would alter, as the document stood at `revision`."""

    operation: Operation
    change: Change
    revision: int


Event = Literal["apply", "undo", "redo", "preview", "cancel"]

Listener = Callable[[Event, Step], None]
"""Called after the document has changed."""


class Document:
    """The edits of one scene, with undo. Belongs to one thread, but for `plan`, which only reads.

    `gaussians` is never written to. A selected splat is never hidden, deleted or locked; operations that
    change splats pass over deleted and locked ones.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        *,
        name: str = "scene",
        folder: Path | None = None,
        tools: Tools | None = None,
        load: Callable[[Path], Gaussians] = load_scene,
        save: Callable[[Gaussians, Path], None] = save_scene,
    ) -> None:
        """`name` is that of the scene's file; `folder` is what relative paths of operations start from
        (default: the working directory). `load` and `save` read and write the scenes that operations name.

        Raises:
            InputError: the scene has more splats than can be edited.
        """
        if len(gaussians) > MAX_SPLATS:
            raise InputError(f"{name}: has {len(gaussians):,} splats; at most {MAX_SPLATS:,} can be edited")
        self.name = name
        self.folder = folder
        self.tools: Tools = tools or NoTools()
        self.load, self.save = load, save
        self.listeners: list[Listener] = []
        # Now, rather than keeping the unedited scene for when it is asked for.
        self.identity = {"name": name, "count": len(gaussians), "fingerprint": fingerprint(gaussians)}
        """What tells the unedited scene from others."""
        self.state = State(gaussians)
        """For operations to read; only changes write to it."""
        self.history = History(self.state)
        self._preview: Step | None = None
        self._lit = 0
        self._measurement: tuple[Hashable, np.ndarray] | None = None
        self._edits: tuple[tuple[int, ...], SceneEdits] | None = None
        self._counts: tuple[int, Counts] | None = None
        self._exported: tuple[tuple[int, ...], int] | None = None

    # What is in force.

    @property
    def gaussians(self) -> Gaussians:
        """The scene to be drawn with `edits`; another object whenever its values or their number change."""
        return self.state.gaussians

    @property
    def marks(self) -> np.ndarray:
        """(N,) uint32; only to be read."""
        return self.state.marks

    @property
    def palette(self) -> tuple[Adjustment, ...]:
        return self.state.palette

    @property
    def crops(self) -> tuple[Crop, ...]:
        return self.state.crops

    @property
    def versions(self) -> tuple[int, int, int, int]:
        """Of scene, marks, palette and crops: equal exactly if nothing has changed in between."""
        return self.state.versions

    @property
    def edits(self) -> SceneEdits:
        """What renderers read: the same object as long as nothing changes."""
        versions = self.versions
        if self._edits is None or self._edits[0] != versions:
            state, counts = self.state, self.counts
            flags = SELECTED * (counts.selected > 0) | DELETED * (counts.deleted > 0)
            # A deleted splat may also be hidden or locked: those counts do not tell.
            flags |= HIDDEN * (counts.hidden > 0 or counts.deleted > 0)
            flags |= LOCKED * (counts.locked > 0 or counts.deleted > 0)
            flags |= PREVIEW * (self._lit > 0)
            edits = SceneEdits(
                marks=state.marks,
                palette=state.palette,
                crops=state.crops,
                marks_version=state.marks_version,
                palette_version=state.palette_version,
                crops_version=state.crops_version,
                changes=tuple(state.changes),
                flags=flags,
            )
            self._edits = (versions, edits)
        return self._edits[1]

    @property
    def counts(self) -> Counts:
        """Counted once after each change of the marks."""
        version = self.state.marks_version
        if self._counts is None or self._counts[0] != version:
            selected, hidden, deleted, locked, shown, selectable = kernels.flag_counts(self.marks).tolist()
            counts = Counts(
                total=len(self.marks),
                selected=selected,
                hidden=hidden,
                deleted=deleted,
                locked=locked,
                shown=shown,
                selectable=selectable,
            )
            self._counts = (version, counts)
        return self._counts[1]

    @property
    def exported_count(self) -> int:
        """Splats that an export would have: neither deleted nor cropped away."""
        versions = self.versions
        if self._exported is None or self._exported[0] != versions:
            visible = self.cropped_in()
            count = self.counts.kept
            if len(visible):
                count = int(np.count_nonzero(visible & ((self.marks & DELETED) == 0)))
            self._exported = (versions, count)
        return self._exported[1]

    def cropped_in(self, *, crops: tuple[Crop, ...] | None = None, only: int = 0) -> np.ndarray:
        """Which splats the crops in force (or `crops` in their stead) leave: (N,) bool, or of length 0
        where there are none. Splats without any flag of `only` are not looked at and count as left."""
        rows = crop_rows(self.crops if crops is None else crops)
        if not len(rows):
            return np.zeros(0, bool)
        means, marks, palette = self.gaussians.means, self.marks, adjustment_rows(self.palette)
        kept = np.empty(len(marks), bool)

        def work(start: int, stop: int) -> None:
            kernels.cropped_in(start, stop, means, marks, palette, rows, only, kept)

        in_pieces(len(marks), work)
        return kept

    def splats(self, care: int, value: int) -> SplatSet:
        """Those whose flags within `care` are exactly `value`."""
        return SplatSet.of_flags(self.marks, care, value)

    @property
    def selected(self) -> SplatSet:
        return self.splats(SELECTED, SELECTED)

    def path(self, text: str) -> Path:
        """The file that an operation names."""
        return Path(self.folder or os.curdir, text)

    def scores(
        self, detector: Detector, cameras: tuple[Camera, ...] = (), *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        """The detector's scores of the scene as it is now, (N,) float32; kept until the next edit, so that
        what a preview has found out is not found out again.

        Raises:
            InputError: it wants a renderer that there is not.
            Cancelled: nobody waits for it any more.
        """
        return self._measured(
            (type(detector), json.dumps(to_json([detector, *cameras]))),
            lambda: detector.scores(self.gaussians, self.edits, self.tools, cameras, progress=progress),
        )

    def contributions(
        self, cameras: tuple[Camera, ...] = (), *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        """What each splat contributes to the views, (N,) float64; kept and raised as by `scores`. Without
        `cameras` the views are `sample_cameras`."""

        def measure() -> np.ndarray:
            views = cameras or sample_cameras(self.gaussians, self.edits)
            return contributions(self.gaussians, self.edits, self.tools, views, progress=progress)

        return self._measured((contributions, json.dumps(to_json(cameras))), measure)

    def _measured(self, what: Hashable, measure: Callable[[], np.ndarray]) -> np.ndarray:
        key = (self.state.revision, what)
        if self._measurement is None or self._measurement[0] != key:
            self._measurement = (key, measure())
        return self._measurement[1]

    def highlight(self, mask: np.ndarray | None) -> int:
        """Lights up the splats of `mask` (N,) bool that could be selected, and no others; None: none.

        Shows what a tool would take; it is no edit, and ends with the next one. Returns how many.
        """
        if mask is None and not self._lit:
            return 0
        chosen = np.zeros(0, bool) if mask is None else np.ascontiguousarray(mask, bool)
        if mask is not None and chosen.shape != self.marks.shape:
            raise ValueError(f"mask must have shape {self.marks.shape}, got {chosen.shape}")
        self._lit, start, stop = kernels.light_up(self.marks, chosen)
        if stop > start:
            self.state.marks_changed(start, stop, edited=False)
        return self._lit

    # Changing it.

    def plan(self, operation: Operation, *, progress: Progress = NO_PROGRESS) -> Planned:
        """What `operation` would do now; for slow ones in a thread of its own, while nothing is changed.

        Raises:
            InputError: it cannot be done here.
            Cancelled: nobody waits for it any more.
        """
        revision = self.state.revision
        return Planned(operation, operation.plan(self, progress), revision)

    def apply(self, operation: Operation | Planned) -> Change:
        """Does it, as the next step of the history, unless it alters nothing. A preview that is in force
        gives way.

        Raises:
            InputError: it cannot be done here, or what was planned is out of date. Nothing has changed then.
        """
        self.cancel_preview()
        planned = operation if isinstance(operation, Planned) else self.plan(operation)
        if planned.revision != self.state.revision:
            raise InputError("the scene was edited in the meantime; do it again")
        step = Step(planned.operation, planned.change)
        self.highlight(None)
        if not step.change.parts:
            return step.change
        self.history.do(step)
        self._tell("apply", step)
        return step.change

    def undo(self) -> Step | None:
        """Takes the last step back, or the preview if there is one; returns it, or None."""
        if self._preview is not None:
            return self.cancel_preview()
        self.highlight(None)
        return self._told("undo", self.history.undo())

    def redo(self) -> Step | None:
        self.cancel_preview()
        self.highlight(None)
        return self._told("redo", self.history.redo())

    def jump(self, position: int) -> None:
        """Undoes or redoes until `position` steps are in force."""
        self.cancel_preview()
        if not 0 <= position <= len(self.history.steps):
            raise ValueError(f"position must be in 0 to {len(self.history.steps)}, got {position}")
        while self.history.position > position:
            self.undo()
        while self.history.position < position:
            self.redo()

    def preview(self, operation: Operation) -> Change:
        """Shows what `operation` would do, in place of the preview before: for gizmos and sliders that are
        being dragged. It is no step of the history until `commit_preview`.

        Raises:
            InputError: it cannot be done here; no preview is in force then.
        """
        self.cancel_preview()
        step = Step(operation, operation.plan(self))
        self.highlight(None)
        step.change.apply(self.state)
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
        self.history.do(step, applied=True)
        self._tell("apply", step)
        return step.change

    def cancel_preview(self) -> Step | None:
        """Takes the preview back; returns it."""
        step = self._preview
        if step is not None:
            step.change.revert(self.state)
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
