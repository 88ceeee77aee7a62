"""The part of the Edit panel that is about training: whether the view waits, and the rules in force."""

from __future__ import annotations

from functools import partial

from imgui_bundle import icons_fontawesome_6 as icons
from imgui_bundle import imgui

from ....scene.crop import Crop
from .. import theme
from ..core import Core
from ..panels import widgets
from . import held
from .watching import Training

WHICH = (
    "Delete, clean-up and crops act on the training. Hiding and locking only help to choose. Everything else "
    "(moving, colours, merging, recipes) is for scenes at rest."
)


def waiting_note(core: Core) -> str:
    """Why the view does not follow the training; "" where it does."""
    desk = core.desk
    if desk is None or desk.trainee is None or not held.engaged(desk):
        return ""
    step = f"{desk.trainee.snapshot.iteration:,}"
    goes_on = core.training is not None and core.training.status.state == "training"
    begin = "Training goes on; the view" if goes_on else "The view"
    counts = desk.document.counts
    why = (
        "while splats are selected"
        if counts.selected
        else f"while a tool is in hand ({desk.tool})"
        if desk.tool != "none"
        else "while crops are being set"
        if desk.document.crops
        else "until it is let go"
    )
    return f"{begin} waits at step {step} {why}."


def show(core: Core, training: Training) -> None:
    """On top of the Edit panel."""
    note = waiting_note(core)
    if note:
        widgets.note(note, theme.WARNING)
        widgets.button(
            f"{icons.ICON_FA_PLAY}  Let go###let go",
            "Puts the tool away, selects nothing, and shows the training as it goes on (Esc).",
            partial(core.post, held.let_go),
        )
    else:
        widgets.note("Take a tool to choose splats: the view then waits, and training goes on.")
        widgets.button(
            f"{icons.ICON_FA_PAUSE}  Hold the view###hold",
            "Stays with this moment of the training, for all that the panel can do.",
            partial(core.post, held.keep_waiting),
        )
    imgui.same_line()
    imgui.text_colored(theme.QUIET, icons.ICON_FA_CIRCLE_QUESTION)
    widgets.tooltip(f"{WHICH} {held.NO_WAY_BACK}; rules can be removed below.")


def in_force(core: Core, training: Training) -> None:
    """The list of rules, each with a way out. The one under the mouse is drawn on the picture."""
    settings = training.status.settings
    training.pointed = ()
    if not settings.cut and not settings.no_growth:
        widgets.note("None yet: add a crop and let it cut, or let nothing grow in it.")
        return
    for number, crops in enumerate(settings.cut):
        names = ", ".join(f"{crop.shape} {crop.name}" for crop in crops)
        _row(core, training, "cut", number, crops, f"Cut by {names}")
    for number, crop in enumerate(settings.no_growth):
        _row(core, training, "no_growth", number, (crop,), f"No growth in {crop.shape} {crop.name}")
    widgets.note("Checkpoints keep them.")


def _row(
    core: Core, training: Training, kind: held.Rule, number: int, crops: tuple[Crop, ...], text: str
) -> None:
    imgui.push_id(f"{kind} {number}")
    widgets.button(
        f"{icons.ICON_FA_XMARK}###remove",
        "Removes this rule. What it took out comes back only by training.",
        partial(core.post, held.remove_rule, kind, number),
    )
    pointed = imgui.is_item_hovered()
    imgui.same_line()
    imgui.align_text_to_frame_padding()
    imgui.text(text)
    widgets.tooltip("; ".join(described(crop) for crop in crops))
    if pointed or imgui.is_item_hovered():
        training.pointed = crops
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
