"""The one table of keys: bindings, menus and the help page all read it."""

from __future__ import annotations

from dataclasses import dataclass

from ...edit.detecting import DETECTORS


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
    _once("Picture", "mode_splats", "1", "Splats: the picture itself"),
    _once("Picture", "mode_points", "2", "Points: a dot for each splat's centre"),
    _once("Picture", "mode_ellipsoids", "3", "Ellipsoids: the splats as solid bodies"),
    _once("Picture", "mode_depth", "4", "Depth: near is bright"),
    _once("Picture", "mode_overdraw", "5", "Overdraw: how many splats each pixel costs"),
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
