"""The steps so far: undo, redo, and any of them on a click."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from imgui_bundle import ImVec2, imgui

from ... import theme
from ...panels import widgets
from ...training.held import NO_WAY_BACK
from .. import commands

if TYPE_CHECKING:
    from ...core import Core


def show(core: Core) -> None:
    desk = core.desk
    if desk is None:
        widgets.note("Nothing is held: take a tool first." if core.can_edit else "Nothing is open.")
        return
    history = desk.document.history
    if desk.trainee is not None:
        widgets.note(f"Choosing can be undone while the view waits. {NO_WAY_BACK}; rules can be removed.")
    imgui.begin_disabled(not history.can_undo)
    widgets.action_button(core, "Undo", "undo")
    imgui.end_disabled()
    imgui.same_line()
    imgui.begin_disabled(not history.can_redo)
    widgets.action_button(core, "Redo", "redo")
    imgui.end_disabled()
    number = "1 step" if len(history.steps) == 1 else f"{len(history.steps):,} steps"
    used = f"{number}, {memory(history.nbytes)}"
    widgets.beside(used)
    imgui.text_colored(theme.QUIET, used)
    widgets.tooltip("Steps keep runs of splat numbers, not copies of the scene.")
    if core.at_rest:
        for number, (name, action) in enumerate(
            (
                ("Export...", "export"),
                ("Save recipe...", "save_recipe"),
                ("Replay recipe...", "replay_recipe"),
            )
        ):
            if number:
                widgets.beside(name)
            widgets.action_button(core, name, action)
    imgui.begin_child("##steps", ImVec2(0, 0))
    steps = ["As opened", *(step.title for step in history.steps)]
    for position, title in enumerate(steps):
        waiting = position > history.position
        if waiting:
            imgui.push_style_color(imgui.Col_.text, theme.QUIET)
        clicked, _ = imgui.selectable(f"{title}##{position}", position == history.position)
        if waiting:
            imgui.pop_style_color()
        if clicked:
            core.post(partial(commands.jump, position=position))
    if desk.seen_position != history.position:
        desk.seen_position = history.position
        imgui.set_scroll_here_y(1.0) if history.position == len(history.steps) else None
    imgui.end_child()


def memory(size: int) -> str:
    """Bytes in words."""
    return f"{size / 1024:.0f} KiB" if size < 1 << 20 else f"{size / (1 << 20):.1f} MiB"
