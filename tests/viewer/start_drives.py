"""Saving, the file browser, the start screen and the settings as a person uses them; run by `conftest.drive`
like the functions of `drives`."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import drives
from drives import Hand
from imgui_bundle import imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from PIL import ImageGrab

import glfw  # isort: skip  (after imgui_bundle, which says which libglfw that is)

from splatview.viewer import app as window
from splatview.viewer import dialogs as file_dialogs
from splatview.viewer import layout
from splatview.viewer.editing.saving import Saving, has_unsaved_edits
from splatview.viewer.editing.session import session_of
from splatview.viewer.state import AppState

SHOTS = os.environ.get("SPLATVIEW_SHOTS")
"""Folder for pictures of the window, to be looked at."""


def shoot(hand: Hand, name: str) -> None:
    if SHOTS:
        hand.frames(3)
        ImageGrab.grab(xdisplay=os.environ["DISPLAY"]).save(f"{SHOTS}/{name}.png")


def click_cross(hand: Hand) -> None:
    """As the window's own cross does: GLFW sets its flag and calls the callback."""
    handle = glfw_window_hello_imgui()
    unused: Any = lambda *_: None  # noqa: E731
    callback: Any = glfw.set_window_close_callback(handle, unused)
    hand.on_gl_thread(lambda: (glfw.set_window_should_close(handle, True), callback(handle)))
    hand.on_gl_thread(lambda: window.install_close_handler(hand.app))
    hand.frames(3)


def delete_some(hand: Hand) -> None:
    """A few splats more, by a rectangle, each time elsewhere."""
    session = session_of(hand.app)
    assert session is not None
    before = session.document.counts.deleted
    hand.press("R")
    place = 0.35 + 0.07 * len(session.document.history.steps) / 2 % 0.3
    hand.drag(60, 60, over=(place, place))
    hand.wait(lambda: session.document.counts.selected > 0, "a selection")
    hand.press("Delete")
    hand.wait(lambda: session.document.counts.deleted > before, "the deletion")
    hand.press("Escape")


def saves(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Ctrl+S, Ctrl+Shift+S, the dot in the title, the cross with unsaved edits."""
    file_dialogs.has_native_dialogs = lambda: False
    hand.settle()
    saving, titles = app.feature(Saving), found.setdefault("titles", [])
    titles.append(layout.title(app))
    hand.press("Ctrl+A")
    hand.press("Ctrl+Shift+A")
    titles.append(layout.title(app))
    delete_some(hand)
    titles.append(layout.title(app))

    hand.press("Ctrl+S")
    found["asked"] = saving.question
    shoot(hand, "overwrite")
    hand.press("Escape")
    hand.frames(2)
    found["after_escape"] = [saving.question, has_unsaved_edits(app)]
    hand.press("Ctrl+S")
    hand.press("Enter")
    hand.wait(lambda: not has_unsaved_edits(app), "the file")
    titles.append(layout.title(app))
    delete_some(hand)
    hand.press("Ctrl+S")
    found["asked_again"] = saving.question
    hand.wait(lambda: not has_unsaved_edits(app), "the file, again")

    delete_some(hand)
    hand.press("Ctrl+Shift+S")
    hand.frames(4)
    shoot(hand, "save_as")
    hand.ctx.key_chars_replace_enter(options["other"])
    hand.wait(lambda: app.scene.name == Path(options["other"]).name, "the other name")
    titles.append(layout.title(app))
    delete_some(hand)
    hand.press("Ctrl+Shift+S")
    hand.frames(4)
    hand.ctx.key_chars_replace_enter(options["rounded"])
    hand.wait(lambda: Path(options["rounded"]).exists(), "the rounded file", 180)
    hand.settle()
    titles.append(layout.title(app))

    hand.drop(options["other"])
    hand.frames(3)
    found["asked_for_drop"] = saving.question
    hand.ctx.item_click("//Unsaved edits/Cancel")
    hand.frames(3)
    click_cross(hand)
    found["asked_at_end"] = saving.question
    shoot(hand, "leave")
    hand.ctx.item_click("//Unsaved edits/Cancel")
    hand.frames(3)
    found["stays"] = not app.quitting
    click_cross(hand)
    hand.ctx.item_click("//Unsaved edits/Don't save")
    hand.wait(lambda: app.quitting, "the end")
    found["deleted"] = session_of(app).document.counts.deleted


def browses(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The browser by keys alone and by mouse: completion, a folder, rows, places, a file to replace."""
    file_dialogs.has_native_dialogs = lambda: False
    hand.settle()
    ctx, folder = hand.ctx, Path(options["folder"])
    name = "//Open a scene"

    def text() -> str:
        browser = found_browser(app)
        return browser.text if browser else ""

    hand.press("Ctrl+O")
    hand.frames(4)
    ctx.key_chars(f"{folder}/ga")
    hand.frames(3)
    ctx.key_press(imgui.Key.tab)
    hand.frames(3)
    found["completed"] = [text()]
    ctx.key_chars("r")
    ctx.key_press(imgui.Key.tab)
    hand.frames(3)
    found["completed"].append(text())
    ctx.key_chars("de")
    hand.frames(6)
    browser = found_browser(app)
    assert browser is not None
    found["listed"] = str(browser._listed)
    found["narrowed"] = rows(app)
    shoot(hand, "browser_typed")
    ctx.key_press(imgui.Key.down_arrow)
    ctx.key_press(imgui.Key.enter)
    hand.wait(lambda: app.is_open and app.scene.name == "deep.ply", "the scene by keys", 10)
    hand.settle()

    hand.press("Ctrl+O")
    hand.frames(4)
    found["starts_in"] = str(found_browser(app).folder)
    ctx.item_click(f"{name}/{found_up(hand)}")
    hand.wait(lambda: bool(rows(app)), "the folder above")
    hand.frames(4)
    found["above"] = rows(app)
    shoot(hand, "browser")
    ctx.item_double_click(f"{name}/**/garden##0")
    hand.wait(lambda: rows(app) == ["deep.ply"], "the folder by mouse")
    hand.frames(3)
    ctx.item_click(f"{name}/**/deep.ply##0")
    hand.frames(2)
    found["clicked"] = text()
    ctx.item_click(f"{name}/**/Recent files")
    hand.frames(4)
    found["recent"] = rows(app)
    shoot(hand, "browser_recent")
    ctx.key_press(imgui.Key.escape)
    hand.frames(3)
    found["closed"] = found_browser(app) is None

    hand.press("Ctrl+O")
    hand.frames(4)
    ctx.key_chars_replace_enter(str(folder / "none.ply"))
    hand.frames(3)
    found["missing"] = found_browser(app).problem
    hand.press("Escape")
    hand.frames(3)

    hand.press("Ctrl+Shift+S")
    hand.frames(4)
    ctx.item_click("//Save the scene/###accept")
    hand.frames(3)
    found["replace"] = found_browser(app).problem
    shoot(hand, "browser_replace")
    ctx.item_click("//Save the scene/###accept")
    hand.wait(lambda: "Saved" in hand.said[-1], "the replaced file")


def found_browser(app: AppState) -> Any:
    return window_of(app).dialogs.browser


def window_of(app: AppState) -> Any:
    """The `Window` whose dialogs `app` asks."""
    ask: Any = app.choose_files
    return type("Window", (), {"dialogs": ask.__self__})


def rows(app: AppState) -> list[str]:
    browser = found_browser(app)
    return [] if browser is None else [entry.name for entry in browser._rows()]


def found_up(hand: Hand) -> str:
    from imgui_bundle import icons_fontawesome_6 as icons

    return icons.ICON_FA_ARROW_UP


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
