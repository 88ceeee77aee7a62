"""The menu bar. Every entry is an action of the shortcut table, or opens something by name."""

from __future__ import annotations

from pathlib import Path

from imgui_bundle import ImVec2, hello_imgui, imgui

from splatview.viewer import open as opening
from splatview.viewer import theme
from splatview.viewer.commands import (
    ACTIONS,
    NAVIGATION_MODES,
    SHORTCUTS,
    UP_NAMES,
    VISUAL_MODES,
    Shortcut,
    keys_of,
    set_up,
    text_of,
    up_name,
)
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.navigation import AXIS_NAMES
from splatview.viewer.state import Core
from splatview.viewer.training import live as training


def show(core: Core) -> None:
    if imgui.begin_menu("File"):
        file_menu(core)
        imgui.end_menu()
    if imgui.begin_menu("Edit"):
        edit_menu(core)
        imgui.end_menu()
    if imgui.begin_menu("Select"):
        select_menu(core)
        imgui.end_menu()
    if imgui.begin_menu("Camera"):
        camera_menu(core)
        imgui.end_menu()
    if imgui.begin_menu("Picture"):
        for mode in VISUAL_MODES:
            item(core, f"mode_{mode}", selected=core.mode == mode)
        imgui.end_menu()
    if core.training is not None and imgui.begin_menu("Training"):
        training_menu(core)
        imgui.end_menu()
    if imgui.begin_menu("Window"):
        window_menu(core)
        imgui.end_menu()
    if imgui.begin_menu("Help"):
        item(core, "toggle_help", "Keys and mouse")
        item(core, "toggle_palette")
        imgui.end_menu()


def item(core: Core, action: str, name: str = "", *, selected: bool = False, enabled: bool = True) -> None:
    """A menu entry with its key; `name` where the table's text would be too long."""
    clicked, _ = imgui.menu_item(name or text_of(action), keys_of(action), selected, enabled)
    if clicked:
        core.post(ACTIONS[action])


def file_menu(core: Core) -> None:
    item(core, "open", "Open...")
    item(core, "add", "Add to the scene...", enabled=core.scene is not None)
    if imgui.begin_menu("Recent", bool(core.preferences.recent)):
        for name in core.preferences.recent:
            if imgui.menu_item(f"{Path(name).name}##{name}", "", False)[0]:
                core.post(opening.open_paths, [Path(name)])
            if imgui.is_item_hovered():
                imgui.set_tooltip(name)
        imgui.separator()
        if imgui.menu_item("Forget these", "", False)[0]:
            core.prefer(recent=())
        imgui.end_menu()
    item(core, "merge", "Merge as an edit...", enabled=core.at_rest)
    item(core, "reload", enabled=core.scene_path is not None)
    imgui.separator()
    item(core, "export", "Export the edited scene...", enabled=core.can_edit)
    item(core, "split", "Selection to its own file...", enabled=core.at_rest)
    item(core, "save_recipe", "Save recipe...", enabled=core.at_rest)
    item(core, "replay_recipe", "Replay recipe...", enabled=core.at_rest)
    imgui.separator()
    if imgui.menu_item("Demo scene", "", False)[0]:
        core.post(opening.begin_demo)
    imgui.separator()
    item(core, "open_cameras", "Load cameras...")
    imgui.separator()
    item(core, "screenshot", "Save a picture")
    item(core, "screenshot_as", "Save a picture as...")
    imgui.separator()
    item(core, "quit")


def edit_menu(core: Core) -> None:
    desk = core.desk
    history = desk.document.history if desk else None
    selected = desk is not None and desk.document.counts.selected > 0
    item(core, "undo", enabled=history is not None and history.can_undo)
    item(core, "redo", enabled=history is not None and history.can_redo)
    imgui.separator()
    for action in ("delete", "hide", "isolate", "lock"):
        item(core, action, enabled=selected)
    item(core, "duplicate", enabled=selected and core.at_rest)
    item(core, "show", enabled=desk is not None and desk.document.counts.hidden > 0)
    item(core, "unlock", enabled=desk is not None and desk.document.counts.locked > 0)
    imgui.separator()
    item(
        core,
        "tool_measure",
        selected=desk is not None and desk.tool == "measure",
        enabled=core.can_edit,
    )


