"""Editing a training: the view stays on a frozen snapshot while the user edits. No ImGui in here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from splatview.edit.document import Document
from splatview.edit.operations import AddCrop, Hide, Lock, RemoveCrop, Select
from splatview.edit.selectors import IndexRuns
from splatview.renderers.cpu import CpuRenderer
from splatview.scene import InputError
from splatview.scene.edits import DELETED, HIDDEN, LOCKED, SELECTED
from splatview.scene.formats import place_beside
from splatview.trainer.background import BackgroundTraining, Snapshot
from splatview.trainer.run import TrainingRun
from splatview.viewer.editing.session import Editing, EditSession, session_of
from splatview.viewer.editing.target import TrainingTarget

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


Rule = Literal["cut", "no_growth"]
"""Field of `TrainSettings` that holds rules of this kind."""


class TrainingEdits:
    """Sessions on snapshots of a training: a `LiveScene` for the `Editing` feature."""

    at_rest = False

    def __init__(self, thread: BackgroundTraining, shown: Callable[[AppState], Snapshot | None]) -> None:
        """`shown` gives the snapshot that the window shows; None where it shows something else."""
        self._thread = thread
        self._shown = shown

    def is_shown(self, app: AppState) -> bool:
        return self._shown(app) is not None

    def freeze(self, app: AppState) -> EditSession | None:
        """The session of the shown snapshot, opened if there is none; None where no snapshot is shown."""
        editing, snapshot = app.feature(Editing), self._shown(app)
        if editing.session is None and snapshot is not None:
            try:
                editing.session = self._session(app, snapshot)
            except InputError as error:
                app.tell(f"{error}; it can be looked at")
        return editing.session

    def release(self, app: AppState) -> None:
        """Snapshots are followed again; what was only selected or hidden is forgotten."""
        editing = app.feature(Editing)
        if frozen_target(editing.session) is not None and editing.session is not None:
            editing.session.close()
            editing.session = None
            self._thread.show_now()

    def export(self, app: AppState) -> None:
        proposal = self._thread.outputs.scene
        app.choose_files(
            "Export the scene",
            lambda paths: self._thread.export(paths[0]),
            kind="save_scene",
            name=f"{place_beside(proposal).stem}-{self._thread.status.iteration}.ply",
        )

    def stays_frozen(self, app: AppState) -> bool:
        """Whether the view stays with the snapshot that it shows; asked in every frame. A session in which
        nothing is under way any more is released."""
        session = session_of(app)
        target = frozen_target(session)
        if session is None or target is None:
            return False
        session.news = target.take_answers(session.document) or session.news
        if target.waiting or session.job is not None or session.stroke is not None:
            return True
        if target.changed:
            return False
        if in_use(session):
            return True
        self.release(app)
        return False

    def carry_over(self, app: AppState, snapshot: Snapshot) -> None:
        """The picture holds `snapshot` now: its session replaces that of the one before. Tool, selection and
        crops are carried over, where the splats still exist."""
        editing = app.feature(Editing)
        old, editing.session = editing.session, None
        if old is None:
            return
        old.close()
        target = frozen_target(old)
        if target is None:
            return
        new = self._session(app, snapshot)
        new.tool, new.depth = old.tool, old.depth
        new.brush_radius, new.tolerance = old.brush_radius, old.tolerance
        new.news, new.problem = old.news, old.problem
        document, marks = new.document, old.document.marks
        _, here, there = np.intersect1d(
            snapshot.ids, target.snapshot.ids, assume_unique=True, return_indices=True
        )
        for flag, operation in ((LOCKED, Lock()), (HIDDEN, Hide()), (SELECTED, None)):
            mask = np.zeros(len(snapshot.ids), bool)
            mask[here[(marks[there] & (flag | DELETED)) == flag]] = True
            if mask.any():
                document.apply(Select(by=IndexRuns.of(mask)))
                if operation is not None:
                    document.apply(operation)
        for crop in target.without_rules(old.document.crops):
            document.apply(AddCrop(crop=crop))
        editing.session = new

    def _session(self, app: AppState, snapshot: Snapshot) -> EditSession:
        document = Document(
            snapshot.gaussians,
            name=app.scene.name or "scene",
            tools=CpuRenderer(),
            budget=app.preferences.edit_memory_gib * 2**30,
        )
        return EditSession(document=document, target=TrainingTarget(self._thread, snapshot))

    def pin(self, app: AppState) -> None:
        """Freezes the shown snapshot until it is released."""
        target = frozen_target(self.freeze(app))
        if target is not None:
            target.pinned = True

    def cut_away(self, app: AppState) -> None:
        """Takes out of the training what the crops in force cut away, for good."""
        session = session_of(app)
        target = frozen_target(session)
        if session is None or target is None:
            return
        session.document.cancel_preview()
        crops = [crop for crop in session.document.crops if crop.enabled]
        if crops:
            target.cut_away(crops)

    def stop_growth(self, app: AppState, index: int) -> None:
        """From now on no splat is born in crop `index`, which becomes a rule."""
        session = session_of(app)
        if session is None or frozen_target(session) is None:
            return
        session.document.cancel_preview()
        region = replace(session.document.crops[index], enabled=True)
        self._thread.post(lambda run: run.trainer.add_region(region), changes=True)
        if session.apply(RemoveCrop(index=index)):
            session.news = f"Nothing grows in {region.name} any more"

    def remove_rule(self, app: AppState, kind: Rule, number: int) -> None:
        """Frees the training of the rule of this number."""
        rule = getattr(self._thread.status.settings, kind)[number]

        def remove(run: TrainingRun) -> None:
            rules = list(getattr(run.trainer.settings, kind))
            if rule in rules:
                rules.remove(rule)
                run.trainer.change(**{kind: tuple(rules)})

        self._thread.post(remove, changes=True)


def frozen_target(session: EditSession | None) -> TrainingTarget | None:
    """The target of a session on a frozen snapshot; None for any other session."""
    target = session.target if session is not None else None
    return target if isinstance(target, TrainingTarget) else None


def in_use(session: EditSession) -> bool:
    """Whether the user is editing in `session`, so that its snapshot stays frozen."""
    counts, target = session.document.counts, frozen_target(session)
    return (
        (target is not None and target.pinned)
        or session.tool != "none"
        or session.preview_mask is not None
        or bool(session.picked or session.document.crops or session.document.previewed)
        or counts.selected + counts.hidden + counts.locked + counts.deleted > 0
    )
