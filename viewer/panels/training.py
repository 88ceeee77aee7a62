"""The Training and Curves panels: state, buttons, numbers, share of the cores, loss and PSNR so far."""

from __future__ import annotations

import os
from functools import partial

import numpy as np
from imgui_bundle import ImVec2, ImVec4, imgui, implot
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.scene.formats import place_beside
from splatview.trainer.background import Status, pace_of
from splatview.viewer import theme
from splatview.viewer.commands import keys_of
from splatview.viewer.panels import photos, recipe, train_form, widgets
from splatview.viewer.preferences import RANGES, TrainingUpdates
from splatview.viewer.state import AppState
from splatview.viewer.training import live as actions
from splatview.viewer.training.live import LiveTraining, viewer_threads

SMOOTHED = 60
"""The bright line of the loss is a mean over this share of the curve: photos differ, so steps jump."""

MARGIN = 0.05
"""Of the height of a curve, above and below it: a mark on the edge would be cut in half."""

LOSS = ImVec4(0.93, 0.62, 0.33, 1)
SCORE = ImVec4(0.45, 0.80, 0.50, 1)
COUNT = ImVec4(*theme.ACCENT, 1)

RUNNING = ImVec4(0.45, 0.80, 0.50, 1)

STATES = {
    "training": (icons.ICON_FA_PLAY, "Training", RUNNING),
    "paused": (icons.ICON_FA_PAUSE, "Paused", theme.WARNING),
    "done": (icons.ICON_FA_CIRCLE_CHECK, "Done", ImVec4(*theme.ACCENT, 1)),
    "failed": (icons.ICON_FA_TRIANGLE_EXCLAMATION, "Failed", theme.ERROR),
}

UPDATES: dict[TrainingUpdates, str] = {"off": "Off", "low": "Low", "live": "Live"}


def show(app: AppState) -> None:
    """The Train page."""
    training = app.find(LiveTraining)
    if training is None:
        train_form.on_page(app)
        return
    status = training.status
    headline(status)
    buttons(app, status)
    if status.failure is not None:
        widgets.note(status.failure, theme.ERROR)
        widgets.note("The scene is kept as it was: export it, or try to go on.")
    if not training.followed_by(app):
        widgets.note("The view shows something else now; training goes on.", theme.WARNING)
        widgets.button(
            "Show the training", "Back to the scene in training.", partial(app.post, actions.show_training)
        )
    imgui.spacing()
    numbers(training, status)
    widgets.section("This machine")
    shares(app, training)
    widgets.section("Keep")
    keep(app, training, status)
    if widgets.fold(app, "Recipe"):
        recipe.show(app, training)
    if widgets.fold(app, "Photos"):
        photos.show(app, training)
    if status.state != "training":
        widgets.command_button(app, "Train on other photos...", "train_photos")


def headline(status: Status) -> None:
    """The state in colour, what is being done, and how far the run is."""
    icon, name, colour = STATES[status.state]
    imgui.text_colored(colour, f"{icon}  {name}")
    if status.activity:
        imgui.same_line()
        imgui.text_colored(theme.QUIET, f"{status.activity}...")
    left = "" if status.state != "training" else time_left(status)
    imgui.same_line(
        imgui.get_content_region_avail().x - imgui.calc_text_size(left).x + imgui.get_style().window_padding.x
    )
    imgui.text_colored(theme.QUIET, left)
    goal = status.settings.iterations
    # Where minutes end the run, its steps are a guess that the share does not follow.
    counted = goal and abs(status.progress - status.iteration / goal) < 0.01
    text = f"{status.iteration:,} of {goal:,} steps" if counted else f"{status.iteration:,} steps"
    if status.scene > 1:
        text = f"scene {status.scene}, {text}"
    imgui.push_style_color(imgui.Col_.plot_histogram, ImVec4(colour.x, colour.y, colour.z, 0.55))
    imgui.progress_bar(status.progress, (-1, imgui.get_font_size() * 1.5), f"{text}   {status.progress:.0%}")
    imgui.pop_style_color()


def time_left(status: Status) -> str:
    left = status.seconds_left
    return "" if left is None else f"{duration(left)} left"


