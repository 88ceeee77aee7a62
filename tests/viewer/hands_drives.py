"""Keys, menus, buttons and notes of a window with an open scene; run by `conftest.drive` like the functions
of `drives`."""

from __future__ import annotations

import os
import sys
import threading
from dataclasses import replace
from typing import Any

import drives
from drives import Hand
from editing_drives import counts, open_section, settle
from imgui_bundle import ImVec2, imgui

from splatview.renderers.request import FrameRequest
from splatview.scene.edits import PREVIEW
from splatview.viewer.commands import COMMANDS
from splatview.viewer.editing.session import EditSession, session_of
from splatview.viewer.state import AppState
from splatview.viewer.status_bar import TOOL_HINTS, hint

SHOTS = os.environ.get("SPLATVIEW_SHOTS")
"""Folder for pictures of the window, to be looked at."""


def shoot(hand: Hand, name: str) -> None:
    hand.shoot(f"{SHOTS}/{name}.png" if SHOTS else None)


def all_hands(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """One part after another, each by itself: what a part finds is under its name."""
    settle(hand)
    app.prefer(smooth=False)
    session = session_of(app)
    assert session is not None
    for part in (menus_and_keys, buttons, tools_and_jobs, sliders, grading, sections, layout_reset):
        part(app, session, hand, found.setdefault(part.__name__, {}))


def menus_and_keys(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """With a menu open, Escape closes it and no more; another key closes it and does its work."""

    def is_menu_open() -> bool:
        return imgui.is_popup_open("", imgui.PopupFlags_.any_popup)

    def open_menu() -> None:
        hand.ctx.item_click("//##MainMenuBar/##MenuBar/Edit")
        hand.frames(2)

    hand.press("R")
    open_menu()
    found["opened"] = hand.on_gl_thread(is_menu_open)
    hand.press("Escape")
    found["after_escape"] = [hand.on_gl_thread(is_menu_open), session.tool]
    open_menu()
    hand.press("Ctrl+A")
    settle(hand)
    found["after_key"] = [hand.on_gl_thread(is_menu_open), counts(app)["selected"]]
    hand.press("Escape")
    found["tool"] = session.tool


def buttons(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Buttons of the Select section with nothing selected, and with something."""
    names = ("All", "None", "Grow", "Delete", "Hide", "Isolate", "Lock")

    def disabled() -> list[str]:
        hand.frames(3)
        items = {name: hand.ctx.item_info(f"Select/{name}") for name in names}
        return [name for name, item in items.items() if item.item_flags & imgui.ItemFlags_.disabled]

    open_section(hand, "Select")
    hand.press("Ctrl+Shift+A")
    settle(hand)
    found["nothing"] = disabled()
    if SHOTS:
        hand.ctx.mouse_move("Select/Delete")
        hand.frames(40)
    shoot(hand, "disabled")
    hand.press("Ctrl+A")
    settle(hand)
    found["everything"] = disabled()


def tools_and_jobs(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """What the status bar says of each tool; where a button is with a tool in hand and while a job runs."""

    def place() -> float:
        hand.frames(3)
        return hand.ctx.item_info("Select/Delete").rect_full.min.y

    open_section(hand, "Select")
    places = [place()]
    found["hints"] = {"none": hint(app)}
    sizes = [app.picture_size]
    for tool in TOOL_HINTS:
        hand.on_gl_thread(lambda tool=tool: session.take_tool(tool))
        places.append(place())
        sizes.append(app.picture_size)
        found["hints"][tool] = hint(app)
    found["sizes"] = sizes
    shoot(hand, "tool")
    hand.press("Escape")
    go_on = threading.Event()
    hand.on_gl_thread(lambda: session.start("Waiting", lambda _: go_on.wait(200), lambda _: None))
    places.append(place())
    shoot(hand, "job")
    go_on.set()
    settle(hand)
    found["places"] = [*places, place()]


def sliders(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """A slider is dragged to its end, and its value typed beside it."""
    open_section(hand, "Select")
    slider = hand.ctx.item_info("Select/##Tolerance").rect_full
    value = hand.ctx.item_info("Select/##Tolerance value").rect_full
    found["apart"] = value.min.x >= slider.max.x and value.min.y < slider.max.y
    hand.ctx.mouse_move("Select/##Tolerance")
    hand.ctx.mouse_drag_with_delta(ImVec2(20, 0), 0)
    found["dragged"] = session.tolerance
    hand.ctx.item_input_value("Select/##Tolerance value", 0.1234)
    found["typed"] = session.tolerance
    hand.ctx.item_input_value("Select/##Tolerance", 0.25)
    found["typed_on_it"] = session.tolerance
    shoot(hand, "sliders")


def grading(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """What is selected is seen in the colours that it is given, until they are applied."""

    def colourfulness() -> float:
        settle(hand)
        assert app.picture is not None
        picture, shown = app.picture, FrameRequest(None, app.camera, app.settings, edits=app.edits)
        image = hand.on_gl_thread(lambda: picture.read(replace(shown, highlight=app.highlight)))[..., :3]
        return float((image.max(axis=-1) - image.min(axis=-1)).max())

    open_section(hand, "Colour & opacity")
    hand.press("Ctrl+A")
    found["before"] = colourfulness()
    hand.ctx.item_input_value("Colour & opacity/##Saturation", 0.0)
    found["preview"] = colourfulness()
    shoot(hand, "grey")
    hand.ctx.item_click("Colour & opacity/Apply##look")
    found["after"] = colourfulness()
    hand.press("Ctrl+Z")
    settle(hand)


def layout_reset(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """A wider inspector, another page, the strip; then only the picture, then all as in a new window."""

    def arranged() -> list[Any]:
        hand.frames(4)
        em = imgui.get_font_size()
        return [app.page, app.strip, app.panels_hidden, round(app.preferences.inspector_width * em)]

    def click(entry: str) -> None:
        hand.ctx.set_ref("##MainMenuBar")
        hand.ctx.menu_click(entry)

    click("Window/Reset layout")
    found["new"] = arranged()
    hand.page("View")
    hand.strip("History")
    hand.ctx.mouse_move("//##inspector edge/##drag")
    hand.ctx.mouse_drag_with_delta(ImVec2(-80, 0), 0)
    found["changed"] = arranged()
    shoot(hand, "layout")
    hand.ctx.item_click("//##rail/View")
    found["shut"] = arranged()
    hand.press("H")
    found["hidden"] = arranged()
    click("Window/Reset layout")
    found["back"] = arranged()


def sections(app: AppState, session: EditSession, hand: Hand, found: dict[str, Any]) -> None:
    """Highlight and handles are seen with their tools and sections only; what a detector has found is
    selected."""

    def seen() -> tuple[bool, str]:
        hand.frames(3)
        return bool(session.edits.flags & PREVIEW), session.handles

    hand.press("Ctrl+A")
    settle(hand)
    hand.page("View")
    hand.press("Shift+1")
    found["moving"] = seen()
    hand.press("Escape")
    found["put_back"] = seen()
    hand.on_gl_thread(lambda: COMMANDS["add_box"].run(app))
    settle(hand)
    found["crop"] = seen()
    found["page"] = app.page
    hand.page("Edit")
    hand.ctx.item_close("Crop")
    found["shut"] = seen()
    hand.page("Scene")
    hand.press("Shift+4")
    found["crop_tool"] = [*seen(), len(session.document.crops)]
    hand.press("Shift+5")
    settle(hand)
    found["sphere_tool"] = [*seen(), len(session.document.crops)]
    hand.press("Escape")
    hand.press("Ctrl+Z")
    hand.press("Ctrl+Z")

    hand.page("View")
    hand.on_gl_thread(lambda: COMMANDS["find_faint"].run(app))
    settle(hand)
    found["looking"] = seen()
    hand.page("Edit")
    hand.ctx.item_close("Clean up")
    found["looked"] = seen()
    hand.ctx.item_open("Clean up")
    found["looking_again"] = seen()
    found["detected"] = session.forms.clean.count
    shoot(hand, "clean")
    hand.ctx.item_click(f"Clean up/Select {session.forms.clean.count:,}")
    settle(hand)
    found["selected"] = counts(app)["selected"]
    found["titles"] = [step.title for step in session.document.history.done]
    hand.ctx.item_close("Clean up")


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
