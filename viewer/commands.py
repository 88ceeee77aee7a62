"""What the user can ask for by name: keys, menus, buttons and the help page all end here.

Every function takes the `AppState` first and is posted to it, so it runs on the GL thread between frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import get_args

import numpy as np
from imgui_bundle import imgui

from splatview.edit.detectors import DETECTORS
from splatview.renderers import MODES, VisualMode
from splatview.scene import InputError
from splatview.viewer import background as backdrop
from splatview.viewer import depth_of_field
from splatview.viewer import open as camera_list
from splatview.viewer import open as opening
from splatview.viewer import save as saving
from splatview.viewer.editing.commands import EDIT_ACTIONS, cancel_job, take_tool
from splatview.viewer.navigation import AXIS_NAMES, View, axis_view, focus, frame, level, pick, with_up
from splatview.viewer.navigation.framing import axis
from splatview.viewer.navigation.view import MAX_FOV, MIN_FOV
from splatview.viewer.open import bounds
from splatview.viewer.preferences import Bookmark, NavigationMode, load_bookmarks, save_bookmarks
from splatview.viewer.state import AppState
from splatview.viewer.training import live as training
from splatview.viewer.training.live_edits import let_go

NAVIGATION_MODES: tuple[NavigationMode, ...] = get_args(NavigationMode)
UP_NAMES = ("+Y", "-Y", "+Z", "-Z", "+X", "-X")
"""In the order in which one key goes through them: the likeliest first."""

FOV_STEP = 1.1
"""Factor on the angle for one press of a key."""


# ---- camera


def frame_all(app: AppState) -> None:
    """Shows the whole scene from where the eye is turned; what is deleted or hidden does not count."""
    _frame(app, bounds(app))


def frame_selection(app: AppState) -> None:
    """Shows what is selected, else the whole scene."""
    _frame(app, bounds(app, selected=True) or bounds(app))


def _frame(app: AppState, found: tuple[np.ndarray, float] | None) -> None:
    if found is not None:
        width, height = app.picture_size
        app.go_to(frame(app.destination, *found, aspect=width / height))


def look_along(app: AppState, name: str) -> None:
    app.go_to(axis_view(app.destination, name))


def make_level(app: AppState) -> None:
    app.go_to(level(app.destination))


def set_up(app: AppState, name: str) -> None:
    """Makes the world axis `name` the up axis, and the horizon level about it."""
    app.go_to(with_up(app.destination, axis(name)))
    app.tell(f"Up is {name}")


def next_up(app: AppState) -> None:
    now = up_name(app.destination)
    set_up(app, UP_NAMES[(UP_NAMES.index(now) + 1) % len(UP_NAMES)] if now else UP_NAMES[0])


def up_name(view: View) -> str | None:
    """The world axis that is up, or None where it is oblique."""
    return next((name for name in UP_NAMES if float(axis(name) @ view.up) > 1 - 1e-6), None)


def up_from_view(app: AppState) -> None:
    app.steer(replace(app.destination, up=-app.destination.R_camera_world[1]))
    app.tell("Up is what is up in this view")


def change_fov(app: AppState, factor: float) -> None:
    lens = app.destination.lens
    fov_y = min(max(lens.fov_y * factor, MIN_FOV), MAX_FOV)
    app.go_to(replace(app.destination, lens=replace(lens, fov_y=fov_y)))


def toggle_orthographic(app: AppState) -> None:
    """Parallel rays or a pinhole's; what is at the target's distance stays as large."""
    lens = replace(app.destination.lens, orthographic=not app.destination.lens.orthographic)
    app.steer(replace(app.destination, lens=lens))
    app.tell("Orthographic: rays are parallel" if lens.orthographic else "Perspective: rays meet in the eye")


def toggle_lenses(app: AppState) -> None:
    """Shows the views of loaded cameras through their lenses, or as pinholes would."""
    app.through_lenses = not app.through_lenses
    chosen = app.cameras[app.camera_index] if 0 <= app.camera_index < len(app.cameras) else None
    lens = app.destination.lens
    if not app.through_lenses:
        app.steer(replace(app.destination, lens=replace(lens, distortion=None)))
        app.tell("Without lenses: views are those of pinholes")
    elif chosen is not None and chosen.lens is not None:
        app.steer(replace(app.destination, lens=replace(lens, distortion=chosen.lens, orthographic=False)))
        app.tell(f"Through the camera's lens, {chosen.lens.model}")
    else:
        app.tell("Through lenses, where the chosen camera has one")


def focus_at(app: AppState, x: float, y: float) -> None:
    """Turns about the surface at (x, y) px of the visible area; without one there, nothing happens."""
    if not app.scene:
        return
    found = pick(app.scene.gaussians, app.camera, app.settings, x, y, edits=app.edits)
    if found is None:
        app.tell("Nothing to turn about there: the pixel shows the background")
        return
    app.go_to(focus(app.view, found.point))
    app.tell(f"Turning about splat {found.index:,}, {found.depth:.4g} units ahead")


# ---- bookmarks


def add_bookmark(app: AppState) -> None:
    numbers = {bookmark.name for bookmark in app.bookmarks}
    number = next(n for n in range(1, len(numbers) + 2) if f"View {n}" not in numbers)
    app.bookmarks.append(Bookmark(name=f"View {number}", view=app.destination))
    app.bookmark_index = len(app.bookmarks) - 1
    keep_bookmarks(app)


def rename_bookmark(app: AppState, index: int, name: str) -> None:
    if name.strip():
        app.bookmarks[index] = replace(app.bookmarks[index], name=name.strip())
        keep_bookmarks(app)


def delete_bookmark(app: AppState, index: int) -> None:
    del app.bookmarks[index]
    app.bookmark_index = -1
    keep_bookmarks(app)


def go_to_bookmark(app: AppState, index: int) -> None:
    if not app.bookmarks:
        app.tell("There are no bookmarks yet")
        return
    app.bookmark_index = index % len(app.bookmarks)
    app.go_to(app.bookmarks[app.bookmark_index].view)
    app.tell(f"Bookmark: {app.bookmarks[app.bookmark_index].name}")


def keep_bookmarks(app: AppState) -> None:
    """Saves them, and says where."""
    if app.scene_path is None:
        app.tell("Bookmarks of the demo are not saved: it has no file to put them beside")
        return
    try:
        # What another window on the scene has added since stays, and a file that is damaged is not lost.
        app.bookmarks += [
            bookmark
            for bookmark in load_bookmarks(app.scene_path)
            if bookmark.entry not in app.bookmarks_read
        ]
        path = save_bookmarks(app.scene_path, app.bookmarks)
        app.bookmarks_read = frozenset(bookmark.entry for bookmark in load_bookmarks(app.scene_path))
    except (OSError, InputError) as error:
        app.complain(f"The bookmarks cannot be saved: {error}")
        return
    app.tell(f"Bookmarks saved in {path}")


# ---- modes and the window


def navigate(app: AppState, mode: NavigationMode) -> None:
    app.prefer(navigation=mode)
    if mode != "trackball":
        app.go_to(level(app.destination))


def next_navigation(app: AppState) -> None:
    index = NAVIGATION_MODES.index(app.preferences.navigation)
    navigate(app, NAVIGATION_MODES[(index + 1) % len(NAVIGATION_MODES)])


def set_mode(app: AppState, mode: VisualMode) -> None:
    app.mode = mode


def toggle_dialog(app: AppState, name: str) -> None:
    app.dialog = None if app.dialog == name else name


def toggle_panels(app: AppState) -> None:
    app.panels_hidden = not app.panels_hidden


def cancel(app: AppState) -> None:
    """The way back from whatever is open or under way."""
    if app.problem:
        app.problem = None
    elif app.dialog:
        app.dialog = None
    elif app.depth_of_field.picking:
        app.depth_of_field.picking = False
    elif app.loading:
        opening.cancel_loading(app)
    elif app.session and app.session.job:
        cancel_job(app)
    elif app.session and app.session.tool != "none":
        take_tool(app, "none")
    elif app.session and app.session.target:
        let_go(app)


def quit_window(app: AppState) -> None:
    app.quitting = True


ACTIONS: dict[str, Callable[[AppState], None]] = {
    "open": opening.choose_scene,
    "reload": opening.reload,
    "open_cameras": opening.choose_cameras,
    "screenshot": saving.screenshot,
    "screenshot_as": partial(toggle_dialog, name="screenshot"),
    "quit": quit_window,
    "frame_selection": frame_selection,
    "frame_all": frame_all,
    **{f"look_from_{name}": partial(look_along, name=name) for name in AXIS_NAMES},
    "level": make_level,
    "next_up": next_up,
    "up_from_view": up_from_view,
    "toggle_orthographic": toggle_orthographic,
    "toggle_lenses": toggle_lenses,
    "depth_of_field": depth_of_field.switch,
    "focus_by_click": depth_of_field.focus_by_click,
    "narrower": partial(change_fov, factor=1 / FOV_STEP),
    "wider": partial(change_fov, factor=FOV_STEP),
    "next_camera": partial(camera_list.step_camera, step=1),
    "previous_camera": partial(camera_list.step_camera, step=-1),
    "add_bookmark": add_bookmark,
    "next_bookmark": lambda app: go_to_bookmark(app, app.bookmark_index + 1),
    "copy_camera": camera_list.copy_camera,
    "paste_camera": camera_list.paste_camera,
    **{f"navigate_{mode}": partial(navigate, mode=mode) for mode in NAVIGATION_MODES},
    "next_navigation": next_navigation,
    "open_background": backdrop.ask_for_picture,
    **{f"mode_{mode}": partial(set_mode, mode=mode) for mode in MODES},
    "pause_training": training.pause_or_resume,
    "step_training": training.step_once,
    "toggle_panels": toggle_panels,
    "toggle_help": partial(toggle_dialog, name="help"),
    "toggle_palette": partial(toggle_dialog, name="palette"),
    **EDIT_ACTIONS,
    "cancel": cancel,
}
"""Every action that has a name in `shortcuts.SHORTCUTS`."""


# ---- The one table of keys: bindings, menus and the help page all read it.


@dataclass(frozen=True, kw_only=True)
class Shortcut:
    """One thing that keys do."""

    action: str
    """The key in `actions.ACTIONS`, or for a `held` key a direction in `HELD_DIRECTIONS`."""
    keys: tuple[str, ...]
    """As the user reads them: "F", "Ctrl+Shift+O". Any of them does it; those without are in the palette."""
    text: str
    """What it does, for the menu and the help page."""
    group: str
    held: bool = False
    """Acts as long as the key is down (flying), rather than once."""


def _once(group: str, action: str, keys: str, text: str) -> Shortcut:
    return Shortcut(action=action, keys=tuple(keys.split()), text=text, group=group)


def _held(action: str, keys: str, text: str) -> Shortcut:
    return Shortcut(action=action, keys=tuple(keys.split()), text=text, group="Moving", held=True)


SHORTCUTS: tuple[Shortcut, ...] = (
    _once("File", "open", "Ctrl+O", "Open a scene"),
    _once("File", "add", "Ctrl+Shift+O", "Add another scene to this one"),
    _once("File", "reload", "F5", "Read the scene's files again"),
    _once("File", "open_cameras", "Ctrl+L", "Load a list of cameras"),
    _once("File", "screenshot", "F12", "Save a picture beside the scene"),
    _once("File", "screenshot_as", "Ctrl+F12", "Save a picture, choosing size and place"),
    _once("File", "quit", "Ctrl+Q", "Quit"),
    _once("Camera", "frame_selection", "F", "Show what is selected, else the whole scene"),
    _once("Camera", "frame_all", "Home", "Show the whole scene"),
    _once("Camera", "look_from_+X", "X", "Look from +X"),
    _once("Camera", "look_from_-X", "Shift+X", "Look from -X"),
    _once("Camera", "look_from_+Y", "Y", "Look from +Y"),
    _once("Camera", "look_from_-Y", "Shift+Y", "Look from -Y"),
    _once("Camera", "look_from_+Z", "Z", "Look from +Z"),
    _once("Camera", "look_from_-Z", "Shift+Z", "Look from -Z"),
    _once("Camera", "level", "L", "Make the horizon level"),
    _once("Camera", "next_up", "U", "Next up axis: +Y, -Y, +Z, -Z, +X, -X"),
    _once("Camera", "up_from_view", "Shift+U", "Take what is up in the picture as the up axis"),
    _once("Camera", "toggle_orthographic", "Shift+P", "Orthographic: parallel rays, or perspective again"),
    _once("Camera", "toggle_lenses", "Shift+L", "Look through the lenses of loaded cameras, or without"),
    _once("Camera", "depth_of_field", "Shift+B", "Depth of field on or off"),
    _once("Camera", "focus_by_click", "Shift+C", "Depth of field: click what shall be sharp"),
    _once("Camera", "narrower", "]", "Narrower field of view"),
    _once("Camera", "wider", "[", "Wider field of view"),
    _once("Camera", "next_camera", "PageDown", "Next loaded camera"),
    _once("Camera", "previous_camera", "PageUp", "Previous loaded camera"),
    _once("Camera", "add_bookmark", "B", "Bookmark this view"),
    _once("Camera", "next_bookmark", "N", "Next bookmark"),
    _once("Camera", "copy_camera", "Ctrl+C", "Copy the camera as JSON"),
    _once("Camera", "paste_camera", "Ctrl+V", "Go to the camera on the clipboard"),
    _once("Navigation", "navigate_orbit", "F2", "Orbit: turn about a point, horizon level"),
    _once("Navigation", "navigate_fly", "F3", "Fly: look around and move freely"),
    _once("Navigation", "navigate_trackball", "F4", "Trackball: turn the scene like a ball"),
    _once("Navigation", "next_navigation", "V", "Next of orbit, fly and trackball"),
    *(_once("Picture", f"mode_{m.name}", m.key, f"{m.label}: {m.tip}") for m in MODES.values()),
    _once("Picture", "open_background", "", "Background: open an equirectangular picture"),
    _once("File", "export", "Ctrl+E", "Export the edited scene"),
    _once("File", "save_recipe", "Ctrl+S", "Save what was done as a recipe"),
    _once("File", "replay_recipe", "Ctrl+R", "Do the steps of a recipe"),
    _once("File", "merge", "Ctrl+M", "Merge another scene into this one, as a step of editing"),
    _once("File", "split", "Ctrl+Shift+E", "Move the selection to a file of its own"),
    _once("Edit", "duplicate", "Ctrl+D", "Make a copy of the selected splats"),
    _once("Edit", "undo", "Ctrl+Z", "Undo"),
    _once("Edit", "redo", "Ctrl+Shift+Z Ctrl+Y", "Redo"),
    _once("Edit", "delete", "Delete Backspace", "Delete the selected splats"),
    _once("Edit", "hide", "J", "Hide the selected splats"),
    _once("Edit", "show", "Shift+J", "Show all hidden splats again"),
    _once("Edit", "isolate", "Shift+I", "Hide all but the selected splats"),
    _once("Edit", "lock", "K", "Lock the selected splats: seen, but not to be changed"),
    _once("Edit", "unlock", "Shift+K", "Unlock all locked splats"),
    _once("Select", "select_all", "Ctrl+A", "Select all"),
    _once("Select", "select_none", "Ctrl+Shift+A", "Select none"),
    _once("Select", "select_inverse", "Ctrl+I", "Invert the selection"),
    _once("Select", "tool_rectangle", "R", "Rectangle: select what is inside"),
    _once("Select", "tool_brush", "C", "Brush: paint a selection"),
    _once("Select", "tool_lasso", "O", "Lasso: draw around what to select"),
    _once("Select", "tool_polygon", "P", "Polygon: click corners around what to select"),
    _once("Select", "tool_flood", "G", "Magic wand: select what hangs together and has one colour"),
    _once("Select", "tool_colour", "I", "Eyedropper: select everything of one colour"),
    _once("Select", "next_depth", "T", "Screen tools: through everything, or the front surface only"),
    _once("Select", "larger_brush", "Shift+]", "Larger brush"),
    _once("Select", "smaller_brush", "Shift+[", "Smaller brush"),
    _once("Edit", "tool_measure", "M", "Measure the distance between two points"),
    _once("Select", "grow", "", "Grow the selection by its neighbours"),
    _once("Select", "shrink", "", "Shrink the selection by one layer"),
    _once("Edit", "add_box", "", "Add a crop box"),
    _once("Edit", "add_sphere", "", "Add a crop sphere"),
    _once("Edit", "delete_cropped", "", "Delete what the crops cut away"),
    _once("Edit", "tool_ground", "", "Set the scene on the ground by picking three points of it"),
    *(
        _once("Edit", f"find_{name}", "", f"Clean up: find {detector.label.lower()}")
        for name, detector in DETECTORS.items()
    ),
    _once("Window", "toggle_palette", "Ctrl+P", "Find a command by its name"),
    _once("Training", "pause_training", "Space", "Pause or resume training"),
    _once("Training", "step_training", "Period", "Train one step, then pause"),
    _once("Window", "toggle_panels", "H", "Hide or show the panels"),
    _once("Window", "toggle_help", "F1", "Show or hide this page"),
    _once("Window", "cancel", "Escape", "Cancel loading, close what is open"),
    _held("forward", "W Up", "Forward"),
    _held("back", "S Down", "Back"),
    _held("left", "A Left", "Left"),
    _held("right", "D Right", "Right"),
    _held("up", "E", "Up"),
    _held("down", "Q", "Down"),
)

HELD_DIRECTIONS: dict[str, tuple[float, float, float]] = {
    "forward": (0, 0, 1),
    "back": (0, 0, -1),
    "left": (-1, 0, 0),
    "right": (1, 0, 0),
    "up": (0, 1, 0),
    "down": (0, -1, 0),
}
"""(right, up, forward) of the camera for each held shortcut."""

FAST, SLOW = "Shift", "Alt"
"""Modifiers of the held keys; Ctrl is left to the commands."""

MOUSE: tuple[tuple[str, str], ...] = (
    ("Left drag", "Turn: orbit, look around or roll the ball"),
    ("Right or middle drag", "Pan: the scene moves with the mouse"),
    ("Shift + left drag", "Pan, too"),
    ("Wheel", "Nearer and farther; when flying: slower and faster"),
    ("Double click", "Turn about the surface under the mouse"),
    ("Drop a file", "Open it; several files are merged"),
)
"""What the help page says about the mouse; `input` is where it happens."""


def keys_of(action: str) -> str:
    """The first key of an action as menus show it; "" where it has none."""
    return next((s.keys[0] for s in SHORTCUTS if s.action == action and s.keys), "")


def text_of(action: str) -> str:
    """What an action does, in a few words."""
    return next(s.text for s in SHORTCUTS if s.action == action)


# ---- From the shortcut table's key names to ImGui's key chords, and back to what was pressed.


_NAMED = {
    "[": imgui.Key.left_bracket,
    "]": imgui.Key.right_bracket,
    "Up": imgui.Key.up_arrow,
    "Down": imgui.Key.down_arrow,
    "Left": imgui.Key.left_arrow,
    "Right": imgui.Key.right_arrow,
    "PageUp": imgui.Key.page_up,
    "PageDown": imgui.Key.page_down,
    "Home": imgui.Key.home,
    "Escape": imgui.Key.escape,
    "Delete": imgui.Key.delete,
    "Backspace": imgui.Key.backspace,
}
_MODIFIERS = {"Ctrl": imgui.Key.mod_ctrl, "Shift": imgui.Key.mod_shift, "Alt": imgui.Key.mod_alt}


@cache
def chord(text: str) -> int:
    """ImGui's key chord of "Ctrl+Shift+O"; on macOS ImGui itself takes Cmd for Ctrl."""
    *modifiers, name = text.split("+")
    value = int(_key(name))
    for modifier in modifiers:
        value |= int(_MODIFIERS[modifier])
    return value


