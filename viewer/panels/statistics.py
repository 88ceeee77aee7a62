"""The Statistics and Messages panels."""

from __future__ import annotations

import time

import numpy as np
from imgui_bundle import imgui, implot

from splatview.viewer import theme
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState

STAGES = {
    "project": "Projecting splats to the screen, culling them, colours.",
    "sort": "Putting the visible splats in order of depth.",
    "bin": "Sharing splats out among tiles of the picture.",
    "draw": "Blending the splats into the picture.",
    "forward": "Blending the splats into the picture.",
}


def show(app: AppState) -> None:
    picture = app.picture
    stats = app.stats
    widgets.fact("Renderer", picture.name, "What computes the picture.")
    widgets.fact("Runs on", app.gpu_name, "As the OpenGL driver names it.")
    width, height = app.picture_size
    scale = app.preferences.resolution_scale
    widgets.fact("Picture", f"{round(width * scale)} x {round(height * scale)} px", "What is rendered.")
    widgets.fact(
        "Moving",
        picture.note or "in full",
        "What the picture leaves out so that it turns smoothly, and its error; at rest it leaves nothing "
        "out.",
    )
    widgets.fact("Splats", f"{stats.splats:,}", "In the scene.")
    share = f" ({stats.visible / stats.splats:.0%})" if stats.splats else ""
    widgets.fact("Visible", f"{stats.visible:,}{share}", "Left after culling, a frame or two ago.")
    if app.process_mib is not None:
        widgets.fact("Memory", f"{app.process_mib:,.0f} MiB", "Of this program, the scene included.")
    widgets.section("Time of a drawn frame")
    total = sum(stats.ms.values())
    widgets.fact(
        "All",
        f"{total:.2f} ms",
        "Sum of the stages, measured where they run; nothing is drawn while nothing changes.",
    )
    history(app)
    for stage, milliseconds in stats.ms.items():
        widgets.fact(stage.capitalize(), f"{milliseconds:.2f} ms", STAGES.get(stage, ""))


def history(app: AppState) -> None:
    """The latest drawn frames, all stages together, oldest on the left."""
    times = np.array([sum(frame.values()) for frame in app.frame_history])
    if len(times) < 2 or not np.isfinite(times).all():
        return
    flags = implot.Flags_.canvas_only | implot.Flags_.no_inputs
    size = (-1, imgui.get_font_size() * 5)
    if implot.begin_plot("##history", size, flags):
        axis = implot.AxisFlags_
        implot.setup_axes("", "", axis.no_decorations, axis.no_grid_lines | axis.no_tick_marks)
        implot.setup_axes_limits(0, len(times) - 1, 0, max(times.max() * 1.15, 1e-3), imgui.Cond_.always)
        implot.plot_line("ms", times)
        implot.end_plot()
    widgets.tooltip(f"Milliseconds of the last {len(times)} drawn frames")


def show_messages(app: AppState) -> None:
    """All messages, the newest at the bottom."""
    if not app.messages:
        widgets.note("Nothing to report.")
        return
    follow = imgui.get_scroll_y() >= imgui.get_scroll_max_y() - 1
    for message in app.messages:
        clock = time.strftime("%H:%M:%S", time.localtime(message.at))
        imgui.text_colored(theme.QUIET, clock)
        imgui.same_line()
        imgui.push_text_wrap_pos(0)
        if message.error:
            imgui.text_colored(theme.ERROR, message.text)
        else:
            imgui.text_unformatted(message.text)
        imgui.pop_text_wrap_pos()
        if imgui.is_item_clicked(imgui.MouseButton_.right):
            imgui.set_clipboard_text(message.text)
        widgets.tooltip("Right click copies the line")
    if follow:
        imgui.set_scroll_here_y(1.0)
