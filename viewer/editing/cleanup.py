"""Clean-up without its panel: what one would rather be without, what losing it costs, and losing it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from splatview.edit.detectors import DETECTORS
from splatview.edit.impact import Impact, frozen, measure_impact, operation_impacts, with_deleted
from splatview.edit.operations.cleanup import Decimate, Prune, Repair
from splatview.edit.sample_views import sample_cameras
from splatview.scene import Camera
from splatview.scene.progress import Progress
from splatview.viewer.editing.session import EditSession

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


VIEWS = 8
"""That a price is measured in."""

MOST_LOADED = 16
"""Of loaded cameras, spread evenly."""


def choose_detector(session: EditSession, name: str) -> None:
    """Another of DETECTORS; what the one before has found is forgotten."""
    form = session.forms.clean
    form.detector, form.scores, form.mask, form.price = name, None, None, None
    form.threshold, session.preview_mask = DETECTORS[name].threshold, None


def find(app: AppState, detector: str) -> None:
    """Looks for splats by one of DETECTORS and shows the section that says what was found."""
    if app.session is None:
        app.tell("Open a scene first")
        return
    choose_detector(app.session, detector)
    app.session.forms.open_section = "Clean up"
    look(app)


def views(app: AppState, session: EditSession) -> tuple[Camera, ...]:
    """The loaded cameras if there are some, else views from around the scene."""
    if app.cameras:
        step = -(-len(app.cameras) // MOST_LOADED)
        return tuple(app.cameras[::step])
    return tuple(sample_cameras(session.document.gaussians, session.document.edits, VIEWS))


def look(app: AppState) -> None:
    """Scores in a thread; then the slider's first threshold."""
    session = app.session
    if session is None:
        return
    form, document = session.forms.clean, session.document
    name, detector = form.detector, DETECTORS[form.detector]
    key = (name, document.versions)
    cameras = views(app, session) if detector.renders else ()

    def work(progress: Progress) -> np.ndarray:
        # The document keeps them for the deletion that may follow.
        return document.scores(detector(), cameras, progress=progress)

    def done(scores: np.ndarray) -> None:
        form.scores, form.of, form.threshold = scores, key, detector.threshold
        set_threshold(session, detector.threshold)

    session.start(f"Looking for {detector.label.lower()}", work, done)


def set_threshold(session: EditSession, value: float) -> None:
    """Lights up what scores above it, as far as it may be deleted."""
    form = session.forms.clean
    if form.scores is None:
        return
    form.threshold, form.price = value, None
    form.mask = DETECTORS[form.detector]().mask(form.scores, value) & session.document.editable
    form.count = int(np.count_nonzero(form.mask))
    session.preview_mask = form.mask


def measure_price(app: AppState) -> None:
    session = app.session
    if session is None:
        return
    form, document = session.forms.clean, session.document
    mask, before = form.mask, frozen(document.edits)
    if mask is None:
        return
    after, cameras = with_deleted(before, mask), views(app, session)

    def work(progress: Progress) -> Any:
        return measure_impact(document.gaussians, before, after, document.tools, cameras, progress=progress)

    def done(cost: Any) -> None:
        if form.mask is mask:
            form.price = cost

    session.start("Measuring the price", work, done)


def prune(app: AppState) -> None:
    session = app.session
    if session is None:
        return
    form = session.forms.clean
    detector = DETECTORS[form.detector]
    cameras = views(app, session) if detector.renders else ()
    session.preview_mask = None
    session.apply_slowly(Prune(by=detector(), threshold=form.threshold, cameras=cameras), "Deleting")


def forget(app: AppState) -> None:
    if app.session is not None:
        form = app.session.forms.clean
        form.scores, form.mask, form.price, app.session.preview_mask = None, None, None, None


def price_decimation(app: AppState) -> None:
    session = app.session
    if session is None:
        return
    form, document = session.forms.clean, session.document
    key, before, cameras = (form.keep, document.versions), frozen(document.edits), views(app, session)

    def work(progress: Progress) -> Any:
        part = progress.part(0.0, 0.4)
        mask = Decimate(keep=key[0], cameras=cameras).to_delete(document, part)
        after = with_deleted(before, mask)
        return measure_impact(
            document.gaussians, before, after, document.tools, cameras, progress=progress.part(0.4, 1.0)
        )

    def done(cost: Any) -> None:
        form.kept_price = (key, cost)

    session.start("Measuring the price", work, done)


def keep_best(app: AppState) -> None:
    if app.session is not None:
        keep = app.session.forms.clean.keep
        app.session.apply_slowly(Decimate(keep=keep, cameras=views(app, app.session)), "Keeping the best")


# ---- What repairs of the health report would cost, measured in a thread.


__all__ = ["VIEWS", "measure", "prices"]


def prices(app: AppState) -> dict[str, Impact]:
    """By finding; none where they were not measured, or the scene was edited since."""
    if app.session is None:
        return {}
    form = app.session.forms.health
    return form.prices if form.of == app.session.document.versions else {}


def measure(app: AppState, names: Sequence[str]) -> None:
    """Of the repairs of the findings `names`, each by itself, by the renderer of all prices."""
    session = app.session
    if session is None:
        return
    form, document = session.forms.health, session.document
    repairs = {name: Repair(finding=name) for name in names}
    of, cameras = document.versions, views(app, session)

    def work(progress: Progress) -> dict[str, Impact]:
        return operation_impacts(document, repairs, cameras, progress=progress)

    def done(found: dict[str, Impact]) -> None:
        form.prices, form.of = found, of

    session.start("Measuring what repairs cost", work, done)
