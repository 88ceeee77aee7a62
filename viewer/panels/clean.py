"""The Clean up section: detectors with a threshold, what they would delete, and its price in dB."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from imgui_bundle import ImVec4, imgui

from splatview.edit.detectors import DETECTORS
from splatview.edit.impact import NO_LOSS, Impact
from splatview.edit.operations.cleanup import Decimate
from splatview.viewer import theme
from splatview.viewer.editing import cleanup
from splatview.viewer.editing.cleanup import VIEWS
from splatview.viewer.editing.session import EditSession
from splatview.viewer.editing.tool_state import mode_of
from splatview.viewer.panels import widgets

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


GOOD, FAIR = 45.0, 35.0
"""dB: above the one nobody sees the difference; below the other anybody does."""


CANCEL_EM = 5.0
"""Width of the button beside the progress, in font heights."""


def show(app: AppState, session: EditSession) -> None:
    form = session.forms.clean
    detectors(app, session)
    key = (form.detector, session.document.versions)
    if form.scores is not None and form.of != key:
        form.scores, form.mask, form.price, session.preview_mask = None, None, None, None
    if form.scores is not None:
        widgets.section(DETECTORS[form.detector].label)
        threshold(app, session)
    if session.target.at_rest:  # training fills up again to its number
        widgets.section("Fewer splats")
        decimation(app, session)


def detectors(app: AppState, session: EditSession) -> None:
    """All of them, with how many splats each finds and what deleting those costs in the worst of VIEWS views;
    a click looks closer."""
    form, now = session.forms.clean, session.document.versions
    cleanup.keep_measured(app, session, touched=any(imgui.get_io().mouse_down))
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    if imgui.begin_table("detectors", 3, flags):
        for title, width in (("Find", 3.0), ("Splats", 1.6), ("Worst view", 1.9)):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch, width)
        imgui.table_headers_row()
        for name, detector in DETECTORS.items():
            imgui.table_next_row()
            imgui.table_next_column()
            chosen = name == form.detector and form.scores is not None
            across = imgui.SelectableFlags_.span_all_columns
            if imgui.selectable(f"{detector.label}###{name}", chosen, across)[0]:
                app.post(cleanup.forget if chosen else partial(cleanup.find, detector=name))
            widgets.tooltip(f"{detector.what} Click to see them on the picture.")
            imgui.table_next_column()
            if cleanup.is_counted(session, name):
                count = form.counts[name][1]
                ink = imgui.get_style_color_vec4(imgui.Col_.text) if count else theme.QUIET
                imgui.text_colored(ink, f"{count:,}")
            else:
                imgui.text_colored(theme.QUIET, "-")
            imgui.table_next_column()
            of, price = form.prices.get(name, (None, None))
            if price is not None and of == now:
                worst = "no loss" if price.worst >= NO_LOSS else f"{price.worst:.1f} dB"
                imgui.text_colored(quality(price), worst)
            else:
                imgui.text_colored(theme.QUIET, "-")
        imgui.end_table()
    job = form.measuring
    if job is not None and job is session.job:
        widgets.progress(job.progress, job.title, beside_em=CANCEL_EM)
        imgui.same_line()
        widgets.button("Cancel", "Not measured again before the next edit (Esc).", job.cancel, width=-1)
    else:  # as high: nothing below moves
        imgui.align_text_to_frame_padding()
        room = imgui.get_content_region_avail().x
        note = f"Above {GOOD:.0f} dB nobody sees a difference."
        imgui.text_colored(theme.QUIET, widgets.fitting(note, room))


def threshold(app: AppState, session: EditSession) -> None:
    form = session.forms.clean
    detector = DETECTORS[form.detector]()
    low, high = detector.slider
    value = widgets.slider(
        "Threshold", form.threshold, low, high, f"In {detector.unit}.", form="%.4g", logarithmic=detector.log
    )
    if value is not None:
        cleanup.set_threshold(session, value)
    widgets.note(f"{form.count:,} splats, red on the picture: {detector.meaning(form.threshold)}.")
    if not form.count:
        return
    show_price(form.price)
    if form.price is None:
        widgets.button(
            "What would it cost?",
            f"Draws {VIEWS} views with and without them and compares.",
            partial(app.post, cleanup.measure_price),
        )
        widgets.beside(f"Select {form.count:,}")
    io = imgui.get_io()
    mode = mode_of(shift=io.key_shift, ctrl=io.key_ctrl)
    widgets.button(
        f"Select {form.count:,}",
        "Shift adds them to the selection, Ctrl removes them from it, both keep what is common.",
        partial(app.post, cleanup.select, mode),
    )
    widgets.beside(f"Delete {form.count:,}")
    tip = "Undo brings them back." if session.target.at_rest else "From the training; there is no way back."
    widgets.button(f"Delete {form.count:,}", tip, partial(app.post, cleanup.prune))
    widgets.beside("Leave them")
    widgets.button("Leave them", "Nothing is deleted.", partial(app.post, cleanup.forget))


def show_price(cost: Any) -> None:
    if cost is None:
        return
    mean, worst = (">= 100" if value >= NO_LOSS else f"{value:.1f}" for value in (cost.mean, cost.worst))
    widgets.note(f"Pictures stay at {mean} dB on average, {worst} dB at worst.", quality(cost))
    widgets.tooltip(
        f"PSNR of {cost.views} views after against before, with at most "
        f"{cost.largest_error * 255:.0f}/255 of error in a pixel; above 45 dB nobody sees a difference."
    )


def quality(cost: Impact) -> ImVec4:
    """A colour that says whether anybody would see the difference."""
    if cost.worst >= GOOD:
        return ImVec4(0.45, 0.8, 0.5, 1)
    return theme.WARNING if cost.worst >= FAIR else theme.ERROR


def decimation(app: AppState, session: EditSession) -> None:
    """Keeps the splats that matter most to the views."""
    form, counts = session.forms.clean, session.document.counts
    if not 1 <= form.keep <= counts.kept:
        form.keep = max(counts.kept // 2, 1)
    widgets.label("Keep", "How many splats are left: those that contribute most to the pictures.")
    changed, value = imgui.input_int("##keep", form.keep, max(counts.kept // 20, 1), max(counts.kept // 5, 1))
    if changed:
        form.keep, form.kept_price = min(max(int(value), 1), counts.kept), None
    if form.kept_price is not None and form.kept_price[0] == (form.keep, session.document.versions):
        show_price(form.kept_price[1])
    else:
        widgets.button(
            "What would that cost?##keep",
            f"Draws {VIEWS} views with all splats and with the {form.keep:,} that matter most.",
            partial(app.post, cleanup.price_decimation),
        )
        widgets.beside(f"Keep {form.keep:,} of {counts.kept:,}")
    widgets.button(
        f"Keep {form.keep:,} of {counts.kept:,}", Decimate.summary + ".", partial(app.post, cleanup.keep_best)
    )
