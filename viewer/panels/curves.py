"""Curves of a run: the loss, what the held-out photos score, and the number of splats."""

from __future__ import annotations

import numpy as np
from imgui_bundle import ImVec4, imgui, implot

from splatview.viewer import theme
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining

SMOOTHED = 60
"""The bright line of the loss is a mean over this share of the curve: photos differ, so steps jump."""

LOSS = ImVec4(0.93, 0.62, 0.33, 1)
SCORE = ImVec4(0.45, 0.80, 0.50, 1)
COUNT = ImVec4(*theme.ACCENT, 1)


def show(app: AppState) -> None:
    training = app.training
    if training is None:
        return
    imgui.align_text_to_frame_padding()
    imgui.text_colored(theme.QUIET, "Over")
    imgui.same_line()
    if imgui.radio_button("steps", not training.by_seconds):
        training.by_seconds = False
    imgui.same_line()
    if imgui.radio_button("seconds", training.by_seconds):
        training.by_seconds = True
    widgets.tooltip("Seconds of training; pauses are left out.")
    room, spacing = imgui.get_content_region_avail(), imgui.get_style().item_spacing.x
    size = ((room.x - 2 * spacing) / 3, max(room.y, imgui.get_font_size() * 6))
    over = "seconds" if training.by_seconds else "iteration"
    loss(training, over, size)
    imgui.same_line()
    score(training, over, size)
    imgui.same_line()
    count(training, over, size)


def begin(
    title: str, over: str, size: tuple[float, float], points: int, *, logarithmic: bool = False
) -> bool:
    """Opens a plot that follows its data, empty up to two points; true where it is to be filled."""
    flags = implot.Flags_.no_legend | implot.Flags_.no_menus | implot.Flags_.no_box_select
    if not implot.begin_plot(title, size, flags):
        return False
    if points < 2:
        bare = implot.AxisFlags_.no_decorations
        implot.setup_axes("", "", bare, bare)
        return True
    fit = implot.AxisFlags_.auto_fit | implot.AxisFlags_.no_label
    implot.setup_axes(over, "", fit, fit)
    if logarithmic:
        implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.log10)
    return True


def loss(training: LiveTraining, over: str, size: tuple[float, float]) -> None:
    x, values = training.thread.history.read(over, "loss")
    good = np.isfinite(values) & (values > 0)
    x, values = x[good], values[good]
    if begin("Loss", over, size, len(x), logarithmic=True):
        if len(x) > 1:
            faint = implot.Spec(line_color=ImVec4(LOSS.x, LOSS.y, LOSS.z, 0.3))
            implot.plot_line("loss", x, values, faint)
            implot.plot_line("smoothed", x, smoothed(values), implot.Spec(line_color=LOSS, line_weight=2.0))
        implot.end_plot()


def score(training: LiveTraining, over: str, size: tuple[float, float]) -> None:
    x, values = training.thread.evaluations.read(over, "psnr")
    good = np.isfinite(values)
    x, values = x[good], values[good]
    title = f"Held-out PSNR, dB{f': {values[-1]:.2f}' if len(values) else ''}###psnr"
    if begin(title, over, size, len(x)):
        if len(x) > 1:
            marked = implot.Spec(
                line_color=SCORE,
                line_weight=2.0,
                marker=int(implot.Marker_.circle),
                marker_size=3,
                marker_fill_color=SCORE,
                marker_line_color=SCORE,
            )
            implot.plot_line("psnr", x, values, marked)
        implot.end_plot()


def count(training: LiveTraining, over: str, size: tuple[float, float]) -> None:
    x, values = training.thread.history.read(over, "gaussians")
    if begin("Splats", over, size, len(x)):
        if len(x) > 1:
            implot.plot_line("splats", x, values, implot.Spec(line_color=COUNT, line_weight=2.0))
        implot.end_plot()


def smoothed(values: np.ndarray) -> np.ndarray:
    """Means over SMOOTHED-ths of the curve, each ending at its point: (N,) float64."""
    width = max(len(values) // SMOOTHED, 1)
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - width, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)
