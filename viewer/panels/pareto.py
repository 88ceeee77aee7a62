"""The plot of the Accuracy page: time against accuracy in this view, a mark for each shortcut.

A click on a mark draws by it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot

from splatview.measure.ladder import Ladder, Measured
from splatview.viewer import theme
from splatview.viewer.quality.state import Accuracy, choose, price_of
from splatview.viewer.state import AppState

HEIGHT_EM = 13.0
"""Height of the plot, in font heights."""

REACH_EM = 0.7
"""Distance from a mark within which the mouse is on it, in font heights."""

LEAST_MS = 1e-3
"""Below which no time is drawn."""

MOST_TICKS = 6
"""Numbers on the axis of time."""

ABOVE_DB = 8.0
"""How far above the others a mark without error is drawn."""


@dataclass(frozen=True)
class Mark:
    """One shortcut on the plot."""

    one: Measured
    ms: float
    db: float
    """PSNR, a finite one where there is no error."""


def marks(ladder: Ladder) -> list[Mark]:
    """Marks of all rungs that were measured, the exact picture first."""
    known = [one for one in ladder.rungs if math.isfinite(one.ratio) and not math.isnan(one.psnr)]
    finite = [one.psnr for one in known if math.isfinite(one.psnr)]
    top = max(finite, default=100.0) + ABOVE_DB
    base = ladder.baseline
    known.sort(key=lambda one: one is not base)
    return [Mark(one, max(base.ms * one.ratio, LEAST_MS), min(one.psnr, top)) for one in known]


def limits(places: Sequence[Mark]) -> tuple[float, float, float, float]:
    """(left, right, bottom, top) of the plot, with room around all marks; times are on a logarithmic axis, as
    one slow shortcut would press the others together."""
    x, y = [math.log(mark.ms) for mark in places], [mark.db for mark in places]
    dx, dy = max(max(x) - min(x), math.log(1.1)), max(max(y) - min(y), 5.0)
    left, right = math.exp(min(x) - 0.12 * dx), math.exp(max(x) + 0.18 * dx)
    return left, right, min(y) - 0.15 * dy, max(y) + 0.15 * dy


def ticks(left: float, right: float) -> list[float]:
    """Round times between the ends of the axis, at most some six: 1, 2 and 5 of each power of ten where that
    is few enough."""
    powers = range(math.floor(math.log10(left)), math.ceil(math.log10(right)) + 1)
    for steps in ((1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8), (1, 1.5, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,)):
        found = [step * 10.0**power for power in powers for step in steps]
        found = [value for value in found if left <= value <= right]
        if len(found) <= MOST_TICKS:
            break
    return found


def front(places: Sequence[Mark], base: Measured) -> np.ndarray:
    """Corners (P, 2) of the steps through the marks that nothing beats in both time and accuracy."""
    best = sorted((mark.ms, mark.db) for mark in places if mark.one.pareto or mark.one is base)
    if not best:
        return np.empty((0, 2))
    corners = [best[0]]
    for x, y in best[1:]:
        corners += [(x, corners[-1][1]), (x, y)]
    return np.array(corners)


def show(app: AppState, accuracy: Accuracy, ladder: Ladder) -> None:
    places = marks(ladder)
    if not places:
        return
    em = imgui.get_font_size()
    flags = implot.Flags_.no_legend | implot.Flags_.no_menus | implot.Flags_.no_box_select
    if not implot.begin_plot(
        "##pareto", (-1, HEIGHT_EM * em), flags | implot.Flags_.no_mouse_text | implot.Flags_.no_title
    ):
        return
    implot.setup_axes("ms a frame", "dB")
    left, right, bottom, top = limits(places)
    implot.setup_axis_scale(implot.ImAxis_.x1, implot.Scale_.log10)
    implot.setup_axes_limits(left, right, bottom, top, imgui.Cond_.always)
    round_ms = ticks(left, right)
    implot.setup_axis_ticks(implot.ImAxis_.x1, round_ms, [f"{ms:g}" for ms in round_ms], False)
    steps = front(places, ladder.baseline)
    if len(steps) > 1:
        line = implot.Spec(line_color=ImVec4(*theme.ACCENT, 0.7), line_weight=1.5)
        implot.plot_line("front", np.ascontiguousarray(steps[:, 0]), np.ascontiguousarray(steps[:, 1]), line)
    pixels = [implot.plot_to_pixels(mark.ms, mark.db) for mark in places]
    accuracy.marks = {
        (mark.one.rung.knob, mark.one.rung.value): (at.x, at.y)
        for mark, at in zip(places, pixels, strict=True)
    }
    mouse = imgui.get_mouse_pos()
    under = nearest([(at.x, at.y) for at in pixels], (mouse.x, mouse.y), REACH_EM * em)
    hovered = under if implot.is_plot_hovered() else None
    draw = implot.get_plot_draw_list()
    implot.push_plot_clip_rect()
    taken: list[tuple[float, float, float, float]] = []
    order = sorted(range(len(places)), key=lambda n: not is_chosen(accuracy, ladder, places[n].one))
    for number in order:
        draw_mark(draw, accuracy, ladder, places[number].one, pixels[number], hovered == number, taken)
    implot.pop_plot_clip_rect()
    implot.end_plot()
    if hovered is None:
        return
    one = places[hovered].one
    if one is ladder.baseline:
        imgui.set_tooltip(f"exact: {one.ms:.1f} ms, {db(one)}. Click to take all shortcuts back.")
    else:
        imgui.set_tooltip(f"{name_of(one)}: {price_of(one, ladder)}. {clicked_words(accuracy, one)}")
    if imgui.is_mouse_clicked(imgui.MouseButton_.left):
        take(app, accuracy, ladder, one)


def clicked_words(accuracy: Accuracy, one: Measured) -> str:
    chosen = accuracy.choices.get(one.rung.knob) == one.rung.value
    return "Click for exact again." if chosen else "Click to draw by it."


def take(app: AppState, accuracy: Accuracy, ladder: Ladder, one: Measured) -> None:
    """A click on a mark: takes its shortcut alone, or gives it back."""
    knob, value = one.rung.knob, one.rung.value
    chosen = accuracy.choices.get(knob) == value
    app.post(lambda app: accuracy.exact())
    if one is not ladder.baseline and not chosen:
        app.post(choose, knob, value)


def name_of(one: Measured) -> str:
    return f"{one.rung.knob} {one.rung.value}"


def db(one: Measured) -> str:
    return "the truth itself" if one.psnr == math.inf else f"{one.psnr:.1f} dB"


def is_chosen(accuracy: Accuracy, ladder: Ladder, one: Measured) -> bool:
    """Whether the picture is drawn by it now."""
    if one is ladder.baseline:
        return not accuracy.choices
    return accuracy.choices.get(one.rung.knob) == one.rung.value


def draw_mark(
    draw: imgui.ImDrawList,
    accuracy: Accuracy,
    ladder: Ladder,
    one: Measured,
    at: ImVec2,
    hovered: bool,
    taken: list[tuple[float, float, float, float]],
) -> None:
    """A dot, bright on the front, with a ring where the picture is drawn by it; its name where there is room
    beside the names in `taken`."""
    em = imgui.get_font_size()
    on_front = one.pareto or one is ladder.baseline
    ink = ImVec4(*theme.ACCENT, 1) if on_front else theme.QUIET
    draw.add_circle_filled(at, em * (0.28 if on_front else 0.2), imgui.get_color_u32(ink))
    chosen = is_chosen(accuracy, ladder, one)
    if chosen or hovered:
        ring = imgui.get_color_u32(imgui.Col_.text)
        draw.add_circle(at, em * 0.45, ring, 0, max(em * 0.1, 1.5))
    if not (on_front or chosen):
        return
    text = "exact" if one is ladder.baseline else name_of(one)
    size = imgui.calc_text_size(text)
    area = implot.get_plot_pos(), implot.get_plot_size()
    for x, y in (
        (at.x + 0.5 * em, at.y - size.y / 2),
        (at.x - 0.5 * em - size.x, at.y - size.y / 2),
        (at.x - size.x / 2, at.y - 1.5 * em),
        (at.x - size.x / 2, at.y + 0.5 * em),
    ):
        box = (x, y, x + size.x, y + size.y)
        inside = x >= area[0].x and box[2] <= area[0].x + area[1].x and y >= area[0].y
        if inside and box[3] <= area[0].y + area[1].y and not any(overlap(box, other) for other in taken):
            taken.append(box)
            draw.add_text(ImVec2(x, y), imgui.get_color_u32(imgui.Col_.text, 0.9), text)
            return


def overlap(a: tuple[float, float, float, float], b: tuple[float, float, float, float]) -> bool:
    return a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]


def nearest(points: Sequence[tuple[float, float]], place: tuple[float, float], reach: float) -> int | None:
    """The index of the nearest of `points` within `reach` px of `place`."""
    if not points:
        return None
    away = np.hypot(*(np.array(points) - place).T)
    best = int(np.argmin(away))
    return best if away[best] <= reach else None
