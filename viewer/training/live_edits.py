"""Editing what is being trained: the view waits on one snapshot, and edits go to the trainer by the numbers
of the splats. No ImGui in here."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from splatview.edit.document import Document
from splatview.edit.operations import AddCrop, Hide, Lock, Operation, RemoveCrop, Select
from splatview.edit.selectors import IndexRuns
from splatview.renderers.cpu import CpuRenderer
from splatview.scene import InputError
from splatview.scene.edits import DELETED, HIDDEN, LOCKED, SELECTED, Crop
from splatview.trainer.background import BackgroundTraining, Snapshot
from splatview.trainer.run import TrainingRun
from splatview.viewer.editing.session import EditSession

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


ON_THE_TRAINER = frozenset({"delete", "delete_cropped", "prune"})
"""Operations whose deletions the trainer is told of."""

ON_THE_PICTURE = frozenset(
    {
        *("select", "select_all", "select_none", "select_inverse", "grow", "shrink"),
        *("hide", "show", "lock", "unlock", "isolate"),
        *("add_crop", "change_crop", "enable_crop", "remove_crop"),
    }
)
"""Operations that help to choose; the trainer never hears of them."""

REFUSALS = {
    "decimate": "Training would fill up to its number again: set the most splats in its recipe instead",
}

AT_REST = "That is for scenes at rest: stop and save the training, then open its file"

NO_WAY_BACK = "What was deleted from the training comes back only by training"

Rule = Literal["cut", "no_growth"]
"""Field of `TrainSettings` that holds rules of this kind."""


class TrainingTarget:
    """What edits of one snapshot mean to the trainer that it is of."""

    def __init__(self, thread: BackgroundTraining, snapshot: Snapshot) -> None:
        self.snapshot = snapshot
        self.pinned = False
        """The user wants the view to wait, whatever is in hand."""
        self._thread = thread
        self._told = np.zeros(len(snapshot.ids), bool)
        self._answers: list[Future[str]] = []
        self._cuts: list[Crop] = []
        self.changed = False
        """The trainer has done something that the next snapshot shows."""

    def refusal(self, operation: Operation) -> str | None:
        """Why it cannot be done in training."""
        if operation.op in ON_THE_TRAINER or operation.op in ON_THE_PICTURE:
            return None
        return REFUSALS.get(operation.op, AT_REST)

    @property
    def final(self) -> str | None:
        """Why steps can no longer be undone."""
        return NO_WAY_BACK if self._told.any() or self._cuts else None

    def edited(self, document: Document) -> None:
        """The document was changed: tells the trainer which splats are to go."""
        deleted = (document.marks & DELETED) != 0
        new = deleted & ~self._told
        if not new.any():
            return
        self._told = deleted
        ids = self.snapshot.ids[new]

        def delete(training_run: TrainingRun) -> str:
            gone = training_run.trainer.delete(ids)
            return f"{gone:,} splats deleted from the training"

        self._answers.append(self._thread.post(delete, changes=True))

    def cut_away(self, crops: Sequence[Crop]) -> None:
        """Deletes what the crops cut away, and keeps it so."""
        self._cuts.extend(crops)

        def cut(training_run: TrainingRun) -> str:
            gone = training_run.trainer.add_cut(crops)
            return f"{gone:,} splats cut away from the training, and it stays so"

        self._answers.append(self._thread.post(cut, changes=True))

    @property
    def waiting(self) -> bool:
        """Whether the trainer has yet to answer."""
        return any(not answer.done() for answer in self._answers)

    def answers(self, session: EditSession) -> None:
        """Tells what the trainer has done; takes back what it could not do."""
        for answer in [answer for answer in self._answers if answer.done()]:
            self._answers.remove(answer)
            if answer.exception() is None:
                self.changed = True
                session.news = answer.result()
            else:  # the thread has noted why
                self._told[:] = False
                self._cuts.clear()
                while session.document.counts.deleted and session.document.undo():
                    pass

    def left_of(self, crops: Sequence[Crop]) -> list[Crop]:
        """Those that have not become rules."""
        return [crop for crop in crops if crop not in self._cuts]


def hold(app: AppState) -> EditSession | None:
    """The desk of the shown snapshot, made if there is none; None where the window shows no training."""
    training = app.training
    if app.session is not None:
        return app.session
    if training is None or training.shown is None or not training.followed_by(app):
        return None
    try:
        app.session = _session(app, training.thread, training.shown)
    except InputError as error:
        app.tell(f"{error}; it can be looked at")
    return app.session


def _session(app: AppState, thread: BackgroundTraining, snapshot: Snapshot) -> EditSession:
    name = app.scene.name if app.scene else "scene"
    document = Document(snapshot.gaussians, name=name, tools=CpuRenderer())
    return EditSession(document=document, target=TrainingTarget(thread, snapshot))


def waits(app: AppState) -> bool:
    """Called every frame: whether the view is to stay with the snapshot that it shows."""
    session = app.session
    if session is None or session.target is None:
        return False
    target: TrainingTarget = session.target
    target.answers(session)
    if target.waiting or session.job is not None or session.stroke is not None:
        return True
    if target.changed:
        return False
    if engaged(session):
        return True
    let_go(app)
    return False


def engaged(session: EditSession) -> bool:
    """Whether the user is at work on what the desk holds."""
    counts, target = session.document.counts, session.target
    return (
        (target is not None and target.pinned)
        or session.tool != "none"
        or session.preview_mask is not None
        or bool(session.picked or session.document.crops or session.document.previewed)
        or counts.selected + counts.hidden + counts.locked + counts.deleted > 0
    )


def let_go(app: AppState) -> None:
    """Snapshots flow again; what was only selected or hidden is forgotten."""
    session = app.session
    if session is None or session.target is None or app.training is None:
        return
    session.close()
    app.session = None
    app.training.thread.show_now()


def succeed(app: AppState, snapshot: Snapshot) -> None:
    """The picture holds `snapshot` now: the desk of the one before makes way. The tool in hand, selection and
    crops stay, where the splats are still there."""
    old = app.session
    app.session = None
    if old is None:
        return
    old.close()
    if old.target is None or app.training is None:
        return
    new = _session(app, app.training.thread, snapshot)
    new.tool, new.depth, new.highlight = old.tool, old.depth, old.highlight
    new.brush_radius, new.tolerance = old.brush_radius, old.tolerance
    new.news, new.problem = old.news, old.problem
    document, marks = new.document, old.document.marks
    _, here, there = np.intersect1d(
        snapshot.ids, old.target.snapshot.ids, assume_unique=True, return_indices=True
    )
    for flag, operation in ((LOCKED, Lock()), (HIDDEN, Hide()), (SELECTED, None)):
        mask = np.zeros(len(snapshot.ids), bool)
        mask[here[(marks[there] & (flag | DELETED)) == flag]] = True
        if mask.any():
            document.apply(Select(by=IndexRuns.of(mask)))
            if operation is not None:
                document.apply(operation)
    for crop in old.target.left_of(old.document.crops):
        document.apply(AddCrop(crop=crop))
    app.session = new


# ---- what the user asks for


def keep_waiting(app: AppState) -> None:
    """The view waits until it is let go."""
    session = hold(app)
    if session is not None and session.target is not None:
        session.target.pinned = True


def cut_away(app: AppState) -> None:
    """Takes out of the training what the crops in force cut away, for good."""
    session = app.session
    if session is None or session.target is None:
        return
    session.document.cancel_preview()
    crops = [crop for crop in session.document.crops if crop.enabled]
    if crops:
        session.target.cut_away(crops)


def stop_growth(app: AppState, index: int) -> None:
    """From now on no splat is born in crop `index`, which is a crop no more."""
    session, training = app.session, app.training
    if session is None or session.target is None or training is None:
        return
    session.document.cancel_preview()
    region = replace(session.document.crops[index], enabled=True)
    training.thread.post(lambda training_run: training_run.trainer.add_region(region), changes=True)
    if session.apply(RemoveCrop(index=index)):
        session.news = f"Nothing grows in {region.name} any more"


def remove_rule(app: AppState, kind: Rule, number: int) -> None:
    """Training is free again of the rule of this number."""
    if app.training is None:
        return
    rule = getattr(app.training.status.settings, kind)[number]

    def remove(training_run: TrainingRun) -> None:
        rules = list(getattr(training_run.trainer.settings, kind))
        if rule in rules:
            rules.remove(rule)
            training_run.trainer.change(**{kind: tuple(rules)})

    app.training.thread.post(remove, changes=True)
