"""Keys, menus, buttons and notes of a window with an open scene; run by `conftest.drive` like the functions
of `drives`."""

from __future__ import annotations

import sys
from typing import Any

import drives
from drives import Hand
from editing_drives import counts, settle
from imgui_bundle import imgui

from splatview.viewer.editing.session import EditSession, session_of
from splatview.viewer.state import AppState


def all_hands(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """One part after another, each by itself: what a part finds is under its name."""
    settle(hand)
    app.prefer(smooth=False)
    session = session_of(app)
    assert session is not None
    for part in (menus_and_keys,):
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


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
