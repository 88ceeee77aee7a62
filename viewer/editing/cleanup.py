"""Clean-up without its panel: what one would rather be without, what losing it costs, and losing it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from splatview.edit.detectors import DETECTORS
from splatview.edit.impact import Price, price, price_operations, unchanging, with_deleted
from splatview.edit.operations.cleanup import Decimate, Prune, Repair, editable
from splatview.edit.progress import Watch
from splatview.edit.sample_views import sample_cameras
from splatview.scene import Camera
from splatview.viewer.editing.session import Desk

if TYPE_CHECKING:
    from splatview.viewer.state import Core


VIEWS = 8
"""That a price is measured in."""

MOST_LOADED = 16
"""Of loaded cameras, spread evenly."""


def choose_detector(desk: Desk, name: str) -> None:
    """Another of DETECTORS; what the one before has found is forgotten."""
    form = desk.forms.clean
    form.detector, form.scores, form.mask, form.price = name, None, None, None
    form.threshold, desk.highlight = DETECTORS[name].threshold, None


def find(core: Core, detector: str) -> None:
    """Looks for splats by one of DETECTORS and shows the section that says what was found."""
    if core.desk is None:
        core.tell("Open a scene first")
        return
    choose_detector(core.desk, detector)
    core.desk.forms.open_section = "Clean up"
    look(core)


def views(core: Core, desk: Desk) -> tuple[Camera, ...]:
    """The loaded cameras if there are some, else views from around the scene."""
    if core.cameras:
        step = -(-len(core.cameras) // MOST_LOADED)
        return tuple(core.cameras[::step])
    return tuple(sample_cameras(desk.document.gaussians, desk.document.edits, VIEWS))


def look(core: Core) -> None:
    """Scores in a thread; then the slider's first threshold."""
    desk = core.desk
    if desk is None:
        return
    form, document = desk.forms.clean, desk.document
    name, detector = form.detector, DETECTORS[form.detector]
    key = (name, document.versions)
    cameras = views(core, desk) if detector.renders else ()

    def work(watch: Watch) -> np.ndarray:
        # The document keeps them for the deletion that may follow.
        return document.scores(detector(), cameras, watch=watch)

    def done(scores: np.ndarray) -> None:
        form.scores, form.of, form.threshold = scores, key, detector.threshold
        set_threshold(desk, detector.threshold)

    desk.start(f"Looking for {detector.label.lower()}", work, done)


def set_threshold(desk: Desk, value: float) -> None:
    """Lights up what scores above it, as far as it may be deleted."""
    form = desk.forms.clean
    if form.scores is None:
        return
    form.threshold, form.price = value, None
    form.mask = DETECTORS[form.detector]().mask(form.scores, value) & editable(desk.document)
    form.count = int(np.count_nonzero(form.mask))
    desk.highlight = form.mask


def measure_price(core: Core) -> None:
    desk = core.desk
    if desk is None:
        return
    form, document = desk.forms.clean, desk.document
    mask, before = form.mask, unchanging(document.edits)
    if mask is None:
        return
    after, cameras = with_deleted(before, mask), views(core, desk)

    def work(watch: Watch) -> Any:
        return price(document.gaussians, before, after, document.tools, cameras, watch=watch)

    def done(cost: Any) -> None:
        if form.mask is mask:
            form.price = cost

    desk.start("Measuring the price", work, done)


def prune(core: Core) -> None:
    desk = core.desk
    if desk is None:
        return
    form = desk.forms.clean
    detector = DETECTORS[form.detector]
    cameras = views(core, desk) if detector.renders else ()
    desk.highlight = None
    desk.apply_slowly(Prune(by=detector(), threshold=form.threshold, cameras=cameras), "Deleting")


def forget(core: Core) -> None:
    if core.desk is not None:
        form = core.desk.forms.clean
        form.scores, form.mask, form.price, core.desk.highlight = None, None, None, None


def price_decimation(core: Core) -> None:
    desk = core.desk
    if desk is None:
        return
    form, document = desk.forms.clean, desk.document
    key, before, cameras = (form.keep, document.versions), unchanging(document.edits), views(core, desk)

    def work(watch: Watch) -> Any:
        part = watch.part(0.0, 0.4)
        mask = Decimate(keep=key[0], cameras=cameras).doomed(document, part)
        after = with_deleted(before, mask)
        return price(document.gaussians, before, after, document.tools, cameras, watch=watch.part(0.4, 1.0))

    def done(cost: Any) -> None:
        form.kept_price = (key, cost)

    desk.start("Measuring the price", work, done)


def keep_best(core: Core) -> None:
    if core.desk is not None:
        keep = core.desk.forms.clean.keep
        core.desk.apply_slowly(Decimate(keep=keep, cameras=views(core, core.desk)), "Keeping the best")


# ---- What repairs of the health report would cost, measured in a thread.


__all__ = ["VIEWS", "measure", "prices"]


def prices(core: Core) -> dict[str, Price]:
    """By finding; none where they were not measured, or the scene was edited since."""
    if core.desk is None:
        return {}
    form = core.desk.forms.health
    return form.prices if form.of == core.desk.document.versions else {}


def measure(core: Core, names: Sequence[str]) -> None:
    """Of the repairs of the findings `names`, each by itself, by the renderer of all prices."""
    desk = core.desk
    if desk is None:
        return
    form, document = desk.forms.health, desk.document
    repairs = {name: Repair(finding=name) for name in names}
    of, cameras = document.versions, views(core, desk)

    def work(watch: Watch) -> dict[str, Price]:
        return price_operations(document, repairs, cameras, watch=watch)

    def done(found: dict[str, Price]) -> None:
        form.prices, form.of = found, of

    desk.start("Measuring what repairs cost", work, done)
