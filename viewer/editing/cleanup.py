"""Clean-up without its panels: detectors, decimation, repairs, and what each costs in dB."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from splatview.edit.detectors import DETECTORS
from splatview.edit.impact import Impact, compare, frozen, measure_impact, operation_impacts, with_deleted
from splatview.edit.operations.cleanup import Decimate, Prune, Repair, SelectDetected
from splatview.edit.sample_views import sample_cameras
from splatview.scene import Camera
from splatview.scene.progress import Progress
from splatview.viewer.editing.session import EditSession, session_of, with_session
from splatview.viewer.editing.tool_state import Mode

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


SECTION = "Clean up"
"""Title on the Edit panel."""

VIEWS = 8
"""Number of views in which a price is measured."""

MOST_LOADED = 16
"""Largest number of loaded cameras used for a price, spread evenly."""


def choose_detector(session: EditSession, name: str) -> None:
    """Another of DETECTORS; what the one before has found is forgotten."""
    form = session.forms.clean
    form.detector, form.scores, form.mask, form.price = name, None, None, None
    form.threshold, session.preview_mask = DETECTORS[name].threshold, None


def find(app: AppState, detector: str) -> None:
    """Looks for splats by one of DETECTORS and shows the section that says what was found."""
    session = session_of(app)
    if session is None:
        app.tell("Open a scene first")
        return
    choose_detector(session, detector)
    session.forms.open_section = SECTION
    look(app)


def views(app: AppState, session: EditSession) -> tuple[Camera, ...]:
    """The loaded cameras if there are some, else views from around the scene."""
    if app.cameras:
        step = -(-len(app.cameras) // MOST_LOADED)
        return tuple(app.cameras[::step])
    return tuple(sample_cameras(session.document.gaussians, session.document.edits, VIEWS))


CALM_SECONDS = 0.7
"""Prices are measured by themselves once nothing has moved for so long."""


def is_counted(session: EditSession, name: str) -> bool:
    return session.forms.clean.counts.get(name, (None, 0))[0] == session.document.versions


def is_priced(session: EditSession, name: str) -> bool:
    """Whether it is known what deleting all that one of DETECTORS finds costs."""
    form, now = session.forms.clean, session.document.versions
    nothing = is_counted(session, name) and form.counts[name][1] == 0
    return nothing or form.prices.get(name, (None, None))[0] == now


def keep_measured(app: AppState, session: EditSession, *, touched: bool) -> None:
    """To be called each frame while the section is open: counts what detectors find, and once all is calm
    measures what deleting that costs. It gives way to the user, goes on afterwards, and is not taken up again
    where the user has cancelled it. `touched`: a mouse button is down."""
    form, now = session.forms.clean, app.now()
    if form.measuring is not None and form.measuring is not session.job:
        job, form.measuring = form.measuring, None
        if job.ended and (job.title == PRICING or job.cancelled or job.error is not None):
            form.measured = session.document.versions
    moving = touched or app.transition is not None or app.picture.busy or app.view is not form.calm_view
    if moving:
        form.calm_since, form.calm_view = now, app.view
    if form.measuring is not None:
        if moving and form.measuring.title == PRICING:
            session.give_way()
        return
    if session.job is not None or form.measured == session.document.versions:
        return
    calm = now - form.calm_since >= CALM_SECONDS
    counting = not all(is_counted(session, name) for name, each in DETECTORS.items() if not each.renders)
    if counting or (calm and not all(is_priced(session, name) for name in DETECTORS)):
        measure(app, session, price=not counting)


COUNTING, PRICING = "Looking for what could be cleaned up", "Measuring what clean-up costs"


def measure(app: AppState, session: EditSession, *, price: bool) -> None:
    """Counts in a thread what each detector finds at its usual threshold: those that need no pictures; or,
    with their `price`, all of them and what deleting it costs in dB."""
    form, document = session.forms.clean, session.document
    of, before, gaussians, tools = (
        document.versions,
        frozen(document.edits),
        document.gaussians,
        document.tools,
    )
    editable, cameras = document.editable.copy(), views(app, session) if price else ()
    known = is_priced if price else is_counted
    names = [name for name, each in DETECTORS.items() if (price or not each.renders)]
    names = [name for name in names if not known(session, name)]

    def work(progress: Progress) -> None:
        pictures = []
        for number, camera in enumerate(cameras):
            progress.step(0.2 * number / len(cameras))
            pictures.append(tools.picture(gaussians, camera, before))
        for number, name in enumerate(names):
            detector = DETECTORS[name]()
            begin = 0.2 * price
            part = progress.part(*(begin + (1 - begin) * n / len(names) for n in (number, number + 1)))
            known_of, mask = form.masks.get(name, (None, editable))
            if known_of != of:
                scores = detector.scores(gaussians, before, tools, cameras, progress=part.part(0.0, 0.5))
                mask = detector.mask(scores, detector.threshold) & editable
                form.masks[name], form.counts[name] = (of, mask), (of, int(np.count_nonzero(mask)))
            if price and mask.any():
                after = with_deleted(before, mask)
                impacts = []
                for place, (camera, picture) in enumerate(zip(cameras, pictures, strict=True)):
                    part.step(0.5 + 0.5 * place / len(cameras))
                    impacts.append(compare(camera, picture, tools.picture(gaussians, camera, after)))
                form.prices[name] = of, Impact.of((gaussians, before), (gaussians, after), impacts)

    if session.start(PRICING if price else COUNTING, work, lambda _: None, yields="silently"):
        form.measuring = session.job


@with_session
def look(app: AppState, session: EditSession) -> None:
    """Scores all splats in a thread, then highlights those above the detector's usual threshold."""
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

    session.start(f"Looking for {detector.label.lower()}", work, done, yields="with a word")


