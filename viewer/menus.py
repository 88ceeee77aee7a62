"""The menu bar and the command palette, both over the table of commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from imgui_bundle import ImVec2, hello_imgui, imgui

from splatview.renderers import MODES
from splatview.viewer import open as opening
from splatview.viewer import theme
from splatview.viewer.camera import UP_NAMES
from splatview.viewer.commands import COMMANDS, NAVIGATION_MODES, Command
from splatview.viewer.dialogs import DIALOG_FLAGS, centred
from splatview.viewer.navigation import AXIS_NAMES
from splatview.viewer.panels import widgets
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining

Entry = str | Callable[[AppState], None] | None
"""Id of a command, a function that shows entries of its own, or None for a separator."""


def show(app: AppState) -> None:
    training = app.find(LiveTraining)
    for title, entries in MENUS.items():
        if title == "Training" and training is None:
            continue
        if imgui.begin_menu(title):
            show_entries(app, entries)
            imgui.end_menu()


def show_entries(app: AppState, entries: Iterable[Entry]) -> None:
    for entry in entries:
        if entry is None:
            imgui.separator()
        elif isinstance(entry, str):
            item(app, COMMANDS[entry])
        else:
            entry(app)


def item(app: AppState, command: Command, title: str = "") -> None:
    """A menu entry with its key."""
    keys = command.keys[0] if command.keys else ""
    name = title or command.menu or command.title
    lacks = command.lacks(app)
    if imgui.menu_item(name, keys, command.checked(app), not lacks)[0]:
        app.post(command.run)
    widgets.tooltip(lacks)


def recent_files(app: AppState) -> None:
    if not imgui.begin_menu("Recent", bool(app.preferences.recent)):
        return
    for name in app.preferences.recent:
        if imgui.menu_item(widgets.item(Path(name).name, name), "", False)[0]:
            app.post(opening.open_paths, [Path(name)])
        widgets.tooltip(name)
    imgui.separator()
    if imgui.menu_item("Forget these", "", False)[0]:
        app.prefer(recent=())
    imgui.end_menu()


def axis_views(app: AppState) -> None:
    if imgui.begin_menu("Look from"):
        show_entries(app, [f"look_from_{name}" for name in AXIS_NAMES])
        imgui.end_menu()


def up_axes(app: AppState) -> None:
    if not imgui.begin_menu("Up axis"):
        return
    show_entries(app, (*(f"up_{name}" for name in UP_NAMES), None, "next_up", "up_from_view", "tool_ground"))
    show_entries(app, (None, "roll_left", "roll_right", None, *(f"turn_scene_{name}" for name in AXIS_NAMES)))
    imgui.end_menu()


def pause_or_resume(app: AppState) -> None:
    running = app.feature(LiveTraining).status.state == "training"
    item(app, COMMANDS["pause_training"], "Pause" if running else "Resume")


def panels(app: AppState) -> None:
    """An entry for each panel."""
    params = hello_imgui.get_runner_params()
    for window in params.docking_params.dockable_windows:
        if window.can_be_closed and imgui.menu_item(window.label, "", window.is_visible)[0]:
            window.is_visible = not window.is_visible


# fmt: off
MENUS: dict[str, tuple[Entry, ...]] = {
    "File": (
        "open", "add", recent_files, "merge", "reload", None,
        "export", "split", "save_recipe", "replay_recipe", None,
        "demo", None, "open_cameras", None, "screenshot", "screenshot_as", None, "quit",
    ),
    "Edit": (
        "undo", "redo", None,
        "delete", "hide", "isolate", "lock", "duplicate", "show", "unlock", None, "tool_measure",
    ),
    "Select": (
        "select_all", "select_none", "select_inverse", None,
        *(f"tool_{tool}" for tool in ("rectangle", "brush", "lasso", "polygon", "flood", "colour")), None,
        "next_depth",
    ),
    "Camera": (
        "home_view", "frame_selection", "frame_all", axis_views, "level", None,
        *(f"navigate_{mode}" for mode in NAVIGATION_MODES), None,
        up_axes, "toggle_orthographic", "toggle_lenses", "depth_of_field", "focus_by_click",
        "narrower", "wider", None,
        "add_bookmark", "next_bookmark", "previous_camera", "next_camera", None,
        "copy_camera", "paste_camera",
    ),
    "Picture": (
        *(f"mode_{mode}" for mode in MODES), None,
        "toggle_grid", "toggle_axes", "toggle_centres", "toggle_rings",
    ),
    "Training": (
        pause_or_resume, "step_training", "stop_training", None,
        "export_training", "save_checkpoint", None, "evaluate_training", "show_training",
    ),
    "Window": ("toggle_panels", None, panels, None, "reset_panels"),
    "Help": ("toggle_help", "toggle_palette"),
}
# fmt: on


ROWS = 14
"""Seen at once."""


def matching(query: str) -> list[Command]:
    """Commands that have every word of `query` in title, group, keys or further words, the likeliest first: a
    word that begins one of the title counts more than one within."""
    words = query.casefold().split()
    scored = []
    for place, command in enumerate(COMMANDS.values()):
        if (score := _score(words, command)) is not None:
            scored.append((score, place, command))
    return [command for _, _, command in sorted(scored, key=lambda entry: entry[:2])]


def _score(words: list[str], command: Command) -> int | None:
    text = f"{command.title} {command.group}".casefold()
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
        elif any(part.startswith(word) for part in command.words.casefold().split()):
            total += 9
        else:
            return None
    return total


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
    down, up = (imgui.is_key_pressed(key) for key in (imgui.Key.down_arrow, imgui.Key.up_arrow))
    palette.chosen = min(max(palette.chosen + down - up, 0), max(len(found) - 1, 0))
    run = found[palette.chosen] if found and imgui.is_key_pressed(imgui.Key.enter) else None
    height = imgui.get_text_line_height_with_spacing() * ROWS
    imgui.begin_child("##found", ImVec2(0, height))
    for number, command in enumerate(found):
        clicked, _ = imgui.selectable(f"{command.title}##{command.id}", number == palette.chosen)
        if clicked:
            run = command
        if number == palette.chosen and not palette.fresh:
            imgui.set_scroll_here_y(0.5) if changed or down or up else None
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
        app.post(run.run)
    elif not opened:
        app.dialog = None