def _key(name: str) -> imgui.Key:
    if name in _NAMED:
        return _NAMED[name]
    return getattr(imgui.Key, f"_{name}" if name.isdigit() else name.lower())


def post_pressed(app: AppState) -> None:
    """Posts the action of every shortcut pressed in this frame.

    None while the user is typing, and only the way out while a menu or question is open.
    """
    if imgui.get_io().want_text_input:
        return
    asked = imgui.is_popup_open("", imgui.PopupFlags_.any_popup)
    for shortcut in SHORTCUTS:
        if asked and shortcut.action != "cancel":
            continue
        if not shortcut.held and any(imgui.is_key_chord_pressed(chord(key)) for key in shortcut.keys):
            app.post(ACTIONS[shortcut.action])


def held_step() -> tuple[float, float, float] | None:
    """(right, up, forward) of the held keys, times 4 when fast and 1/4 when slow; None where none is."""
    io = imgui.get_io()
    if io.want_text_input or io.key_ctrl or imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        return None
    step = [0.0, 0.0, 0.0]
    any_down = False
    for shortcut in SHORTCUTS:
        if shortcut.held and any(imgui.is_key_down(_key(key)) for key in shortcut.keys):
            any_down = True
            for i, part in enumerate(HELD_DIRECTIONS[shortcut.action]):
                step[i] += part
    if not any_down:
        return None
    factor = 4.0 if _down(FAST) else 0.25 if _down(SLOW) else 1.0
    return step[0] * factor, step[1] * factor, step[2] * factor


def _down(modifier: str) -> bool:
    io = imgui.get_io()
    return {"Shift": io.key_shift, "Alt": io.key_alt, "Ctrl": io.key_ctrl}[modifier]
