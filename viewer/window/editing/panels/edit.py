"""The Edit panel: tools on top, one section for each kind of change."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from imgui_bundle import ImVec4, imgui

from ... import theme
from ...panels import widgets
from ...training import rules
from ..desk import Desk
from ..tool_names import ToolName
from . import clean, crops, look, move, select

if TYPE_CHECKING:
    from ...core import Core

SECTIONS: tuple[tuple[str, bool, Callable[[Core, Desk], None]], ...] = (
    ("Select", True, select.show),
    ("Clean up", False, clean.show),
    ("Crop", False, crops.show),
    ("Move", False, move.show),
    ("Look", False, look.show),
)
"""Title, whether it is open at first, contents."""

IN_TRAINING = (select.show, clean.show, crops.show)
"""Contents of the sections whose changes a trainer can be told of."""

RULES = "Rules of the training"

TOOLS: tuple[tuple[str, ToolName], ...] = (
    ("Rectangle", "rectangle"),
    ("Brush", "brush"),
    ("Lasso", "lasso"),
    ("Polygon", "polygon"),
    ("Wand", "flood"),
    ("Colour", "colour"),
    ("Measure", "measure"),
)


def show(core: Core) -> None:
    desk = core.desk
    if not core.can_edit:
        widgets.note("Open a scene to edit it.")
        return
    toolbar(core, desk)
    training = None if core.at_rest else core.training
    if training is not None:
        rules.show(core, training)
    if desk is not None:
        job(core, desk)
        for title, opened, contents in SECTIONS:
            if training is not None and contents not in IN_TRAINING:
                continue
            flags = imgui.TreeNodeFlags_.default_open if opened else 0
            if desk.forms.open_section == title:
                imgui.set_next_item_open(True)
                desk.forms.open_section = ""
            if imgui.collapsing_header(title, flags):
                imgui.push_id(title)
                contents(core, desk)
                imgui.pop_id()
    if training is not None and imgui.collapsing_header(RULES, imgui.TreeNodeFlags_.default_open):
        imgui.push_id(RULES)
        rules.in_force(core, training)
        imgui.pop_id()


def toolbar(core: Core, desk: Desk | None) -> None:
    """A button a tool; the one in hand is bright."""
    for number, (name, tool) in enumerate(TOOLS):
        if number:
            widgets.beside(name)
        chosen = desk is not None and desk.tool == tool
        if chosen:
            imgui.push_style_color(imgui.Col_.button, ImVec4(*theme.ACCENT, 0.75))
        widgets.action_button(core, name, f"tool_{tool}")
        if chosen:
            imgui.pop_style_color()
    if desk is not None and desk.tool != "none":
        widgets.note("Shift adds, Ctrl removes, both keep what is common. Alt + drag turns. Esc: done.")


def job(core: Core, desk: Desk) -> None:
    """Slow work under way, with a way to stop it."""
    if desk.job is None:
        return
    imgui.progress_bar(desk.job.progress, (-imgui.get_font_size() * 5, 0), desk.job.title)
    imgui.same_line()
    widgets.action_button(core, "Cancel", "cancel")
