"""Undo and redo without end: the steps that were done, and where in them the document stands."""

from __future__ import annotations

from dataclasses import dataclass

from .changes import Change
from .operations.operation import Operation
from .state import State


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
