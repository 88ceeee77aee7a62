"""The menu bar. Every entry is an action of the shortcut table, or opens something by name."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import ImVec2, hello_imgui, imgui

from splatview.renderers import MODES
from splatview.viewer import open as opening
from splatview.viewer import theme
from splatview.viewer.commands import (
    ACTIONS,
    NAVIGATION_MODES,
    SHORTCUTS,
    UP_NAMES,
    Shortcut,
    keys_of,
    set_up,
    text_of,
    up_name,
)
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.navigation import AXIS_NAMES
from splatview.viewer.state import AppState
from splatview.viewer.training import live as training


def show(app: AppState) -> None:
    if imgui.begin_menu("File"):
        file_menu(app)
        imgui.end_menu()
    if imgui.begin_menu("Edit"):
        edit_menu(app)
        imgui.end_menu()
    if imgui.begin_menu("Select"):
        select_menu(app)
        imgui.end_menu()
    if imgui.begin_menu("Camera"):
        camera_menu(app)
        imgui.end_menu()
    if imgui.begin_menu("Picture"):
        for mode in MODES:
            item(app, f"mode_{mode}", selected=app.mode == mode)
        imgui.end_menu()
    if app.training is not None and imgui.begin_menu("Training"):
        training_menu(app)
        imgui.end_menu()
    if imgui.begin_menu("Window"):
        window_menu(app)
        imgui.end_menu()
    if imgui.begin_menu("Help"):
        item(app, "toggle_help", "Keys and mouse")
        item(app, "toggle_palette")
        imgui.end_menu()


def item(app: AppState, action: str, name: str = "", *, selected: bool = False, enabled: bool = True) -> None:
    """A menu entry with its key; `name` where the table's text would be too long."""
    clicked, _ = imgui.menu_item(name or text_of(action), keys_of(action), selected, enabled)
    if clicked:
        app.post(ACTIONS[action])


def file_menu(app: AppState) -> None:
    item(app, "open", "Open...")
    item(app, "add", "Add to the scene...", enabled=app.scene is not None)
    if imgui.begin_menu("Recent", bool(app.preferences.recent)):
        for name in app.preferences.recent:
            if imgui.menu_item(f"{Path(name).name}##{name}", "", False)[0]:
                app.post(opening.open_paths, [Path(name)])
            if imgui.is_item_hovered():
                imgui.set_tooltip(name)
        imgui.separator()
        if imgui.menu_item("Forget these", "", False)[0]:
            app.prefer(recent=())
        imgui.end_menu()
    item(app, "merge", "Merge as an edit...", enabled=app.at_rest)
    item(app, "reload", enabled=app.scene_path is not None)
    imgui.separator()
    item(app, "export", "Export the edited scene...", enabled=app.can_edit)
    item(app, "split", "Selection to its own file...", enabled=app.at_rest)
    item(app, "save_recipe", "Save recipe...", enabled=app.at_rest)
    item(app, "replay_recipe", "Replay recipe...", enabled=app.at_rest)
    imgui.separator()
    if imgui.menu_item("Demo scene", "", False)[0]:
        app.post(opening.begin_demo)
    imgui.separator()
    item(app, "open_cameras", "Load cameras...")
    imgui.separator()
    item(app, "screenshot", "Save a picture")
    item(app, "screenshot_as", "Save a picture as...")
    imgui.separator()
    item(app, "quit")


def edit_menu(app: AppState) -> None:
    session = app.session
    history = session.document.history if session else None
    selected = session is not None and session.document.counts.selected > 0
    item(app, "undo", enabled=history is not None and history.can_undo)
    item(app, "redo", enabled=history is not None and history.can_redo)
    imgui.separator()
    for action in ("delete", "hide", "isolate", "lock"):
        item(app, action, enabled=selected)
    item(app, "duplicate", enabled=selected and app.at_rest)
    item(app, "show", enabled=session is not None and session.document.counts.hidden > 0)
    item(app, "unlock", enabled=session is not None and session.document.counts.locked > 0)
    imgui.separator()
    item(
        app,
        "tool_measure",
        selected=session is not None and session.tool == "measure",
        enabled=app.can_edit,
    )


def select_menu(app: AppState) -> None:
    session = app.session
    for action in ("select_all", "select_none", "select_inverse"):
        item(app, action, enabled=app.can_edit)
    imgui.separator()
    for tool in ("rectangle", "brush", "lasso", "polygon", "flood", "colour"):
        item(app, f"tool_{tool}", selected=session is not None and session.tool == tool, enabled=app.can_edit)
    imgui.separator()
    front = session is not None and session.depth == "front"
    item(app, "next_depth", "Only the front surface", selected=front, enabled=app.can_edit)


def camera_menu(app: AppState) -> None:
    item(app, "frame_selection")
    item(app, "frame_all")
    if imgui.begin_menu("Look from"):
        for name in AXIS_NAMES:
            item(app, f"look_from_{name}", name)
        imgui.end_menu()
    item(app, "level")
    imgui.separator()
    for mode in NAVIGATION_MODES:
        item(
            app,
            f"navigate_{mode}",
            mode.capitalize(),
            selected=app.preferences.navigation == mode,
        )
    imgui.separator()
    if imgui.begin_menu("Up axis"):
        now = up_name(app.view)
        for name in UP_NAMES:
            if imgui.menu_item(name, "", now == name)[0]:
                app.post(set_up, name)
        imgui.separator()
        item(app, "next_up", "Next")
        item(app, "up_from_view", "What is up in the picture")
        imgui.end_menu()
    item(app, "toggle_orthographic", "Orthographic", selected=app.destination.lens.orthographic)
    has_lenses = any(camera.lens is not None for camera in app.cameras)
    item(app, "toggle_lenses", "Camera lenses", selected=app.through_lenses, enabled=has_lenses)
    item(app, "depth_of_field", "Depth of field", selected=app.depth_of_field.on)
    item(app, "focus_by_click", "Focus by click")
    item(app, "narrower")
    item(app, "wider")
    imgui.separator()
    item(app, "add_bookmark")
    item(app, "next_bookmark", enabled=bool(app.bookmarks))
    item(app, "previous_camera", enabled=bool(app.cameras))
    item(app, "next_camera", enabled=bool(app.cameras))
    imgui.separator()
    item(app, "copy_camera")
    item(app, "paste_camera")


