"""Saving, the file browser, the start screen and the settings as a person uses them; run by `conftest.drive`
like the functions of `drives`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drives
from drives import Hand
from imgui_bundle import ImVec2, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui

import glfw  # isort: skip  (after imgui_bundle, which says which libglfw that is)

from splatview.viewer import app as window
from splatview.viewer import dialogs as file_dialogs
from splatview.viewer import layout
from splatview.viewer.editing.saving import Saving, has_unsaved_edits
from splatview.viewer.editing.session import session_of
from splatview.viewer.panels.settings import THEMES
from splatview.viewer.panels.start_screen import StartScreen
from splatview.viewer.panels.train_form import TrainForm
from splatview.viewer.preferences import Theme
from splatview.viewer.state import AppState
from splatview.viewer.thumbnails import thumbnail_file
from splatview.viewer.training import start
from splatview.viewer.training.live import LiveTraining
from splatview.viewer.training.start import TrainingStart

SHOTS = os.environ.get("SPLATVIEW_SHOTS")
"""Folder for pictures of the window, to be looked at."""


def shoot(hand: Hand, name: str) -> None:
    hand.shoot(f"{SHOTS}/{name}.png" if SHOTS else None)


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
    hand.wait(thumbnail_file(Path(options["other"])).exists, "its picture among the recent scenes")
    titles.append(layout.title(app))
    delete_some(hand)
    hand.press("Ctrl+Shift+S")
    hand.frames(4)
    hand.ctx.key_chars_replace_enter(options["rounded"])
    hand.wait(lambda: Path(options["rounded"]).exists(), "the rounded file")
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
    session = session_of(app)
    assert session is not None
    found["deleted"] = session.document.counts.deleted


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
    hand.wait(lambda: rows(app) == ["gallery", "garden"], "the folder that is typed")
    hand.frames(3)
    ctx.key_press(imgui.Key.tab)
    hand.frames(3)
    found["completed"] = [text()]
    ctx.key_chars("r")
    ctx.key_press(imgui.Key.tab)
    hand.frames(3)
    found["completed"].append(text())
    ctx.key_chars("de")
    hand.wait(lambda: rows(app) == ["deep.ply"], "the folder that is completed")
    hand.frames(3)
    browser = found_browser(app)
    assert browser is not None
    found["listed"] = str(browser._listed)
    found["narrowed"] = rows(app)
    shoot(hand, "browser_typed")
    ctx.key_press(imgui.Key.down_arrow)
    ctx.key_press(imgui.Key.enter)
    hand.wait(lambda: app.is_open and app.scene.name == "deep.ply", "the scene by keys")
    hand.settle()

    hand.press("Ctrl+O")
    hand.frames(4)
    found["starts_in"] = str(found_browser(app).folder)
    ctx.item_click(f"{name}/{found_up(hand)}")
    hand.wait(lambda: bool(rows(app)), "the folder above")
    hand.frames(4)
    found["above"] = rows(app)
    shoot(hand, "browser")
    row = rows(app).index("garden")
    click_row(hand, row, times=2)
    hand.wait(lambda: rows(app) == ["deep.ply"], "the folder by mouse")
    hand.frames(3)
    click_row(hand, 0)
    hand.frames(2)
    found["clicked"] = text()
    click_place(hand, 0)
    hand.wait(lambda: found_browser(app).shows_recent, "the recent files")
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


def starts(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A window without a scene: the start screen, then photos chosen, trained on, and saved at the end."""
    file_dialogs.has_native_dialogs = lambda: False
    hand.settle()
    ctx, state = hand.ctx, app.feature(TrainingStart)
    hand.wait(lambda: not app.feature(StartScreen).thumbnails.busy, "the pictures")
    shoot(hand, "start")
    found["open"] = app.dialog
    found["demo_behind"] = app.scene.name
    hand.press("Escape")
    found["after_escape"] = app.dialog
    ctx.set_ref("##MainMenuBar")
    ctx.menu_click("File/Start screen")
    hand.frames(3)
    found["again"] = app.dialog
    hand.point(0.02, 0.95)
    ctx.mouse_click(0)
    hand.frames(3)
    found["after_click"] = app.dialog

    ctx.menu_click("File/Start screen")
    hand.frames(3)
    click_in(hand, "//Start", 0.19, 0.5)
    hand.wait(lambda: found_browser(app) is not None, "the browser")
    hand.frames(5)
    ctx.key_chars_replace_enter(options["capture"])
    hand.wait(lambda: state.found is not None, "the photos to be found")
    hand.wait(lambda: not app.feature(TrainForm).thumbnails.busy, "the photos' pictures")
    assert state.found is not None
    found["photos"] = len(state.found.photos)
    found["proposed"] = str(state.form.output)
    state.form.length, state.form.output = "1 minute", Path(options["output"])
    free = state.planned_memory()
    ctx.set_ref("//Train on photos")
    ctx.combo_click("##Memory/2 GB")
    hand.frames(3)
    found["memory"] = [state.form.memory, free.bound.asked, state.planned_memory().bound.bytes]
    found["size"] = [state.form.downscale, state.trained_size()]
    width, height = state.found.size
    ctx.combo_click(f"##Size of the photos/Half: {width // 2} x {height // 2} px")
    found["size"] += [state.form.downscale, state.trained_size()]
    ctx.combo_click(f"##Size of the photos/As time allows: {width} x {height} px")
    found["size"] += [state.form.downscale]
    found["masks"] = [state.found.masks, state.form.masks]
    ctx.combo_click("##Masks/Black is empty: an object alone")
    found["masks"] += [state.form.masks]
    ctx.combo_click("##Exposure/Not corrected")
    ctx.combo_click("##Shading/Corrected for each photo")
    ctx.combo_click("##Outliers/Trained on")
    ctx.combo_click("##Passing by/Stays")
    ctx.combo_click("##Sky/Always added")
    found["backgrounds"] = []
    for name in ("Black", "By the photos", "White"):
        ctx.combo_click(f"##Background/{name}")
        hand.frames(3)
        found["backgrounds"].append(state.form.background)
    form = state.form
    chosen = [form.exposure, form.shading, form.outliers, form.passing, form.sky, form.background]
    found["chosen"] = chosen
    shoot(hand, "train_form")
    ctx.item_click("//Train on photos/Start training")
    hand.frames(3)
    shoot(hand, "readying")
    hand.wait(lambda: app.find(LiveTraining) is not None, f"the training {state.problem}")
    training = app.feature(LiveTraining)
    hand.wait(lambda: app.is_open, "the first snapshot")
    hand.wait(lambda: training.status.iteration >= options["steps"], "some steps")
    shoot(hand, "training")
    found["scene"] = app.scene.name
    found["steps"] = training.status.iteration
    assert training.memory is not None
    found["bound"], found["peak"] = training.memory.bound.bytes, training.memory.peak
    found["told"] = any("memory: about" in message.text for message in app.messages)
    settings = training.status.settings
    found["transparent"] = all(photo.shot.alpha is not None for photo in training.photos)
    corrections = [settings.exposure, settings.shading, settings.outliers]
    found["trained"] = [*corrections, settings.most_of_one, settings.sky, settings.background]


