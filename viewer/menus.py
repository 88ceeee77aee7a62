"""The menu bar, over the table of commands."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from imgui_bundle import imgui

from splatview.renderers import MODES
from splatview.viewer import open as opening
from splatview.viewer.camera import UP_NAMES
from splatview.viewer.commands import COMMANDS, NAVIGATION_MODES, Command
from splatview.viewer.editing.tool_state import CROPPING, SELECTING, TRANSFORMING
from splatview.viewer.navigation import AXIS_NAMES
from splatview.viewer.panels import widgets
from splatview.viewer.sequence import USUAL_RATES, Sequences
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining

Entry = str | Callable[[AppState], None] | None
"""Id of a command, a function that shows entries of its own, or None for a separator."""


def show(app: AppState) -> None:
    training = app.find(LiveTraining)
    for title, entries in MENUS.items():
        if title == "Training" and training is None:
            continue
        if title == "Sequence" and app.feature(Sequences).player is None:
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


def film(app: AppState) -> None:
    if not imgui.begin_menu("Film"):
        return
    show_entries(app, ("add_keyframe", "update_keyframe", "delete_keyframe", "undo_film", None))
    show_entries(app, ("previous_keyframe", "next_keyframe", "play_film", "loop_film", "turntable", None))
    show_entries(app, ("open_camera_path", "save_camera_path", "export_film"))
    imgui.end_menu()


def pause_or_resume(app: AppState) -> None:
    running = app.feature(LiveTraining).status.state == "training"
    item(app, COMMANDS["pause_training"], "Pause" if running else "Resume")


# fmt: off
MENUS: dict[str, tuple[Entry, ...]] = {
    "File": (
        "open", "open_folder", "import", recent_files, "reload", None,
        "save", "save_as", "export", "split", None,
        "train_photos", "start_screen", "demo", None,
        "open_cameras", None, "screenshot", "screenshot_as", None, "settings", None, "quit",
    ),
    "Edit": (
        "undo", "redo", None,
        "delete", "hide", "isolate", "lock", "duplicate", "show", "unlock", None,
        *(f"tool_{tool}" for tool in (*TRANSFORMING, *CROPPING, "measure")), None,
        "turn_over",
    ),
    "Select": (
        "select_all", "select_none", "select_inverse", None,
        *(f"tool_{tool}" for tool in SELECTING), None,
        "next_depth",
    ),
    "Recipe": ("save_recipe", "replay_recipe"),
    "Camera": (
        "home_view", "frame_selection", "frame_all", axis_views, "level", None,
        *(f"navigate_{mode}" for mode in NAVIGATION_MODES), None,
        up_axes, "toggle_orthographic", "toggle_lenses", "depth_of_field", "focus_by_click",
        "narrower", "wider", None,
        "add_bookmark", "next_bookmark", "previous_camera", "next_camera", None,
        "copy_camera", "paste_camera", None,
        film,
    ),
    "Picture": (
        *(f"mode_{mode}" for mode in MODES), None,
        "toggle_grid", "toggle_axes", "toggle_centres", "toggle_rings",
    ),
    "Sequence": (
        "play", "next_frame", "previous_frame", "first_frame", "last_frame", None,
        "play_loop", "play_bounce", "play_once", None,
        *(f"rate_{fps}" for fps in USUAL_RATES), None,
        "merge_frames", "discard_frame_edits",
    ),
    "Training": (
        pause_or_resume, "step_training", "stop_training", None,
        "export_training", "save_checkpoint", None, "evaluate_training", "show_training",
    ),
    "Window": (
        *(f"page_{page}" for page in ("scene", "edit", "view", "accuracy", "train")), None,
        *(f"strip_{name}" for name in ("history", "film", "curves", "compare", "log")), None,
        "toggle_panels", "reset_panels",
    ),
    "Help": ("toggle_help", "toggle_palette"),
}
# fmt: on
