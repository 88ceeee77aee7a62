"""Operations that flip splat flags: delete, hide, lock and their opposites."""

from __future__ import annotations

from typing import ClassVar

from splatview.edit.changes import Change, splats_in_words, toggling
from splatview.edit.operations.base import Operation
from splatview.edit.state import State
from splatview.scene.edits import DELETED, HIDDEN, LOCKED, SELECTED
from splatview.scene.progress import NO_PROGRESS, Progress


class _SetFlag(Operation):
    """Sets a flag on the selected splats, which deselects them."""

    flag: ClassVar[int]

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        splats = state.selected
        return toggling(
            splats, SELECTED | self.flag, f"{self.op.capitalize()} {splats_in_words(len(splats))}"
        )


class _ClearFlag(Operation):
    """Clears a flag of all splats that are not deleted."""

    flag: ClassVar[int]

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        splats = state.splats(self.flag | DELETED, self.flag)
        return toggling(splats, self.flag, f"{self.op.capitalize()} {splats_in_words(len(splats))}")


class Delete(_SetFlag):
    op = "delete"
    summary = "Delete the selected splats; the file keeps them until you export over it"
    flag = DELETED


class Hide(_SetFlag):
    op = "hide"
    alters_file = False
    summary = "Hide the selected splats; they are still exported"
    flag = HIDDEN


class Show(_ClearFlag):
    op = "show"
    alters_file = False
    summary = "Show all hidden splats again"
    flag = HIDDEN


class Lock(_SetFlag):
    op = "lock"
    alters_file = False
    summary = "Lock the selected splats: visible, but not to be selected or changed"
    flag = LOCKED


class Unlock(_ClearFlag):
    op = "unlock"
    alters_file = False
    summary = "Unlock all locked splats"
    flag = LOCKED


class Isolate(Operation):
    op = "isolate"
    alters_file = False
    summary = "Hide all but the selected splats"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        # Locked splats too: hiding changes no splat.
        others = state.splats(SELECTED | HIDDEN | DELETED, 0)
        return toggling(others, HIDDEN, f"Isolate {splats_in_words(state.counts.selected)}")