def select_menu(core: Core) -> None:
    desk = core.desk
    for action in ("select_all", "select_none", "select_inverse"):
        item(core, action, enabled=core.can_edit)
    imgui.separator()
    for tool in ("rectangle", "brush", "lasso", "polygon", "flood", "colour"):
        item(core, f"tool_{tool}", selected=desk is not None and desk.tool == tool, enabled=core.can_edit)
    imgui.separator()
    front = desk is not None and desk.depth == "front"
    item(core, "next_depth", "Only the front surface", selected=front, enabled=core.can_edit)


def camera_menu(core: Core) -> None:
    item(core, "frame_selection")
    item(core, "frame_all")
    if imgui.begin_menu("Look from"):
        for name in AXIS_NAMES:
            item(core, f"look_from_{name}", name)
        imgui.end_menu()
    item(core, "level")
    imgui.separator()
    for mode in NAVIGATION_MODES:
        item(
            core,
            f"navigate_{mode}",
            mode.capitalize(),
            selected=core.preferences.navigation == mode,
        )
    imgui.separator()
    if imgui.begin_menu("Up axis"):
        now = up_name(core.view)
        for name in UP_NAMES:
            if imgui.menu_item(name, "", now == name)[0]:
                core.post(set_up, name)
        imgui.separator()
        item(core, "next_up", "Next")
        item(core, "up_from_view", "What is up in the picture")
        imgui.end_menu()
    item(core, "toggle_orthographic", "Orthographic", selected=core.destination.lens.orthographic)
    has_lenses = any(camera.lens is not None for camera in core.cameras)
    item(core, "toggle_lenses", "Camera lenses", selected=core.through_lenses, enabled=has_lenses)
    item(core, "depth_of_field", "Depth of field", selected=core.depth_of_field.on)
    item(core, "focus_by_click", "Focus by click")
    item(core, "narrower")
    item(core, "wider")
    imgui.separator()
    item(core, "add_bookmark")
    item(core, "next_bookmark", enabled=bool(core.bookmarks))
    item(core, "previous_camera", enabled=bool(core.cameras))
    item(core, "next_camera", enabled=bool(core.cameras))
    imgui.separator()
    item(core, "copy_camera")
    item(core, "paste_camera")


def training_menu(core: Core) -> None:
    assert core.training is not None
    running = core.training.status.state == "training"
    item(core, "pause_training", "Pause" if running else "Resume")
    item(core, "step_training", "One step")
    if imgui.menu_item("Stop and save", "", False)[0]:
        core.post(training.stop_and_save)
    imgui.separator()
    if imgui.menu_item("Export .ply...", "", False)[0]:
        core.post(training.export)
    if imgui.menu_item("Save a checkpoint", "", False)[0]:
        core.post(training.save_checkpoint)
    imgui.separator()
    if imgui.menu_item("Measure the held-out photos", "", False)[0]:
        core.post(training.evaluate)
    if imgui.menu_item("Show the scene in training", "", False, not core.training.followed_by(core))[0]:
        core.post(training.show_training)


def window_menu(core: Core) -> None:
    item(core, "toggle_panels", "Only the picture", selected=core.panels_hidden)
    imgui.separator()
    params = hello_imgui.get_runner_params()
    for window in params.docking_params.dockable_windows:
        if window.can_be_closed and imgui.menu_item(window.label, "", window.is_visible)[0]:
            window.is_visible = not window.is_visible
    imgui.separator()
    if imgui.menu_item("Put the panels back", "", False)[0]:
        core.panels_hidden, core.open_panels = False, None
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


def show_palette(core: Core) -> None:
    """The palette, while it is open."""
    palette = core.palette
    if core.dialog != "palette":
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
        core.dialog = None
        core.post(ACTIONS[run.action])
    elif not opened:
        core.dialog = None


def _arrows() -> bool:
    return imgui.is_key_pressed(imgui.Key.down_arrow) or imgui.is_key_pressed(imgui.Key.up_arrow)