def asks_about_captures(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A capture that is dropped, with and without PyTorch; a folder that holds none."""
    hand.settle()
    state = app.feature(TrainingStart)
    hand.drop(options["capture"])
    hand.frames(4)
    found["asked"] = app.dialog
    shoot(hand, "dropped")
    hand.ctx.item_click("//Photos with cameras/Only load its cameras")
    hand.wait(lambda: bool(app.cameras), "the cameras")
    found["cameras"] = len(app.cameras)
    start.find_spec = lambda name: None  # PyTorch is not installed
    hand.drop(options["capture"])
    hand.frames(4)
    shoot(hand, "dropped_without_torch")
    found["lacks"] = state.lacks
    hand.press("Escape")
    found["closed"] = app.dialog
    app.post(start.open_form, Path(options["empty"]))
    hand.wait(lambda: state.problem != "", "the problem")
    hand.frames(3)
    shoot(hand, "no_capture")
    found["problem"] = state.problem
    hand.press("Escape")


def trains_on_dropped(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A capture as somebody's folder has it, dropped, looked at, and trained on."""
    hand.settle()
    state = app.feature(TrainingStart)
    hand.drop(options["capture"])
    hand.frames(4)
    shoot(hand, f"{options['shots']}_dropped")
    hand.ctx.item_click("//Photos with cameras/Train on the photos")
    hand.wait(lambda: state.found is not None, "the photos to be found")
    hand.wait(lambda: not app.feature(TrainForm).thumbnails.busy, "the photos' pictures")
    assert state.found is not None
    found["photos"], found["size"] = len(state.found.photos), state.found.size
    state.form.length, state.form.output = "1 minute", Path(options["output"])
    hand.frames(3)
    shoot(hand, f"{options['shots']}_form")
    hand.ctx.item_click("//Train on photos/Start training")
    hand.wait(lambda: app.find(LiveTraining) is not None, f"the training {state.problem}")
    training = app.feature(LiveTraining)
    hand.wait(lambda: training.status.iteration >= 5, "some steps")
    found["messages"] = [message.text for message in app.messages]
    found["trained"] = [training.photos[0].shot.camera.width, training.photos[0].shot.camera.height]
    shoot(hand, f"{options['shots']}_trained")


def settings(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Themes, font size, keys and mouse of other programs, two fingers: at once, and kept."""
    hand.settle()
    app.prefer(smooth=False)
    session = session_of(app)
    assert session is not None
    hand.press("Ctrl+Comma")
    hand.frames(3)
    found["open"] = app.dialog
    shoot(hand, "settings_dark")
    names: tuple[Theme, ...] = ("light", "contrast")
    for theme_name in names:
        hand.ctx.item_click("//Settings/##Theme")
        hand.frames(3)
        hand.ctx.item_click(f"//$FOCUSED/$${list(THEMES).index(theme_name)}/{THEMES[theme_name]}")
        hand.frames(3)
        found[theme_name] = app.preferences.theme
        shoot(hand, f"settings_{theme_name}")
    hand.press("F1")
    hand.frames(3)
    shoot(hand, "help_contrast")
    hand.press("F1")
    heights = [imgui.get_style().font_scale_main]
    app.prefer(font_size=24.0)
    hand.frames(3)
    heights.append(imgui.get_style().font_scale_main)
    found["heights"] = heights
    app.prefer(theme="light")
    hand.press("Ctrl+Comma")
    shoot(hand, "settings_large")
    hand.press("Escape")
    app.prefer(font_size=16.0)
    hand.press("R")
    hand.frames(4)
    shoot(hand, "light")
    hand.press("Escape")

    def moved(act: Callable[[], object]) -> list[bool]:
        """Whether the eye has moved, and what it looks at."""
        before = app.view
        act()
        hand.settle()
        after = app.view
        return [
            bool(abs(a - b).max() > 1e-4) for a, b in ((before.eye, after.eye), (before.target, after.target))
        ]

    drags = found.setdefault("drags", {})
    for preset in ("splatview", "supersplat", "blender", "unreal"):
        app.prefer(mouse=preset)
        drags[preset] = [moved(lambda number=number: hand.drag(40, 25, number)) for number in range(3)]
    app.prefer(mouse="splatview", touchpad=True)
    hand.point(0.5, 0.5)
    found["two_fingers"] = moved(lambda: hand.ctx.mouse_wheel_y(2))
    app.prefer(touchpad=False)
    found["wheel"] = moved(lambda: hand.ctx.mouse_wheel_y(2))

    app.prefer(keys="blender")
    hand.frames(3)
    hand.press("B")
    found["blender_b"] = session.tool
    hand.press("A")
    hand.settle()
    found["blender_a"] = [session.document.counts.selected, moved(lambda: hand.hold("A", 0.2))]
    hand.press("Alt+A")
    hand.press("Ctrl+Comma")
    hand.frames(3)
    hand.ctx.item_click("//Settings/Reset all")
    hand.frames(3)
    found["reset"] = [app.preferences.keys, app.preferences.theme]
    hand.press("Escape")
    hand.press("B")
    found["own_b"] = len(app.bookmarks)
    app.prefer(theme="light", font_size=18.0, keys="unreal")


def found_browser(app: AppState) -> Any:
    return window_of(app).dialogs.browser


def window_of(app: AppState) -> Any:
    """The `Window` whose dialogs `app` asks."""
    ask: Any = app.choose_files
    return type("Window", (), {"dialogs": ask.__self__})


def rows(app: AppState) -> list[str]:
    browser = found_browser(app)
    return [] if browser is None else [entry.name for entry in browser._rows()]


def click_in(hand: Hand, name: str, x: float, y: float) -> None:
    """At a share of a window's width and height: of what is drawn by hand and has no name."""
    place = hand.ctx.window_info(name).rect_full
    hand.ctx.mouse_move_to_pos(
        ImVec2(place.min.x + x * (place.max.x - place.min.x), place.min.y + y * (place.max.y - place.min.y))
    )
    hand.frames(2)
    hand.ctx.mouse_click(0)
    hand.frames(3)


def click_row(hand: Hand, row: int, *, times: int = 1) -> None:
    """On a row of the browser's table, below its headings."""
    child = hand.ctx.window_info("//Open a scene/##files").window
    height = imgui.get_text_line_height() + 2 * imgui.get_style().cell_padding.y
    hand.ctx.mouse_move_to_pos(ImVec2(child.pos.x + 120, child.pos.y + (row + 1.5) * height))
    hand.ctx.mouse_click(0) if times == 1 else hand.double_click()
    hand.frames(3)


def click_place(hand: Hand, row: int) -> None:
    child = hand.ctx.window_info("//Open a scene/##places").window
    height = imgui.get_text_line_height_with_spacing()
    hand.ctx.mouse_move_to_pos(ImVec2(child.pos.x + 60, child.pos.y + 8 + (row + 0.3) * height))
    hand.ctx.mouse_click(0)
    hand.frames(3)


def found_up(hand: Hand) -> str:
    from imgui_bundle import icons_fontawesome_6 as icons

    return icons.ICON_FA_ARROW_UP


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
