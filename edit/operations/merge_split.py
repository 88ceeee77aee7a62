"""Operations that bring splats in or take them elsewhere: merging, duplicating, splitting."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from splatview.edit.changes import Append, Change, Part, SaveOnce, Toggle, splats_in_words
from splatview.edit.operations.base import Operation
from splatview.scene import Gaussians, InputError, concatenate
from splatview.scene.edits import DELETED, PALETTE_SHIFT, SELECTED, bake
from splatview.scene.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from splatview.edit.document import Document


MOST_SPLATS = 2**31 - 1

ARRAYS = ("means", "quats", "log_scales", "opacity_logits", "sh")


@dataclass(frozen=True, kw_only=True)
class Merge(Operation):
    op: ClassVar[str] = "merge"
    summary: ClassVar[str] = "Add the splats of another file; they are selected, to be put in their place"

    path: str
    """Relative ones start from the recipe's folder."""

    def __post_init__(self) -> None:
        _check_path(self.path)

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        other = document.load(document.path(self.path))
        marks = np.full(len(other), SELECTED, np.uint32)
        title = f"Merge {splats_in_words(len(other))} of {document.path(self.path).name}"
        return _appended(document, other, marks, title)


@dataclass(frozen=True, kw_only=True)
class Duplicate(Operation):
    op: ClassVar[str] = "duplicate"
    summary: ClassVar[str] = "Make a copy of the selected splats, in the same place; the copy is selected"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        at = document.selected.indices
        title = f"Duplicate {splats_in_words(len(at))}"
        return _appended(document, document.gaussians.take(at), document.marks[at], title)


@dataclass(frozen=True, kw_only=True)
class Split(Operation):
    op: ClassVar[str] = "split"
    summary: ClassVar[str] = "Save the selected splats to a file of their own and delete them here"

    path: str
    """Relative ones start from the recipe's folder. Undoing leaves the file."""

    def __post_init__(self) -> None:
        _check_path(self.path)

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        splats = document.selected
        if not len(splats):
            return Change(title="Split nothing", count=0)
        # All others count as deleted; crops do not: the selection is what is split.
        marks = np.where(splats.mask, document.marks, document.marks | np.uint32(DELETED))
        edits = replace(document.edits, marks=marks, crops=(), flags=SELECTED | DELETED)
        target = document.path(self.path)
        scene = bake(document.gaussians, edits, hidden=True)
        return Change(
            title=f"Split {splats_in_words(len(splats))} to {target.name}",
            count=len(splats),
            parts=(SaveOnce(document.save, target, scene), Toggle(splats, SELECTED | DELETED)),
        )


def _check_path(path: str) -> None:
    if not path or "\0" in path:
        raise ValueError("path must name a file")


def _appended(document: Document, added: Gaussians, marks: np.ndarray, title: str) -> Change:
    """`added` after the splats that are there, and selected in their stead."""
    if not len(added):
        return Change(title=title, count=0)
    before = document.gaussians
    if len(before) + len(added) > MOST_SPLATS:
        raise InputError(f"more than {MOST_SPLATS:,} splats cannot be edited")
    after = concatenate([before, added])
    selected = document.selected
    parts: list[Part] = [Toggle(selected, SELECTED)] if len(selected) else []
    parts.append(Append(_sharing(before, after), after, (marks & _ENTRY) | np.uint32(SELECTED)))
    return Change(title=title, count=len(added), parts=tuple(parts))


_ENTRY = np.uint32(0xFFFFFFFF << PALETTE_SHIFT & 0xFFFFFFFF)


def _sharing(before: Gaussians, after: Gaussians) -> Gaussians:
    """`before`, its arrays being the beginnings of those of `after` where they are the same: so that one
    scene is in memory, not two."""
    shared = {}
    for name in ARRAYS:
        own, longer = getattr(before, name), getattr(after, name)
        if own.dtype == longer.dtype and own.shape[1:] == longer.shape[1:]:
            shared[name] = longer[: len(own)]
    return replace(before, **shared)