def training_menu(app: AppState) -> None:
    assert app.training is not None
    running = app.training.status.state == "training"
    item(app, "pause_training", "Pause" if running else "Resume")
    item(app, "step_training", "One step")
    if imgui.menu_item("Stop and save", "", False)[0]:
        app.post(training.stop_and_save)
    imgui.separator()
    if imgui.menu_item("Export .ply...", "", False)[0]:
        app.post(training.export)
    if imgui.menu_item("Save a checkpoint", "", False)[0]:
        app.post(training.save_checkpoint)
    imgui.separator()
    if imgui.menu_item("Measure the held-out photos", "", False)[0]:
        app.post(training.evaluate)
    if imgui.menu_item("Show the scene in training", "", False, not app.training.followed_by(app))[0]:
        app.post(training.show_training)


def window_menu(app: AppState) -> None:
    item(app, "toggle_panels", "Only the picture", selected=app.panels_hidden)
    imgui.separator()
    params = hello_imgui.get_runner_params()
    for window in params.docking_params.dockable_windows:
        if window.can_be_closed and imgui.menu_item(window.label, "", window.is_visible)[0]:
            window.is_visible = not window.is_visible
    imgui.separator()
    if imgui.menu_item("Put the panels back", "", False)[0]:
        app.panels_hidden, app.open_panels = False, None
        params.docking_params.layout_reset = True


# ---- The command palette: type a few letters of what you want, Enter does it and shows its key for next
# time.


ROWS = 14
"""Seen at once."""


def matching(query: str, commands: tuple[Shortcut, ...] = SHORTCUTS) -> list[Shortcut]:
    """Commands that have every word of `query` in text, group or keys, the likeliest first.

    A word that begins a word of the text counts more than one within; letters alone, in order, still find
    what no word does.
    """
    words = query.casefold().split()
    scored = []
    for place, command in enumerate(commands):
        if not command.held and (score := _score(words, command)) is not None:
            scored.append((score, place, command))
    return [command for _, _, command in sorted(scored, key=lambda entry: entry[:2])]


def _score(words: list[str], command: Shortcut) -> int | None:
    text = f"{command.text} {command.group}".casefold()
    parts = text.replace(":", " ").split()
    keys = [key.casefold() for key in command.keys]
    total = 0
    for word in words:
        if parts[0].startswith(word) or word in keys:
            continue
        if any(part.startswith(word) for part in parts):
            total += 1
        elif word in text:
            total += 3
        elif _letters_in_order(word, text):
            total += 9
        else:
            return None
    return total


def _letters_in_order(word: str, text: str) -> bool:
    letters = iter(text)
    return len(word) > 1 and all(letter in letters for letter in word)


def show_palette(app: AppState) -> None:
    """The palette, while it is open."""
    palette = app.palette
    if app.dialog != "palette":
        palette.query, palette.chosen, palette.fresh = "", 0, True
        return
    centred(34)
    opened = imgui.begin("Commands", True, DIALOG_FLAGS | imgui.WindowFlags_.no_resize)[1]
    if palette.fresh:
        imgui.set_keyboard_focus_here()
    imgui.set_next_item_width(-1)
    changed, palette.query = imgui.input_text_with_hint("##query", "What do you want to do?", palette.query)
    if changed:
        palette.chosen = 0
    found = matching(palette.query)
    if imgui.is_key_pressed(imgui.Key.down_arrow):
        palette.chosen += 1
    if imgui.is_key_pressed(imgui.Key.up_arrow):
        palette.chosen -= 1
    palette.chosen = min(max(palette.chosen, 0), max(len(found) - 1, 0))
    run = found[palette.chosen] if found and imgui.is_key_pressed(imgui.Key.enter) else None
    height = imgui.get_text_line_height_with_spacing() * ROWS
    imgui.begin_child("##found", ImVec2(0, height))
    for number, command in enumerate(found):
        clicked, _ = imgui.selectable(f"{command.text}##{command.action}", number == palette.chosen)
        if clicked:
            run = command
        if number == palette.chosen and not palette.fresh:
            imgui.set_scroll_here_y(0.5) if changed or _arrows() else None
        side = f"{command.group}   {', '.join(command.keys)}"
        imgui.same_line(imgui.get_content_region_avail().x - imgui.calc_text_size(side).x)
        imgui.text_colored(theme.QUIET, side)
    if not found:
        imgui.text_colored(theme.QUIET, "No command has these words")
    imgui.end_child()
    imgui.end()
    if not palette.fresh and imgui.is_key_pressed(imgui.Key.escape):
        opened = False
    palette.fresh = False
    if run is not None:
        app.dialog = None
        app.post(ACTIONS[run.action])
    elif not opened:
        app.dialog = None


def _arrows() -> bool:
    return imgui.is_key_pressed(imgui.Key.down_arrow) or imgui.is_key_pressed(imgui.Key.up_arrow)
