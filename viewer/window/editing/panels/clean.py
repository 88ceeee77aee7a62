"""Clean-up: detectors with a slider, what they would take lit up, and its price before it is paid."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from imgui_bundle import ImVec4, imgui

from .....edit.detecting import DETECTORS
from .....edit.operations.pruning import Decimate, Prune, editable
from .....edit.price import NO_LOSS, price, unchanging, with_deleted
from .....edit.sample_views import sample_cameras
from .....edit.watch import Watch
from .....scene import Camera
from ... import theme
from ...panels import widgets
from ..desk import Desk

if TYPE_CHECKING:
    from ...core import Core

VIEWS = 8
"""That a price is measured in."""

MOST_LOADED = 16
"""Of loaded cameras, spread evenly."""

GOOD, FAIR = 45.0, 35.0
"""dB: above the one nobody sees the difference; below the other anybody does."""


def show(core: Core, desk: Desk) -> None:
    form = desk.forms.clean
    names = tuple(DETECTORS)
    detector = DETECTORS[form.detector]
    chosen = widgets.combo(
        "Find", form.detector, names, detector.what, [DETECTORS[name].label for name in names]
    )
    if chosen is not None:
        form.detector, form.scores, form.mask, form.price = chosen, None, None, None
        form.threshold, desk.highlight = DETECTORS[chosen].threshold, None
        detector = DETECTORS[chosen]
    widgets.note(detector.what)
    key = (form.detector, desk.document.versions)
    if form.scores is None or form.of != key:
        if form.scores is not None:
            form.scores, form.mask, form.price, desk.highlight = None, None, None, None
        tip = "Looks at every splat" + (", in pictures from around the scene." if detector.renders else ".")
        widgets.button("Look for them", tip, partial(core.post, _look), width=-1)
    else:
        threshold(core, desk)
    if desk.trainee is None:  # training fills up again to its number
        widgets.section("Fewer splats")
        decimation(core, desk)


def views(core: Core, desk: Desk) -> tuple[Camera, ...]:
    """The loaded cameras if there are some, else views from around the scene."""
    if core.cameras:
        step = -(-len(core.cameras) // MOST_LOADED)
        return tuple(core.cameras[::step])
    return tuple(sample_cameras(desk.document.gaussians, desk.document.edits, VIEWS))


def _look(core: Core) -> None:
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


def threshold(core: Core, desk: Desk) -> None:
    form = desk.forms.clean
    detector = DETECTORS[form.detector]()
    low, high = detector.slider
    value = widgets.slider(
        "Threshold", form.threshold, low, high, f"In {detector.unit}.", form="%.4g", logarithmic=detector.log
    )
    if value is not None:
        set_threshold(desk, value)
    widgets.note(f"{form.count:,} splats are {detector.meaning(form.threshold)}: red on the picture.")
    if not form.count:
        return
    show_price(form.price)
    if form.price is None:
        widgets.button(
            "What would it cost?",
            f"Draws {VIEWS} views with and without them and compares.",
            partial(core.post, _price),
        )
        widgets.beside(f"Delete {form.count:,}")
    tip = "Undo brings them back." if desk.trainee is None else "From the training; there is no way back."
    widgets.button(f"Delete {form.count:,}", tip, partial(core.post, _prune))
    widgets.beside("Leave them")
    widgets.button("Leave them", "Nothing is deleted.", partial(core.post, _forget))


def show_price(cost: Any) -> None:
    if cost is None:
        return
    colour = (
        ImVec4(0.45, 0.8, 0.5, 1)
        if cost.worst >= GOOD
        else theme.WARNING
        if cost.worst >= FAIR
        else theme.ERROR
    )
    mean, worst = (">= 100" if value >= NO_LOSS else f"{value:.1f}" for value in (cost.mean, cost.worst))
    widgets.note(f"Pictures stay at {mean} dB on average, {worst} dB at worst.", colour)
    widgets.tooltip(
        f"PSNR of {cost.views} views after against before; the largest error of any pixel is "
        f"{cost.largest_error * 255:.0f}/255. Above 45 dB nobody sees a difference."
    )


def _price(core: Core) -> None:
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


def _prune(core: Core) -> None:
    desk = core.desk
    if desk is None:
        return
    form = desk.forms.clean
    detector = DETECTORS[form.detector]
    cameras = views(core, desk) if detector.renders else ()
    desk.highlight = None
    desk.apply_slowly(Prune(by=detector(), threshold=form.threshold, cameras=cameras), "Deleting")


def _forget(core: Core) -> None:
    if core.desk is not None:
        form = core.desk.forms.clean
        form.scores, form.mask, form.price, core.desk.highlight = None, None, None, None


def decimation(core: Core, desk: Desk) -> None:
    """Keeps the splats that matter most to the views."""
    form, counts = desk.forms.clean, desk.document.counts
    if not 1 <= form.keep <= counts.kept:
        form.keep = max(counts.kept // 2, 1)
    widgets.label("Keep", "How many splats are left: those that contribute most to the pictures.")
    changed, value = imgui.input_int("##keep", form.keep, max(counts.kept // 20, 1), max(counts.kept // 5, 1))
    if changed:
        form.keep, form.kept_price = min(max(int(value), 1), counts.kept), None
    if form.kept_price is not None and form.kept_price[0] == (form.keep, desk.document.versions):
        show_price(form.kept_price[1])
    else:
        widgets.button(
            "What would that cost?##keep",
            f"Draws {VIEWS} views with all splats and with the {form.keep:,} that matter most.",
            partial(core.post, _price_decimation),
        )
        widgets.beside(f"Keep {form.keep:,} of {counts.kept:,}")
    widgets.button(
        f"Keep {form.keep:,} of {counts.kept:,}", Decimate.summary + ".", partial(core.post, _decimate)
    )


def _price_decimation(core: Core) -> None:
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


def _decimate(core: Core) -> None:
    if core.desk is not None:
        keep = core.desk.forms.clean.keep
        core.desk.apply_slowly(Decimate(keep=keep, cameras=views(core, core.desk)), "Keeping the best")