def duration(seconds: float) -> str:
    """As people say it: 45 s, 12 min 5 s, 2 h 3 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"


def buttons(app: AppState, status: Status) -> None:
    """Three large ones, the first twice as wide."""
    style = imgui.get_style()
    imgui.push_style_var(imgui.StyleVar_.frame_padding, (style.frame_padding.x, imgui.get_font_size() * 0.5))
    room = imgui.get_content_region_avail().x - 2 * style.item_spacing.x
    runs = status.state == "training"
    name = f"{icons.ICON_FA_PAUSE}  Pause" if runs else f"{icons.ICON_FA_PLAY}  Resume"
    r, g, b = theme.ACCENT
    imgui.begin_disabled(status.progress >= 1)
    for column, strength in (
        (imgui.Col_.button, 0.55),
        (imgui.Col_.button_hovered, 0.7),
        (imgui.Col_.button_active, 0.8),
    ):
        imgui.push_style_color(column, ImVec4(r * strength, g * strength, b * strength, 1))
    key = keys_of("pause_training")
    tip = (
        f"Stands still between two steps; pauses count against no budget ({key})"
        if runs
        else f"Goes on ({key})"
    )
    widgets.button(f"{name}###pause", tip, partial(app.post, actions.pause_or_resume), width=room * 0.42)
    imgui.pop_style_color(3)
    imgui.same_line()
    widgets.button(
        f"{icons.ICON_FA_FORWARD_STEP}  Step###step",
        f"One step, then a pause ({keys_of('step_training')})",
        partial(app.post, actions.step_once),
        width=room * 0.25,
    )
    imgui.end_disabled()
    imgui.same_line()
    widgets.button(
        f"{icons.ICON_FA_STOP}  Stop, save###stop",
        "Pauses and writes scene and checkpoint; it can be resumed all the same.",
        partial(app.post, actions.stop_and_save),
        width=room * 0.33,
    )
    imgui.pop_style_var()


def numbers(training: LiveTraining, status: Status) -> None:
    """As many rows at every moment: a row that comes and goes takes what is below from under the mouse."""
    limit = status.settings.max_splats
    widgets.fact("Splats", f"{status.gaussians:,} of max {limit:,}", "Gaussians in the scene now.")
    rate = f"{status.rate:.1f}" if status.rate < 100 else f"{status.rate:.0f}"
    widgets.fact("Iterations/s", rate if status.rate > 0 else "-", "Over the last seconds, sleep included.")
    widgets.fact("Trained for", duration(status.seconds), "Pauses left out.")
    loss = f"{status.loss:.4f}" if status.loss == status.loss else "-"
    widgets.fact("Loss", loss, "0.8 L1 + 0.2 (1 - SSIM) of the last step's photos.")
    evaluation = status.evaluation
    score, tip = "-", "The photos not trained on were not compared yet."
    if evaluation is not None:
        score = f"{evaluation.psnr:.2f} dB, SSIM {evaluation.ssim:.4f}"
        tip = f"Mean over {len(evaluation.scores)} photos not trained on, at step {status.evaluated_at:,}."
    widgets.fact("Held out", score, tip)
    shown = "-" if training.shown is None else f"step {training.shown.iteration:,}"
    widgets.fact("Shown", shown, "The snapshot that the view shows.")


def shares(app: AppState, training: LiveTraining) -> None:
    preferences, cores = app.preferences, training.thread.cores
    low, high = RANGES["training_share"]
    wanted = preferences.training_share
    tip = (
        f"Of the {cores} cores, what training takes while you move the view; the viewer has the rest "
        f"({viewer_threads(wanted, cores)} to draw with)."
    )
    share = widgets.slider("Share of cores", 100 * wanted, 100 * low, 100 * high, tip, form="%.0f %%")
    if share is not None:
        app.prefer(training_share=min(max(share / 100, low), high))
    idle = widgets.checkbox(
        "All when idle",
        preferences.training_takes_idle_cores,
        "Training takes every core while nobody moves the view.",
    )
    if idle is not None:
        app.prefer(training_takes_idle_cores=idle)
    updates = widgets.combo(
        "Show progress",
        preferences.training_updates,
        tuple(UPDATES),
        "How often the growing scene is shown: up to ten times a second (live), every two seconds (low), "
        "or when training pauses (off).",
        tuple(UPDATES.values()),
    )
    if updates is not None:
        app.prefer(training_updates=updates)
    if preferences.training_updates == "off":
        widgets.button(
            "Show it now", "The scene as it is after this step.", partial(app.post, actions.show_now)
        )
    pace = pace_of(training.thread.share, cores)
    now = f"{pace.threads} of {cores} cores" + ("" if pace.duty > 0.999 else f", {pace.duty:.0%} of the time")
    if training.status.state != "training":
        now = "nothing"
    widgets.fact("Training takes", now, "At this moment.")


def keep(app: AppState, training: LiveTraining, status: Status) -> None:
    widgets.button(
        f"{icons.ICON_FA_FILE_EXPORT}  Export .ply...###export",
        "Writes the scene as it stands, for any viewer.",
        partial(app.post, actions.export),
    )
    imgui.same_line()
    widgets.button(
        f"{icons.ICON_FA_FLOPPY_DISK}  Checkpoint###checkpoint",
        f"Writes {training.thread.outputs.checkpoint}, from which --resume goes on bit for bit; so does "
        "every minute.",
        partial(app.post, actions.save_checkpoint),
    )
    outputs = training.thread.outputs
    at = status.saved_at
    when = "is saved when the window closes" if at is None else f"was last saved at step {at:,}"
    widgets.note(f"{place_beside(outputs.scene).name} {when}.")
    widgets.tooltip(os.path.realpath(outputs.scene))


def show_curves(app: AppState) -> None:
    """Loss, PSNR of the held-out photos, and number of splats, over steps or seconds."""
    training = app.feature(LiveTraining)
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
    loss_curve(training, over, size)
    imgui.same_line()
    score_curve(training, over, size)
    imgui.same_line()
    count_curve(training, over, size)


def begin_curve(
    title: str,
    over: str,
    size: tuple[float, float],
    x: np.ndarray,
    values: np.ndarray,
    *,
    logarithmic: bool = False,
) -> bool:
    """Opens a plot as large as its data, `values` (N,) over `x` (N,), empty up to two points; true where it
    is to be filled."""
    flags = implot.Flags_.no_legend | implot.Flags_.no_menus | implot.Flags_.no_box_select
    if not implot.begin_plot(title, size, flags):
        return False
    if len(x) < 2:
        bare = implot.AxisFlags_.no_decorations
        implot.setup_axes("", "", bare, bare)
        return True
    implot.setup_axes(over, "", implot.AxisFlags_.no_label, implot.AxisFlags_.no_label)
    if logarithmic:
        implot.setup_axis_scale(implot.ImAxis_.y1, implot.Scale_.log10)
    # ImPlot fits its axes by the frame before, and a window at rest draws none after the last point.
    implot.setup_axis_limits(implot.ImAxis_.x1, *limits(x), implot.Cond_.always)
    room = 0.0 if logarithmic else MARGIN
    implot.setup_axis_limits(implot.ImAxis_.y1, *limits(values, room), implot.Cond_.always)
    # Half of the last number stands beyond the axis.
    padding = implot.get_style().plot_padding
    implot.push_style_var(implot.StyleVar_.plot_padding, ImVec2(1.3 * imgui.get_font_size(), padding.y))
    implot.setup_finish()
    implot.pop_style_var()
    return True


def limits(values: np.ndarray, margin: float = 0.0) -> tuple[float, float]:
    """Between which an axis shows these, (N,) with N > 0: with so much of their range on both sides, and
    something where they are all alike, as no axis is without length."""
    least, most = float(values.min()), float(values.max())
    around = margin * (most - least) if least < most else 0.1 * abs(most) or 1.0
    return least - around, most + around


def loss_curve(training: LiveTraining, over: str, size: tuple[float, float]) -> None:
    x, values = training.thread.history.read(over, "loss")
    good = np.isfinite(values) & (values > 0)
    x, values = x[good], values[good]
    if begin_curve("Loss", over, size, x, values, logarithmic=True):
        if len(x) > 1:
            faint = implot.Spec(line_color=ImVec4(LOSS.x, LOSS.y, LOSS.z, 0.3))
            implot.plot_line("loss", x, values, faint)
            implot.plot_line("smoothed", x, smoothed(values), implot.Spec(line_color=LOSS, line_weight=2.0))
        implot.end_plot()


def score_curve(training: LiveTraining, over: str, size: tuple[float, float]) -> None:
    x, values = training.thread.evaluations.read(over, "psnr")
    good = np.isfinite(values)
    x, values = x[good], values[good]
    title = f"Held-out PSNR, dB{f': {values[-1]:.2f}' if len(values) else ''}###psnr"
    if begin_curve(title, over, size, x, values):
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


def count_curve(training: LiveTraining, over: str, size: tuple[float, float]) -> None:
    x, values = training.thread.history.read(over, "gaussians")
    if begin_curve("Splats", over, size, x, values):
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
