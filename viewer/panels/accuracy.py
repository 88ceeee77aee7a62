"""The Accuracy panel: what every shortcut saves and costs in this view, and drawing by it."""

from __future__ import annotations

from functools import partial

from imgui_bundle import ImVec4, imgui

from splatview.measure.knobs import Knob, Plan, knob
from splatview.measure.ladder import Ladder, Measured, is_clear
from splatview.measure.work import rows, sums
from splatview.viewer import theme
from splatview.viewer.panels import effects, pareto, widgets
from splatview.viewer.preferences import RANGES
from splatview.viewer.quality.comparison import RIGHTS
from splatview.viewer.quality.measurement import applicable, unpriced_knobs
from splatview.viewer.quality.state import Accuracy, choose, price_of
from splatview.viewer.state import AppState

RIGHT_NAMES = {
    "off": "Off",
    "chosen": "Split view",
    "signed": "Difference",
    "perceptual": "FLIP",
}


def show(app: AppState) -> None:
    accuracy = app.feature(Accuracy)
    if not app.is_open:
        widgets.note("Open a scene to see what accuracy costs in it.")
        return
    tools(app, accuracy)
    if accuracy.ladder is None:
        widgets.note(
            "Measure draws this view with each shortcut, and tells what it saves in time and how far it is "
            "from a float64 truth, on this machine. A click on a value then draws by it."
        )
    else:
        ladder = accuracy.ladder
        pareto.show(app, accuracy, ladder)
        base = ladder.baseline
        exact = f"{base.psnr:.1f} dB" if base.psnr != float("inf") else "the truth itself"
        widgets.note(f"Exact: {base.ms:.1f} ms a frame, {exact}. Noise floor: {ladder.noise:.0%}.")
        if widgets.fold(app, f"All {len(ladder.rungs) - 1} shortcuts###all"):
            prices(app, accuracy, ladder)
    limit = app.preferences.frame_budget_ms
    title = f"Frame limit {limit:.0f} ms ({1000 / limit:.0f} fps)###Frame limit"
    if widgets.fold(app, title, opened=True):
        budget(app, accuracy)
    if widgets.fold(app, "Compare", opened=True):
        split(accuracy)
    if accuracy.bill is not None and widgets.fold(app, "Work of this view"):
        bill(accuracy)
    if widgets.fold(app, "Effects"):
        effects.show(app)


def tools(app: AppState, accuracy: Accuracy) -> None:
    """Measure or cancel, and the way back to exact."""
    measurement = accuracy.measurement
    if measurement is None:
        again = "Measure again" if accuracy.ladder is not None else "Measure"
        widgets.button(
            f"{again}###measure",
            "Measures for some seconds what each shortcut saves and costs in this view; the window can "
            "be used meanwhile.",
            partial(app.post, accuracy.measure),
        )
    else:
        widgets.progress(measurement.progress, measurement.text, beside_em=5)
        imgui.same_line()
        widgets.button(
            "Cancel###cancel", "Ends measuring.", partial(app.post, lambda app: accuracy.cancel_measuring())
        )
    if accuracy.choices:
        if measurement is None:
            imgui.same_line()
        widgets.button(
            "Exact###exact", "Takes all shortcuts back.", partial(app.post, lambda app: accuracy.exact())
        )


def prices(app: AppState, accuracy: Accuracy, ladder: Ladder) -> None:
    """A row a value, by knob; the chosen ones are bright."""
    base = ladder.baseline
    flags = imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop
    if imgui.begin_table("prices", 4, flags):
        for title, width in (("shortcut", 3.2), ("time", 2.4), ("dB", 1.2), ("largest", 1.5)):
            imgui.table_setup_column(title, imgui.TableColumnFlags_.width_stretch, width)
        imgui.table_headers_row()
        before = None
        for one in ladder.rungs:
            if one is base:
                continue
            if one.rung.knob != before:
                before = one.rung.knob
                imgui.table_next_row()
                imgui.table_next_column()
                imgui.text_colored(theme.QUIET, knob(before).title)
                widgets.tooltip(knob(before).changes)
            row(app, accuracy, ladder, one)
        for other in unpriced_knobs(app.picture.backend):
            unpriced(app, accuracy, other)
        imgui.end_table()
    if ladder.left_out:
        left = ", ".join(f"{rung.knob} {rung.value}" for rung in ladder.left_out)
        widgets.note(f"There was no time for {left}: a smaller window, or splatview ladder.")


def unpriced(app: AppState, accuracy: Accuracy, other: Knob) -> None:
    """A knob for which the scene is loaded anew: splatview ladder tells what it saves."""
    imgui.table_next_row()
    imgui.table_next_column()
    imgui.text_colored(theme.QUIET, other.title)
    widgets.tooltip(f"{other.changes}. Priced by splatview ladder, as the scene is loaded anew for it.")
    if accuracy.storing is not None:
        imgui.same_line()
        imgui.text_colored(theme.QUIET, "(loading)")
    for value in other.values:
        if not applicable(value.apply(Plan())):
            imgui.table_next_row()
            imgui.table_next_column()
            choice(app, accuracy, other.name, value.text, f"{other.name} {value.text}.")


