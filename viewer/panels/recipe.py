"""The recipe of a training and the rules of its edits: settings to change on the way, and those decided."""

from __future__ import annotations

from functools import partial

from imgui_bundle import ImVec4, imgui
from imgui_bundle import icons_fontawesome_6 as icons

from splatview.scene.edits import Crop
from splatview.scene.errors import bytes_in_words, printable
from splatview.trainer.settings import TrainSettings
from splatview.viewer import theme
from splatview.viewer.editing.session import Editing, session_of
from splatview.viewer.editing.target import NO_WAY_BACK
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState
from splatview.viewer.training import live as actions
from splatview.viewer.training.live import LiveTraining
from splatview.viewer.training.live_edits import Rule, frozen_target, in_use

DEFAULTS = TrainSettings()

STRATEGIES = {"mcmc": "MCMC"}
"""Labels that are not the name with a capital letter."""


def show(app: AppState, training: LiveTraining) -> None:
    status = training.status
    settings = status.settings
    length(app, settings)
    factor = widgets.slider(
        "Position rate",
        settings.means_rate / DEFAULTS.means_rate,
        0.1,
        10.0,
        "How far splats move in a step, times what is usual: more finds far places sooner, less is calmer.",
        form="%.2f x",
        logarithmic=True,
    )
    if factor is not None:
        set_position_rate(app, factor)
    most = widget_count(
        "Max splats",
        settings.max_splats,
        "Density control adds none beyond this: fewer are faster, and learn fewer photos by heart.",
        step=1000,
    )
    if most is not None:
        app.post(lambda app: actions.change_settings(app, max_splats=max(most, 1)))
    choices = [str(degree) for degree in range(status.sh_degree, 4)]
    degree = widgets.combo(
        "SH degree",
        str(max(settings.sh_degree, status.sh_degree)),
        choices,
        f"Bands of view-dependent colour in the end; {status.sh_degree} by now, which stay.",
    )
    if degree is not None:
        app.post(lambda app: actions.change_settings(app, sh_degree=int(degree)))
    imgui.spacing()
    label = STRATEGIES.get(settings.strategy, settings.strategy.capitalize())
    widgets.fact("Strategy", label, "How splats are born and die.")
    widgets.fact("Seed", str(settings.seed), "Of all that is random.")
    first = training.photos[0].camera
    held_out = sum(photo.held_out for photo in training.photos)
    widgets.fact("Photos", f"{len(training.photos) - held_out} + {held_out} held out")
    widgets.fact("First photo", f"{first.width} x {first.height} px", "After downscaling.")
    if training.memory is not None:
        widgets.fact("Memory", f"{bytes_in_words(training.memory.peak)} at most", training.memory.line)
    red, green, blue = settings.background
    widgets.fact("Background", f"{red:.2f}, {green:.2f}, {blue:.2f}", "Behind the scene, RGB.")
    widgets.fact("Loss", f"{1 - settings.ssim_weight:g} L1 + {settings.ssim_weight:g} (1 - SSIM)")
    widgets.section("Effects")
    effects(training)


def effects(training: LiveTraining) -> None:
    """Effects that the run computes, decided from the capture; the evidence is in the tooltips."""
    for effect in training.thread.effects:
        on = effect.in_force
        if effect.name == "SH bands":
            on = training.status.sh_degree > 0
        imgui.text_colored(ImVec4(*theme.ACCENT, 1) if on else theme.QUIET, "on" if on else "off")
        imgui.same_line(imgui.get_font_size() * 2.6)
        imgui.text(effect.name)
        widgets.tooltip(effect.why)


def length(app: AppState, settings: TrainSettings) -> None:
    """The end of the run: moving it changes how fast rates decay from here on."""
    if settings.iterations is not None:
        steps = widget_count(
            "Length, steps",
            settings.iterations,
            "When the run is over; schedules follow, so a longer run decays later, and one that is over "
            "can be resumed.",
            step=1000,
        )
        if steps is not None:
            app.post(lambda app: actions.change_settings(app, iterations=max(steps, 1)))
    if settings.minutes is not None:
        tip = "When the run is over, pauses not counted; all schedules follow."
        widgets.label("Length, minutes", tip)
        changed, minutes = imgui.input_float("##Length, minutes", settings.minutes, 1.0, 10.0, "%.1f")
        widgets.tooltip(tip)
        if changed and minutes > 0:
            app.post(lambda app: actions.change_settings(app, minutes=minutes))


