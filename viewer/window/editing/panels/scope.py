"""What a change is about, and the buttons that put a preview in force or take it back."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imgui_bundle import imgui

from ...panels import widgets
from ..desk import Desk

if TYPE_CHECKING:
    from ...core import Core


def choose_scope(desk: Desk) -> bool:
    """Selection or whole scene; returns whether it changed."""
    chosen = widgets.combo(
        "Of",
        desk.forms.scope,
        ("selection", "scene"),
        "What is changed: the selected splats, or all that are neither deleted nor locked.",
        ("The selection", "The whole scene"),
    )
    if chosen is None:
        return False
    desk.forms.scope = chosen
    return True


def nothing_to_change(desk: Desk) -> bool:
    """Says so where the scope is an empty selection."""
    if desk.forms.scope == "selection" and not desk.document.counts.selected:
        widgets.note("Nothing is selected: select splats, or choose the whole scene above.")
        return True
    return False


def keep_or_cancel(core: Core, desk: Desk, section: str) -> bool | None:
    """The buttons, while this section's preview is in force; True where it was kept, False where not."""
    if desk.forms.previewing != section:
        return None
    kept = imgui.button(f"Apply##{section}")
    widgets.tooltip("Keep the change as a step of the history.")
    imgui.same_line()
    cancelled = imgui.button(f"Cancel##{section}")
    widgets.tooltip("Take the preview back.")
    if kept:
        core.post(lambda core: core.desk.commit_preview() if core.desk else None)
        return True
    if cancelled:
        core.post(lambda core: core.desk.cancel_preview() if core.desk else None)
        return False
    return None