def choice(app: AppState, accuracy: Accuracy, name: str, value: str, words: str) -> None:
    """A row's name, bright where it is chosen: a click takes the shortcut, another one gives it back."""
    chosen = accuracy.choices.get(name) == value
    colour = imgui.get_color_u32(ImVec4(*theme.ACCENT, 0.75))
    imgui.push_style_color(imgui.Col_.header, colour)
    clicked, _ = imgui.selectable(
        f"  {value}###{name} {value}", chosen, imgui.SelectableFlags_.span_all_columns
    )
    imgui.pop_style_color()
    widgets.tooltip(f"{words} Click to draw by it, again for exact.")
    if clicked:
        if chosen:
            app.post(lambda app: accuracy.choices.pop(name, None))
        else:
            app.post(choose, name, value)


def row(app: AppState, accuracy: Accuracy, ladder: Ladder, one: Measured) -> None:
    name, value = one.rung.knob, one.rung.value
    imgui.table_next_row()
    imgui.table_next_column()
    best = " Nothing else here is both faster and nearer to the truth." if one.pareto else ""
    choice(app, accuracy, name, value, f"{name} {value}: {price_of(one, ladder)}.{best}")
    known = is_clear(one)
    saved = ladder.baseline.ms * (1 - one.ratio)
    cells = (f"{-saved:+.1f} ms" if known else "same", f"{one.psnr:.1f}", f"{one.max_error:.1g}")
    for cell in cells:
        imgui.table_next_column()
        if cell == "same":
            imgui.text_colored(theme.QUIET, cell)
            widgets.tooltip("The difference is within the noise floor.")
        else:
            imgui.text_unformatted(cell)


def budget(app: AppState, accuracy: Accuracy) -> None:
    held = accuracy.budget_ms is not None
    changed = widgets.checkbox(
        "Hold",
        held,
        "Makes pictures as coarse as the limit asks while the camera moves, and exact again two frames "
        "after it rests; a badge states the error.",
    )
    if changed is not None:
        app.post(accuracy.hold, app.preferences.frame_budget_ms if changed else None)
    milliseconds = widgets.slider(
        "A frame",
        app.preferences.frame_budget_ms,
        *RANGES["frame_budget_ms"],
        "What drawing a frame may take while the camera moves.",
        form="%.0f ms",
        logarithmic=True,
    )
    if milliseconds is not None:
        app.prefer(frame_budget_ms=milliseconds)
        if held:
            app.post(accuracy.hold, milliseconds)
    total = sum(app.stats.ms.values())
    now = accuracy.note or (f"{total:.1f} ms, in full" if total else "nothing drawn yet")
    widgets.fact("Now", now, "What the last picture took, and what was left out of it.")


def split(accuracy: Accuracy) -> None:
    comparing = accuracy.comparing
    chosen = widgets.combo(
        "Compare",
        comparing.right,
        RIGHTS,
        "Puts the picture by the chosen shortcuts (split), their difference (grey: equal) or what an eye "
        "notices of it (FLIP, black: nothing) right of a line that can be dragged, beside the exact one.",
        [RIGHT_NAMES[name] for name in RIGHTS],
    )
    if chosen is not None:
        comparing.right = chosen
    if comparing.right == "off":
        return
    if comparing.right == "signed":
        gain = widgets.slider(
            "Gain", comparing.gain, 1.0, 64.0, "By how much differences are brightened.", logarithmic=True
        )
        if gain is not None:
            comparing.gain = gain
    if comparing.problem is not None:
        widgets.note(comparing.problem, theme.ERROR)
    elif comparing.latest is not None:
        made = comparing.latest
        score = "no error" if made.psnr == float("inf") else f"{made.psnr:.1f} dB"
        widgets.fact("Largest error", f"{made.largest:.3g} of 1 ({made.largest * 255:.0f} of 255)")
        widgets.fact("Apart", f"{score}; noticed {made.noticed:.3f} of 1 on average")


def bill(accuracy: Accuracy) -> None:
    """What the picture asks of a machine, beside what a NeRF would."""
    made = accuracy.bill
    if made is None:
        return
    if imgui.begin_table("bill", 3, imgui.TableFlags_.row_bg | imgui.TableFlags_.sizing_stretch_prop):
        for title in ("", "splats", "a NeRF"):
            imgui.table_setup_column(title)
        imgui.table_headers_row()
        for cells in rows(made):
            imgui.table_next_row()
            for cell in cells:
                imgui.table_next_column()
                imgui.push_text_wrap_pos(0)
                imgui.text_unformatted(cell)
                imgui.pop_text_wrap_pos()
        imgui.end_table()
    for line in sums(made):
        widgets.note(line)