def set_threshold(session: EditSession, value: float) -> None:
    """Highlights the splats that score above `value`, as far as they may be deleted."""
    form = session.forms.clean
    if form.scores is None:
        return
    usual, of = value == DETECTORS[form.detector].threshold, session.document.versions
    known_of, known = form.prices.get(form.detector, (None, None))
    form.threshold, form.price = value, known if usual and known_of == of else None
    form.mask = DETECTORS[form.detector]().mask(form.scores, value) & session.document.editable
    form.count = int(np.count_nonzero(form.mask))
    session.preview_mask, session.preview_of = form.mask, SECTION


@with_session
def measure_price(app: AppState, session: EditSession) -> None:
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

    session.start("Measuring the price", work, done, yields="with a word")


@with_session
def prune(app: AppState, session: EditSession) -> None:
    """Deletes what is highlighted."""
    session.apply_slowly(Prune(**_found(app, session)), "Deleting")


@with_session
def select(app: AppState, session: EditSession, mode: Mode) -> None:
    """Selects what is highlighted, or changes the selection by it."""
    session.apply_slowly(SelectDetected(**_found(app, session), mode=mode), "Selecting")


def _found(app: AppState, session: EditSession) -> dict[str, Any]:
    """What is highlighted as the fields of an operation; the highlight ends."""
    form = session.forms.clean
    detector = DETECTORS[form.detector]
    cameras = views(app, session) if detector.renders else ()
    session.preview_mask = None
    return {"by": detector(), "threshold": form.threshold, "cameras": cameras}


@with_session
def forget(app: AppState, session: EditSession) -> None:
    form = session.forms.clean
    form.scores, form.mask, form.price, session.preview_mask = None, None, None, None


@with_session
def price_decimation(app: AppState, session: EditSession) -> None:
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

    session.start("Measuring the price", work, done, yields="with a word")


@with_session
def keep_best(app: AppState, session: EditSession) -> None:
    keep = session.forms.clean.keep
    session.apply_slowly(Decimate(keep=keep, cameras=views(app, session)), "Keeping the best")


def repair_prices(app: AppState) -> dict[str, Impact]:
    """Prices of repairs by finding; none where they were not measured, or the scene was edited since."""
    session = session_of(app)
    if session is None or session.forms.health.of != session.document.versions:
        return {}
    return session.forms.health.prices


@with_session
def measure_repairs(app: AppState, session: EditSession, names: Sequence[str]) -> None:
    """Measures what the repair of each of the findings `names` would cost by itself, in a thread."""
    form, document = session.forms.health, session.document
    repairs = {name: Repair(finding=name) for name in names}
    of, cameras = document.versions, views(app, session)

    def work(progress: Progress) -> dict[str, Impact]:
        return operation_impacts(document, repairs, cameras, progress=progress)

    def done(found: dict[str, Impact]) -> None:
        form.prices, form.of = found, of

    session.start("Measuring what repairs cost", work, done, yields="with a word")