def widget_count(name: str, value: int, tip: str, *, step: int) -> int | None:
    """A row with a whole number to type or step; the new one where the user changed it."""
    widgets.label(name, tip)
    changed, value = imgui.input_int(
        f"##{name}", value, step, 10 * step, imgui.InputTextFlags_.enter_returns_true
    )
    widgets.tooltip(tip)
    return value if changed else None


def set_position_rate(app: AppState, factor: float) -> None:
    """Both ends of the curve of the positions' rate, times what is usual."""
    app.post(
        lambda app: actions.change_settings(
            app, means_rate=factor * DEFAULTS.means_rate, means_rate_end=factor * DEFAULTS.means_rate_end
        )
    )


WHICH = (
    "Delete, clean-up and crops act on the training. Hiding and locking only help to choose. Everything else "
    "(moving, colours, merging, recipes) is for scenes at rest."
)


def waiting_note(app: AppState) -> str:
    """Why the view does not follow the training; "" where it does."""
    session, training = session_of(app), app.find(LiveTraining)
    target = frozen_target(session)
    if session is None or target is None or not in_use(session):
        return ""
    step = f"{target.snapshot.iteration:,}"
    goes_on = training is not None and training.status.state == "training"
    begin = "Training goes on; the view" if goes_on else "The view"
    counts = session.document.counts
    why = (
        "while splats are selected"
        if counts.selected
        else f"while a tool is in hand ({session.tool})"
        if session.tool != "none"
        else "while crops are being set"
        if session.document.crops
        else "until it is released"
    )
    return f"{begin} waits at step {step} {why}."


def show_rules(app: AppState, training: LiveTraining) -> None:
    """On top of the Edit panel."""
    note = waiting_note(app)
    if note:
        widgets.note(note, theme.WARNING)
        widgets.button(
            f"{icons.ICON_FA_PLAY}  Release###let go",
            "Puts the tool away, selects nothing, and shows the training as it goes on (Esc).",
            partial(app.post, training.editor.release),
        )
    else:
        widgets.note("Take a tool to choose splats: the view then waits, and training goes on.")
        widgets.button(
            f"{icons.ICON_FA_PAUSE}  Freeze the view###hold",
            "Stays with this moment of the training, for all that the panel can do.",
            partial(app.post, training.editor.pin),
        )
    imgui.same_line()
    imgui.text_colored(theme.QUIET, icons.ICON_FA_CIRCLE_QUESTION)
    widgets.tooltip(f"{WHICH} {NO_WAY_BACK}; rules can be removed below.")


def in_force(app: AppState, training: LiveTraining) -> None:
    """The list of rules, each with a way out. The one under the mouse is drawn on the picture."""
    settings = training.status.settings
    if not settings.cut and not settings.no_growth:
        widgets.note("None yet: add a crop and let it cut, or let nothing grow in it.")
        return
    for number, crops in enumerate(settings.cut):
        names = ", ".join(f"{crop.shape} {crop.name}" for crop in crops)
        _row(app, training, "cut", number, crops, f"Cut by {names}")
    for number, crop in enumerate(settings.no_growth):
        _row(app, training, "no_growth", number, (crop,), f"No growth in {crop.shape} {crop.name}")
    widgets.note("Checkpoints keep them.")


def _row(
    app: AppState, training: LiveTraining, kind: Rule, number: int, crops: tuple[Crop, ...], text: str
) -> None:
    imgui.push_id(f"{kind} {number}")
    widgets.button(
        f"{icons.ICON_FA_XMARK}###remove",
        "Removes this rule; what it took out comes back only by training.",
        partial(app.post, training.editor.remove_rule, kind, number),
    )
    pointed = imgui.is_item_hovered()
    imgui.same_line()
    imgui.align_text_to_frame_padding()
    imgui.text(printable(text))
    widgets.tooltip("; ".join(described(crop) for crop in crops))
    if pointed or imgui.is_item_hovered():
        app.feature(Editing).outlined = crops
    imgui.pop_id()


def described(crop: Crop) -> str:
    """In words and numbers, for a tooltip."""
    x, y, z = crop.centre
    a, b, c = crop.half_extents
    word = "keeps" if crop.keep == "inside" else "cuts out"
    return (
        f"{crop.name}: {word} the inside of a {crop.shape} at ({x:.3g}, {y:.3g}, {z:.3g}), half size "
        f"({a:.3g}, {b:.3g}, {c:.3g})"
    )
