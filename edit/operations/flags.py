"""Operations that flip state flags: deleting, hiding, locking and their opposites."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from splatview.edit.changes import Change, Toggle, splats_in_words
from splatview.edit.operations.base import Operation
from splatview.scene.edits import DELETED, HIDDEN, LOCKED, SELECTED
from splatview.scene.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from splatview.edit.document import Document


@dataclass(frozen=True, kw_only=True)
class Delete(Operation):
    op: ClassVar[str] = "delete"
    summary: ClassVar[str] = "Delete the selected splats; the file keeps them until you export over it"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        return _selected(document, DELETED, "Delete")


@dataclass(frozen=True, kw_only=True)
class Hide(Operation):
    op: ClassVar[str] = "hide"
    summary: ClassVar[str] = "Hide the selected splats; they are still exported"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        return _selected(document, HIDDEN, "Hide")


@dataclass(frozen=True, kw_only=True)
class Show(Operation):
    op: ClassVar[str] = "show"
    summary: ClassVar[str] = "Show all hidden splats again"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        return _all_with(document, HIDDEN, "Show")


@dataclass(frozen=True, kw_only=True)
class Lock(Operation):
    op: ClassVar[str] = "lock"
    summary: ClassVar[str] = "Lock the selected splats: visible, but not to be selected or changed"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        return _selected(document, LOCKED, "Lock")


@dataclass(frozen=True, kw_only=True)
class Unlock(Operation):
    op: ClassVar[str] = "unlock"
    summary: ClassVar[str] = "Unlock all locked splats"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        return _all_with(document, LOCKED, "Unlock")


@dataclass(frozen=True, kw_only=True)
class Isolate(Operation):
    op: ClassVar[str] = "isolate"
    summary: ClassVar[str] = "Hide all but the selected splats"

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        # Locked splats too: hiding changes what is seen, not the splat.
        others = document.splats(SELECTED | HIDDEN | DELETED, 0)
        kept = document.counts.selected
        return Change(
            title=f"Isolate {splats_in_words(kept)}",
            count=len(others),
            parts=(Toggle(others, HIDDEN),) if len(others) else (),
        )


def _selected(document: Document, flag: int, verb: str) -> Change:
    """Sets `flag` on the selected splats, which thereby are selected no more."""
    splats = document.selected
    return Change(
        title=f"{verb} {splats_in_words(len(splats))}",
        count=len(splats),
        parts=(Toggle(splats, SELECTED | flag),) if len(splats) else (),
    )


def _all_with(document: Document, flag: int, verb: str) -> Change:
    """Clears `flag` where it is set, deleted splats apart."""
    splats = document.splats(flag | DELETED, flag)
    return Change(
        title=f"{verb} {splats_in_words(len(splats))}",
        count=len(splats),
        parts=(Toggle(splats, flag),) if len(splats) else (),
    )
