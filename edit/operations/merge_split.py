"""Operations that add splats or move them to a file: merge, duplicate, split."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from splatview.edit.changes import Append, Change, Part, Refile, SaveOnce, Toggle, splats_in_words
from splatview.edit.operations.base import Operation
from splatview.edit.state import MAX_SPLATS, MOST_FILES, SceneFile, State
from splatview.scene import Gaussians, InputError, concatenate
from splatview.scene.edits import DELETED, PALETTE_SHIFT, SELECTED, bake
from splatview.scene.errors import printable
from splatview.scene.progress import NO_PROGRESS, Progress

MARK_BYTES = 4 + 2
"""Of a splat: its mark and the number of its file."""


@dataclass(frozen=True, kw_only=True)
class Merge(Operation):
    op: ClassVar[str] = "merge"
    summary: ClassVar[str] = "Add the splats of another file; they are selected, to be put in their place"

    path: str
    """Relative ones start from the recipe's folder."""

    def __post_init__(self) -> None:
        _check_path(self.path)

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        # The scene of both is made while the file's splats are held: two copies of those.
        other = state.load(state.path(self.path), room=state.room / 2)
        path, files = state.path(self.path), state.files
        name = path.name
        if not len(files) < MOST_FILES:
            raise InputError(f"{name}: the scene is of {MOST_FILES:,} files already")
        owners = np.full(len(other), len(files), np.uint16)
        title = f"Merge {splats_in_words(len(other))} of {printable(name)}"
        change = _appended(state, other, np.zeros(len(other), np.uint32), owners, title)
        refile = Refile(files, (*files, SceneFile(name=name, source=str(path))))
        # First the file, then splats that name it.
        return replace(change, parts=(refile, *change.parts)) if change.parts else change


@dataclass(frozen=True, kw_only=True)
class Duplicate(Operation):
    op: ClassVar[str] = "duplicate"
    summary: ClassVar[str] = "Make a copy of the selected splats, in the same place; the copy is selected"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        selected = state.selected
        title = f"Duplicate {splats_in_words(len(selected))}"
        scene = state.gaussians
        state.require_room((len(scene) + 2 * len(selected)) * (scene.row_bytes + MARK_BYTES))
        at = selected.indices
        return _appended(state, scene.take(at), state.marks[at], state.owners[at], title)


@dataclass(frozen=True, kw_only=True)
class Split(Operation):
    op: ClassVar[str] = "split"
    summary: ClassVar[str] = "Save the selected splats to a file of their own and delete them here"

    path: str
    """Relative ones start from the folder of OUT, and none leaves it. Undoing leaves the file."""

    def __post_init__(self) -> None:
        _check_path(self.path)

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        splats = state.selected
        if not len(splats):
            return Change(title="Split nothing", count=0)
        state.require_room(2 * len(splats) * state.gaussians.row_bytes)
        # All others count as deleted; crops do not count: the whole selection is split off.
        marks = np.where(splats.mask, state.marks, state.marks | np.uint32(DELETED))
        edits = replace(state.edits, marks=marks, crops=(), flags=SELECTED | DELETED)
        target = state.path(self.path)
        scene = bake(state.gaussians, edits, hidden=True)
        return Change(
            title=f"Split {splats_in_words(len(splats))} to {printable(target.name)}",
            count=len(splats),
            parts=(SaveOnce(state.save, target, scene), Toggle(splats, SELECTED | DELETED)),
        )


def _check_path(path: str) -> None:
    if not path or "\0" in path:
        raise ValueError("path must name a file")


def _appended(state: State, added: Gaussians, marks: np.ndarray, owners: np.ndarray, title: str) -> Change:
    """Appends `added`, with the adjustments in marks (M,) and their files in owners (M,), and selects them
    alone."""
    if not len(added):
        return Change(title=title, count=0)
    before = state.gaussians
    if len(before) + len(added) > MAX_SPLATS:
        raise InputError(f"more than {MAX_SPLATS:,} splats cannot be edited")
    row = concatenate([before.take(slice(0)), added.take(slice(0))]).row_bytes + MARK_BYTES
    state.require_room((len(before) + len(added)) * row + added.nbytes)
    selected = state.selected
    parts: list[Part] = [Toggle(selected, SELECTED)] if len(selected) else []
    parts.append(Append(before, added, (marks & _ENTRY) | np.uint32(SELECTED), owners))
    return Change(title=title, count=len(added), parts=tuple(parts))


_ENTRY = np.uint32(0xFFFFFFFF << PALETTE_SHIFT & 0xFFFFFFFF)
