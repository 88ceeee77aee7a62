"""The Select section: commands on the selection, options of the tools, and a range of an attribute."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from imgui_bundle import ImVec4, imgui, implot

from splatview.edit.impact import frozen
from splatview.edit.operations import Select
from splatview.edit.selectors import AttributeRange
from splatview.edit.selectors.attributes import ATTRIBUTES, attribute_values, histogram, usual_span
from splatview.scene.edits import DELETED, HIDDEN
from splatview.scene.progress import Progress
from splatview.viewer import theme
from splatview.viewer.editing.session import EditSession, post_edit
from splatview.viewer.editing.tool_state import mode_of
from splatview.viewer.panels import widgets

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


BINS = 96

PLOT_HEIGHT = 7.0
"""Font heights."""


def show(app: AppState, session: EditSession) -> None:
    counts = session.document.counts
    widgets.fact("Selected", f"{counts.selected:,} of {counts.selectable:,}", "Splats that can be selected.")
    parts = [("hidden", counts.hidden), ("locked", counts.locked), ("deleted", counts.deleted)]
    widgets.fact("Set aside", ", ".join(f"{n:,} {name}" for name, n in parts if n) or "none")
    words = ("All", "None", "Invert", "Grow", "Shrink")
    actions = ("select_all", "select_none", "select_inverse", "grow", "shrink")
    for number, (name, action) in enumerate(zip(words, actions, strict=True)):
        if number:
            widgets.beside(name)
        widgets.command_button(app, name, action)
    for number, (name, action) in enumerate(
        (("Delete", "delete"), ("Hide", "hide"), ("Isolate", "isolate"), ("Lock", "lock"))
    ):
        if number:
            widgets.beside(name)
        widgets.command_button(app, name, action)
    widgets.command_button(app, "Show hidden", "show")
    widgets.beside("Unlock all")
    widgets.command_button(app, "Unlock all", "unlock")
    options(session)
    by_range(app, session)


def options(session: EditSession) -> None:
    """Options of the screen tools, whichever is in hand: rows that come and go would move all below them."""
    front = widgets.checkbox(
        "Front only",
        session.depth == "front",
        "Screen tools take only the surface that is seen, not what lies behind it (T).",
    )
    if front is not None:
        session.depth = "front" if front else "through"
    radius = widgets.slider(
        "Brush", session.brush_radius, 2.0, 600.0, "Radius in pixels.", form="%.0f px", logarithmic=True
    )
    session.brush_radius = session.brush_radius if radius is None else radius
    tolerance = widgets.slider(
        "Tolerance",
        session.tolerance,
        0.005,
        1.0,
        "Of wand and colour: how far colours may be apart, as the eye sees it; black to white is 1.",
        form="%.3f",
        logarithmic=True,
    )
    session.tolerance = session.tolerance if tolerance is None else tolerance


def by_range(app: AppState, session: EditSession) -> None:
    """A histogram of one attribute; the shaded range is highlighted on the picture as it is dragged."""
    form = session.forms.range
    names = tuple(ATTRIBUTES)
    chosen = widgets.combo(
        "By range of",
        form.attribute,
        names,
        ATTRIBUTES[form.attribute].what,
        [ATTRIBUTES[name].label for name in names],
    )
    if chosen is not None:
        form.attribute, form.values, form.histogram = chosen, None, None
        session.preview_mask = None
    key = (form.attribute, session.document.versions)
    if form.values is None or form.of != key:
        if form.values is None and ATTRIBUTES[form.attribute].renders:
            tip = "Takes pictures of the scene from around it; some seconds."
            widgets.button("Measure", tip, partial(measure, session))
            return
        session.preview_mask = None
        measure(session)
    if form.histogram is None:
        low = imgui.get_cursor_pos_y()
        widgets.note("Counting...")
        # The sections below stay where they are when it comes: someone may be about to click one.
        rows = imgui.get_font_size() * PLOT_HEIGHT + 3 * imgui.get_frame_height()
        spent = imgui.get_cursor_pos_y() - low
        imgui.dummy((1, rows + 3 * imgui.get_style().item_spacing.y - spent))
        return
    plot(session)
    selecting(app, session)


def measure(session: EditSession) -> None:
    """Computes the attribute in a thread; the histogram follows."""
    form, document = session.forms.range, session.document
    if session.job is not None:
        return
    name, key = form.attribute, (form.attribute, document.versions)
    gaussians, edits, tools = document.gaussians, frozen(document.edits), document.tools
    fresh = form.histogram is None

    def work(progress: Progress):
        progress.step(0.0)
        values = attribute_values(name, gaussians, edits, tools)
        seen = (edits.marks & (DELETED | HIDDEN)) == 0
        span = usual_span(values, seen)
        attribute = ATTRIBUTES[name]
        log = attribute.log and span[0] > 0 and span[1] > span[0]
        return values, histogram(
            values, seen, bins=BINS, log=log, span=span if log or span[1] > span[0] else None
        )

    def done(result) -> None:
        form.values, counted = result
        form.histogram, form.of = counted, key
        if fresh:
            edges = counted.edges
            form.low, form.high = float(edges[0]), float(edges[len(edges) // 10])

    asked = ATTRIBUTES[name].renders
    session.start(
        f"Measuring {ATTRIBUTES[name].label.lower()}",
        work,
        done,
        yields="with a word" if asked else "silently",
    )


def plot(session: EditSession) -> None:
    """The counts, what is chosen of them in colour, between two lines to drag."""
    form = session.forms.range
    counted = form.histogram
    if counted is None:
        return
    flags = implot.Flags_.no_legend | implot.Flags_.no_menus | implot.Flags_.no_mouse_text
    name = f"##range {form.attribute}"
    if not implot.begin_plot(name, (-1, imgui.get_font_size() * PLOT_HEIGHT), flags):
        return
    bare = implot.AxisFlags_.no_grid_lines
    implot.setup_axes("", "", bare, bare | implot.AxisFlags_.no_tick_labels)
    if counted.log:
        implot.setup_axis_scale(implot.ImAxis_.x1, implot.Scale_.log10)
    implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.sym_log)
    low, high = float(counted.edges[0]), float(counted.edges[-1])
    implot.setup_axes_limits(low, high, 0.0, 1.1 * float(counted.counts.max(initial=1)), implot.Cond_.once)
    steps = np.repeat(counted.edges, 2)[1:-1]
    heights = np.repeat(counted.counts, 2).astype(np.float64)
    middles = np.sqrt(counted.edges[1:] * counted.edges[:-1]) if counted.log else None
    middles = (counted.edges[1:] + counted.edges[:-1]) / 2 if middles is None else middles
    chosen = np.repeat((middles >= form.low) & (middles <= form.high), 2)
    implot.plot_shaded("splats", steps, heights, 0.0, implot.Spec(fill_color=ImVec4(0.55, 0.57, 0.6, 0.5)))
    ink = ImVec4(*theme.ACCENT, 0.9)
    implot.plot_shaded("chosen", steps, np.where(chosen, heights, 0.0), 0.0, implot.Spec(fill_color=ink))
    for number, end in enumerate(("low", "high")):
        changed, value, *_ = implot.drag_line_x(number, getattr(form, end), ink, 2)
        if changed:
            setattr(form, end, float(value))
            form.low, form.high = min(form.low, form.high), max(form.low, form.high)
            highlight_range(session)
    implot.end_plot()


def highlight_range(session: EditSession) -> None:
    """Highlights the splats in the range on the picture."""
    form = session.forms.range
    if form.values is not None:
        mask = AttributeRange(attribute=form.attribute, low=form.low, high=form.high).of(form.values)
        session.preview_mask = mask & ((session.document.marks & (DELETED | HIDDEN)) == 0)
        session.preview_of = "Select"


def selecting(app: AppState, session: EditSession) -> None:
    form = session.forms.range
    attribute = ATTRIBUTES[form.attribute]
    for name, end in (("From", "low"), ("To", "high")):
        widgets.label(name, f"{attribute.label}, {attribute.unit}.")
        changed, value = imgui.input_double(f"##{end}", getattr(form, end), 0.0, 0.0, "%.6g")
        if changed and np.isfinite(value):
            setattr(form, end, float(value))
            highlight_range(session)
    if session.preview_mask is not None:
        widgets.note(f"{int(np.count_nonzero(session.preview_mask)):,} splats are in this range.")
    io = imgui.get_io()
    mode = mode_of(shift=io.key_shift, ctrl=io.key_ctrl)
    words = {"set": "Select them", "add": "Add them", "remove": "Remove them", "intersect": "Keep only these"}
    if imgui.button(words[mode]) and form.low <= form.high:
        by = AttributeRange(attribute=form.attribute, low=form.low, high=form.high)
        session.preview_mask = None
        post_edit(app, _apply, Select(by=by, mode=mode))
    widgets.tooltip(
        "Hold Shift to add to the selection, Ctrl to remove from it, both to keep what is common."
    )


def _apply(session: EditSession, operation: Select) -> None:
    if ATTRIBUTES[operation.by.attribute].renders:
        session.apply_slowly(operation, "Selecting")
    else:
        session.apply(operation)
