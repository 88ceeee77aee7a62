"""The object of edits: a scene at rest, or the trainer of a scene in training."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from typing import Protocol

import numpy as np

from splatview.edit.document import Document
from splatview.edit.operations import Operation
from splatview.scene.edits import DELETED, Crop
from splatview.trainer.background import BackgroundTraining, Snapshot
from splatview.trainer.run import TrainingRun

SENT_TO_TRAINER = frozenset({"delete", "delete_cropped", "prune"})
"""Operations whose deletions the trainer repeats."""

VIEW_ONLY = frozenset(
    {
        *("select", "select_all", "select_none", "select_inverse", "grow", "shrink", "select_detected"),
        *("hide", "show", "lock", "unlock", "isolate"),
        *("add_crop", "change_crop", "enable_crop", "remove_crop"),
    }
)
"""Operations that only help to choose splats; they are not sent to the trainer."""

REFUSALS = {
    "decimate": "Training would fill up to its number again: set the most splats in its recipe instead",
}

AT_REST = "That is for scenes at rest: stop and save the training, then open its file"

NO_WAY_BACK = "What was deleted from the training comes back only by training"


class EditTarget(Protocol):
    """The object that the edits of a session change, besides the session's document."""

    at_rest: bool
    """Whether nothing but edits changes the scene: every edit can be done and kept."""

    def refusal(self, operation: Operation) -> str | None:
        """Reason why `operation` cannot be done on it."""
        ...

    @property
    def final(self) -> str | None:
        """Reason why steps can no longer be undone."""
        ...

    @property
    def rules(self) -> int:
        """Number of crops that have become rules of the target."""
        ...

    def edited(self, document: Document) -> None:
        """Follows a change of `document`."""


class SceneTarget:
    """A scene that is open and at rest: the document is all there is to change."""

    at_rest = True
    final: str | None = None
    rules = 0

    def refusal(self, operation: Operation) -> str | None:
        return None

    def edited(self, document: Document) -> None: ...


class TrainingTarget:
    """The trainer that a snapshot is of; deletions are sent to it by the ids of the splats."""

    at_rest = False

    def __init__(self, thread: BackgroundTraining, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        self.pinned = False
        """Whether the user asked for the snapshot to stay frozen, whatever tool is taken."""
        self.changed = False
        """Whether the trainer has done something that the next snapshot shows."""
        self._thread = thread
        self._sent = np.zeros(len(snapshot.ids), bool)
        self._answers: list[Future[str]] = []
        self._cuts: list[Crop] = []

    def refusal(self, operation: Operation) -> str | None:
        if operation.op in SENT_TO_TRAINER or operation.op in VIEW_ONLY:
            return None
        return REFUSALS.get(operation.op, AT_REST)

    @property
    def final(self) -> str | None:
        return NO_WAY_BACK if self._sent.any() or self._cuts else None

    @property
    def rules(self) -> int:
        settings = self._thread.status.settings
        return len(settings.cut) + len(settings.no_growth)

    def edited(self, document: Document) -> None:
        """Sends the splats that were deleted since the last call to the trainer."""
        deleted = (document.marks & DELETED) != 0
        new = deleted & ~self._sent
        if not new.any():
            return
        self._sent = deleted
        ids = self.snapshot.ids[new]

        def delete(run: TrainingRun) -> str:
            return f"{run.trainer.delete(ids):,} splats deleted from the training"

        self._answers.append(self._thread.post(delete, changes=True))

    def cut_away(self, crops: Sequence[Crop]) -> None:
        """Deletes from the training what the crops cut away, now and in every later step."""
        self._cuts.extend(crops)

        def cut(run: TrainingRun) -> str:
            return f"{run.trainer.add_cut(crops):,} splats cut away from the training, and it stays so"

        self._answers.append(self._thread.post(cut, changes=True))

    @property
    def waiting(self) -> bool:
        """Whether the trainer has yet to answer."""
        return any(not answer.done() for answer in self._answers)

    def take_answers(self, document: Document) -> str | None:
        """The trainer's last answer, in one line; deletions that it could not do are taken back."""
        news = None
        for answer in [answer for answer in self._answers if answer.done()]:
            self._answers.remove(answer)
            if answer.exception() is None:
                self.changed = True
                news = answer.result()
            else:  # the thread has noted why
                self._sent[:] = False
                self._cuts.clear()
                while document.counts.deleted and document.undo():
                    pass
        return news

    def without_rules(self, crops: Sequence[Crop]) -> list[Crop]:
        """`crops` that have not become rules."""
        return [crop for crop in crops if crop not in self._cuts]
