"""The commands of the window: one table that keys, menus, the palette, buttons and the help page read.

A command is added here and nowhere else. Functions take the `AppState` first and are posted to it, so that
they run on the GL thread between frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal, get_args

from imgui_bundle import imgui

from splatview.edit.detectors import DETECTORS
from splatview.edit.operations.select import Grow, Shrink
from splatview.renderers import MODES, VisualMode
from splatview.viewer import background, camera, depth_of_field, first_views, sequence, view_aids
from splatview.viewer import open as opening
from splatview.viewer import save as pictures
from splatview.viewer.command import Command, needs
from splatview.viewer.depth_of_field import DepthOfField
from splatview.viewer.editing import cleanup, exporting, files, saving, scene_files
from splatview.viewer.editing import commands as editing
from splatview.viewer.editing.session import at_rest, can_edit, session_of
from splatview.viewer.entries import ENTRIES, FILM, reset_panels, toggle_panels
from splatview.viewer.key_presets import Preset, use
from splatview.viewer.navigation import AXIS_NAMES, level
from splatview.viewer.preferences import NavigationMode, PlayMode
from splatview.viewer.sequence import Sequences
from splatview.viewer.state import AppState
from splatview.viewer.training import live as training
from splatview.viewer.training import start
from splatview.viewer.training.live import LiveTraining
from splatview.viewer.view_aids import ViewAids

NAVIGATION_MODES: tuple[NavigationMode, ...] = get_args(NavigationMode)

AXIS_KEYS = ("X", "Shift+X", "Y", "Shift+Y", "Z", "Shift+Z")
"""Key of the view along each of AXIS_NAMES."""


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


def set_dialog(app: AppState, name: str) -> None:
    app.dialog = name


def cancel(app: AppState) -> None:
    """Ends whatever is open or under way, one thing at a time."""
    if app.problem:
        app.problem = None
    elif app.dialog:
        app.dialog = None
    elif app.loading:
        opening.cancel_loading(app)
    else:
        any(feature.cancel(app) for feature in app.features.values())


def quit_window(app: AppState) -> None:
    """Closes the window, after asking where edits are in no file."""
    app.leave(_end)


def _end(app: AppState) -> None:
    app.quitting = True


def _has(part: Literal["counts", "history"], name: str, otherwise: str) -> Callable[[AppState], str]:
    """Whether the document has any `name` in a part of it."""

    def check(app: AppState) -> bool:
        session = session_of(app)
        return session is not None and bool(getattr(getattr(session.document, part), name))

    return needs(check, otherwise)


_a_scene = needs(can_edit, "Open a scene first")
_a_scene_at_rest = needs(at_rest, "Open a scene first; one in training has to be stopped and saved")
_a_selection = _has("counts", "selected", editing.SELECT_FIRST)
_cameras = needs(lambda app: bool(app.cameras), "Load cameras first")


def _in_sequence(app: AppState) -> bool:
    return app.feature(Sequences).player is not None


def _not_in_sequence(app: AppState) -> bool:
    return not _in_sequence(app)


_a_sequence = needs(_in_sequence, "Open a folder of scenes first")


DETECTOR_WORDS = {
    "clusters": ("floaters", "isolated clusters"),
    "sparse": ("density", "density outliers"),
    "needles": ("spikes", "long splats"),
    "giants": ("large splats", "big splats"),
    "faint": ("low opacity", "transparent splats"),
    "unseen": ("invisible", "occluded"),
    "broken": ("nan", "undrawable"),
    "duplicates": ("doubles",),
}
"""What else people call what a detector finds."""


def _tool(
    group: str,
    name: editing.ToolName,
    keys: str,
    title: str,
    *words: str,
    lacks: Callable[[AppState], str] = _a_scene,
) -> Command:
    def in_hand(app: AppState) -> bool:
        session = session_of(app)
        return session.tool == name if session is not None else name == "none"

    return Command(
        id=f"tool_{name}",
        title=title,
        group=group,
        run=editing.put_tool_back if name == "none" else partial(editing.take_tool, tool=name),
        keys=tuple(keys.split()),
        words=words,
        lacks=lacks,
        checked=in_hand,
    )


def _selects_front(app: AppState) -> bool:
    session = session_of(app)
    return session is not None and session.depth == "front"


def _shows_something_else(app: AppState) -> bool:
    live = app.find(LiveTraining)
    return live is not None and not live.followed_by(app)


def _command(
    group: str,
    id: str,
    keys: str,
    title: str,
    run: Callable[[AppState], object],
    menu: str = "",
    **more: Any,
) -> Command:
    return Command(id=id, title=title, group=group, run=run, keys=tuple(keys.split()), menu=menu, **more)


_file, _recipe, _camera, _navigation, _picture, _edit, _select, _sequence, _training, _window = (
    partial(_command, group)
    for group in (
        *("File", "Recipe", "Camera", "Navigation", "Picture", "Edit", "Select"),
        *("Sequence", "Training", "Window"),
    )
)


def _of_sequence(
    id: str, keys: str, title: str, run: Callable[[AppState], object], menu: str = "", **more: Any
) -> Command:
    """A command for which a sequence must be open."""
    return _sequence(id, keys, title, run, menu, lacks=_a_sequence, when=_in_sequence, **more)


def _play_mode(mode: PlayMode, title: str) -> Command:
    return _of_sequence(
        f"play_{mode}",
        "",
        title,
        partial(sequence.set_mode, mode=mode),
        mode.capitalize(),
        checked=lambda app: app.preferences.play_mode == mode,
    )


def _navigation_mode(mode: NavigationMode, keys: str, title: str) -> Command:
    name = mode.capitalize()
    return _navigation(
        f"navigate_{mode}",
        keys,
        f"{name}: {title}",
        partial(navigate, mode=mode),
        name,
        checked=lambda app: app.preferences.navigation == mode,
    )


# fmt: off
COMMANDS: dict[str, Command] = {
    command.id: command
    for command in (
        _file("open", "Ctrl+O", "Open a scene", opening.choose_scene, "Open...",
            words=("open", "load")),
        _file("open_folder", "", "Open a folder of scenes as a sequence", opening.choose_folder,
            "Open a folder...", words=("sequence", "frames", "4d", "directory")),
        _file("import", "Ctrl+Shift+O Ctrl+M", "Import: add other files to this scene, a row each",
            files.choose_import, "Import...", words=("import", "append", "merge", "combine", "add file"),
            lacks=_a_scene_at_rest),
        _file("recent", "", "Recent: open a scene that was open before",
            partial(toggle_dialog, name="recent"),
            words=("open recent", "last files"),
            lacks=needs(lambda app: bool(app.preferences.recent), "No scene was opened before")),
        _file("reload", "F5", "Read the scene's files again", opening.reload,
            lacks=needs(lambda app: app.scene_path is not None, "Open a file first")),
        _file("open_cameras", "Ctrl+L", "Load a list of cameras", camera.choose_cameras, "Load cameras..."),
        _file("screenshot", "F12", "Save a picture beside the scene", pictures.screenshot, "Save a picture",
            words=("screenshot", "snapshot", "png")),
        _file("screenshot_as", "Ctrl+F12", "Save a picture, choosing size and place",
            partial(toggle_dialog, name="screenshot"), "Save a picture as..."),
        _file("quit", "Ctrl+Q", "Quit", quit_window),
        _file("export", "Ctrl+E", "Export the edited scene", exporting.open_dialog,
            "Export the edited scene...", words=("export", "write", "convert"), lacks=_a_scene),
        _file("save", "Ctrl+S", "Save the scene", saving.save, "Save", lacks=_a_scene,
            words=("save", "store", "keep", "overwrite")),
        _file("save_as", "Ctrl+Shift+S", "Save the scene under another name", saving.save_as, "Save as...",
            lacks=_a_scene, words=("save as", "rename", "copy")),
        _recipe("save_recipe", "Ctrl+Alt+S", "Save what was done as a recipe", files.choose_recipe_to_save,
            "Save recipe...", lacks=_a_scene_at_rest, words=("macro", "script", "batch")),
        _recipe("replay_recipe", "Ctrl+R", "Apply a recipe: do its steps", files.choose_recipe_to_replay,
            "Apply recipe...", lacks=_a_scene_at_rest, words=("load recipe", "replay")),
        *(
            _file(f"file_{id}", "", f"File of the scene: {title}", run, words=words,
                lacks=partial(scene_files.lacks, unlocked=unlocked))
            for id, title, run, unlocked, words in scene_files.COMMANDS
        ),
        _file("split", "Ctrl+Shift+E", "Move the selection to a file of its own", files.choose_split,
            "Selection to its own file...", lacks=lambda app: _a_selection(app) or _a_scene_at_rest(app)),
        _file("start_screen", "", "Start screen: open, train, recent scenes, demo",
            partial(toggle_dialog, name="start"), "Start screen",
            words=("recent", "recent files", "welcome")),
        _file("train_photos", "", "Train on photos: a folder with their cameras", start.choose_photos,
            "Train on photos...", words=("train on photos", "new training", "capture"),
            lacks=lambda app: app.feature(start.TrainingStart).lacks),
        _file("demo", "", "Open the demo scene", opening.begin_demo, "Demo scene",
            words=("demo", "example", "sample")),
        _camera("frame_selection", "F", "Show what is selected, else the whole scene",
            camera.frame_selection),
        _camera("home_view", "Shift+Home", "Home view: the scene's front, filling the picture",
            first_views.go_home, "Front of the scene",
            words=("front", "first view", "reset view", "default view"),
            lacks=needs(lambda app: app.is_open, "Open a scene first")),
        _camera("frame_all", "Home", "Show the whole scene", camera.frame_all),
        *(
            _camera(f"look_from_{name}", key, f"Look from {name}", partial(camera.look_along, name=name),
            name)
            for name, key in zip(AXIS_NAMES, AXIS_KEYS, strict=True)
        ),
        _camera("level", "L", "Make the horizon level", camera.make_level),
        *(
            _camera(f"up_{name}", "", f"Up: {name}", partial(camera.set_up, name=name), name,
                checked=lambda app, name=name: camera.up_name(app.view) == name)
            for name in camera.UP_NAMES
        ),
        _camera("roll_left", "", "Turn the view by 90 degrees to the left, and its up axis with it",
            partial(view_aids.roll, degrees=-90.0), "View 90° to the left", words=("roll",)),
        _camera("roll_right", "", "Turn the view by 90 degrees to the right, and its up axis with it",
            partial(view_aids.roll, degrees=90.0), "View 90° to the right"),
        *(
            _edit(f"turn_scene_{name}", "", f"Turn the scene by 90 degrees about {name}",
                partial(view_aids.turn_scene, name=name), f"Scene 90° about {name}", lacks=_a_scene)
            for name in AXIS_NAMES
        ),
        _camera("next_up", "U", "Next up axis: +Y, -Y, +Z, -Z, +X, -X", camera.next_up, "Next",
            words=("up", "up axis", "upside down")),
        _camera("up_from_view", "Shift+U", "Take what is up in the picture as the up axis",
            camera.up_from_view,
            "What is up in the picture"),
        _camera("toggle_orthographic", "Shift+P", "Orthographic: parallel rays, or perspective again",
            camera.toggle_orthographic, "Orthographic",
            checked=lambda app: app.destination.lens.orthographic),
        _camera("toggle_lenses", "Shift+L", "Look through the lenses of loaded cameras, or without",
            camera.toggle_lenses, "Camera lenses",
            lacks=needs(lambda app: any(camera.lens is not None for camera in app.cameras),
                "Load cameras with lenses first"),
            checked=lambda app: app.through_lenses),
        _camera("depth_of_field", "Shift+B", "Depth of field on or off", depth_of_field.switch,
            "Depth of field", words=("dof",), checked=lambda app: app.feature(DepthOfField).on),
        _camera("focus_by_click", "Shift+C", "Depth of field: click what shall be sharp",
            depth_of_field.focus_by_click, "Focus by click", words=("focus", "sharp")),
        _camera("narrower", "]", "Narrower field of view", partial(camera.change_fov,
            factor=1 / camera.FOV_STEP)),
        _camera("wider", "[", "Wider field of view", partial(camera.change_fov, factor=camera.FOV_STEP)),
        _camera("next_camera", "PageDown", "Next loaded camera", partial(camera.step_camera, step=1),
            lacks=_cameras),
        _camera("previous_camera", "PageUp", "Previous loaded camera",
            partial(camera.step_camera, step=-1), lacks=_cameras),
        _camera("add_bookmark", "B", "Bookmark this view", camera.add_bookmark),
        _camera("next_bookmark", "N", "Next bookmark",
            lambda app: camera.go_to_bookmark(app, app.bookmark_index + 1),
            lacks=needs(lambda app: bool(app.bookmarks), "Bookmark a view first")),
        _camera("copy_camera", "Ctrl+C", "Copy the camera as JSON", camera.copy_camera),
        _camera("paste_camera", "Ctrl+V", "Go to the camera on the clipboard", camera.paste_camera),
        _navigation_mode("orbit", "F2", "turn about a point, horizon level"),
        _navigation_mode("fly", "F3", "look around and move freely"),
        _navigation_mode("trackball", "F4", "turn the scene like a ball"),
        _navigation("next_navigation", "V", "Next of orbit, fly and trackball", next_navigation),
        *(
            _picture(f"mode_{mode.name}", mode.key, f"{mode.label}: {mode.tip}",
                partial(set_mode, mode=mode.name), checked=lambda app, name=mode.name: app.mode == name)
            for mode in MODES.values()
        ),
        _picture("toggle_grid", "Shift+G", "Ground grid: show or hide it", view_aids.toggle_grid,
            "Ground grid", words=("grid", "floor", "ground"), checked=lambda app: app.preferences.show_grid),
        _picture("toggle_axes", "Ctrl+G", "Axes of the world: show or hide them", view_aids.toggle_axes,
            "Axes", words=("axes", "axis", "origin", "xyz"), checked=lambda app: app.preferences.show_axes),
        _picture("toggle_centres", "Shift+M", "Centres of the splats over the picture",
            view_aids.toggle_centres, "Centres", words=("centers", "dots"),
            checked=lambda app: app.feature(ViewAids).centres),
        _picture("toggle_rings", "Shift+R", "Rings: outlines of the splats over the picture",
            view_aids.toggle_rings, "Rings", words=("outlines", "ellipses"),
            checked=lambda app: app.feature(ViewAids).rings),
        _picture("open_background", "", "Panorama: open an equirectangular picture behind the scene",
            background.ask_for_picture),
        _edit("duplicate", "Ctrl+D", "Duplicate the selected splats",
            editing.operation_on_selection("duplicate"), "Duplicate", words=("copy splats", "clone"),
            lacks=lambda app: _a_selection(app) or _a_scene_at_rest(app)),
        _edit("undo", "Ctrl+Z", "Undo", editing.undo, lacks=_has("history", "can_undo", "Nothing to undo")),
        _edit("redo", "Ctrl+Shift+Z Ctrl+Y", "Redo", editing.redo,
            lacks=_has("history", "can_redo", "Nothing to redo")),
        _edit("delete", "Delete Backspace", "Delete the selected splats",
            editing.operation_on_selection("delete"), "Delete",
            words=("remove", "erase"), lacks=_a_selection),
        _edit("hide", "J", "Hide the selected splats", editing.operation_on_selection("hide"), "Hide",
            words=("hide",), lacks=_a_selection),
        _edit("show", "Shift+J", "Show all hidden splats again", editing.operation("show"),
            lacks=_has("counts", "hidden", "Nothing is hidden")),
        _edit("isolate", "Shift+I", "Isolate: hide all but the selected splats",
            editing.operation_on_selection("isolate"), "Isolate", words=("solo",), lacks=_a_selection),
        _edit("lock", "K", "Lock the selected splats: seen, but not to be changed",
            editing.operation_on_selection("lock"), lacks=_a_selection),
        _edit("unlock", "Shift+K", "Unlock all locked splats", editing.operation("unlock"),
            lacks=_has("counts", "locked", "Nothing is locked")),
        _select("select_all", "Ctrl+A", "Select all", editing.operation("select_all"), lacks=_a_scene),
        _select("select_none", "Ctrl+Shift+A", "Select none", editing.operation("select_none"),
            lacks=_has("counts", "selected", "Nothing is selected")),
        _select("select_inverse", "Ctrl+I", "Invert the selection", editing.operation("select_inverse"),
            lacks=_a_scene),
        _tool("Select", "none", "Shift+0", "Navigate: put the tool back", "cursor", "no tool"),
        _tool("Select", "rectangle", "R", "Rectangle: select what is inside", "box select", "marquee"),
        _tool("Select", "brush", "C", "Brush: paint a selection", "paint"),
        _tool("Select", "lasso", "O", "Lasso: draw around what to select", "freehand"),
        _tool("Select", "polygon", "P", "Polygon: click corners around what to select"),
        _tool("Select", "flood", "G", "Magic wand: select what hangs together and has one colour",
            "wand", "flood fill"),
        _tool("Select", "colour", "I", "Eyedropper: select everything of one colour", "pipette",
            "colour picker"),
        _tool("Edit", "move", "Shift+1", "Move: drag arrows on the picture", "gizmo", "translate", "handles",
            "position", lacks=_a_scene_at_rest),
        _tool("Edit", "rotate", "Shift+2", "Rotate: drag rings on the picture", "rotate", "turn",
            "rotation", lacks=_a_scene_at_rest),
        _tool("Edit", "scale", "Shift+3", "Scale: drag handles on the picture", "scale", "resize",
            lacks=_a_scene_at_rest),
        _tool("Edit", "crop_box", "Shift+4", "Crop box: show only what is inside a box", "crop", "box",
            "clip"),
        _tool("Edit", "crop_sphere", "Shift+5", "Crop sphere: show only what is inside a sphere", "sphere"),
        _select("next_depth", "T", "Screen tools: through everything, or the front surface only",
            editing.next_depth, "Only the front surface", lacks=_a_scene, checked=_selects_front),
        _select("larger_brush", "Shift+]", "Larger brush",
            partial(editing.scale_brush, factor=editing.BRUSH_STEP)),
        _select("smaller_brush", "Shift+[", "Smaller brush",
            partial(editing.scale_brush, factor=1 / editing.BRUSH_STEP)),
        _tool("Edit", "measure", "M", "Measure the distance between two points", "measure",
            "ruler", "distance", "tape measure"),
        _select("grow", "", "Grow the selection by its neighbours",
            partial(editing.grow_or_shrink, operation=Grow(neighbours=editing.NEIGHBOURS)),
            lacks=_a_selection),
        _select("shrink", "", "Shrink the selection by one layer",
            partial(editing.grow_or_shrink, operation=Shrink(neighbours=editing.NEIGHBOURS)),
            lacks=_a_selection),
        _edit("add_box", "", "Add a crop box", partial(editing.add_crop, shape="box"),
            lacks=_a_scene),
        _edit("add_sphere", "", "Add a crop sphere", partial(editing.add_crop, shape="sphere"),
            lacks=_a_scene),
        _edit("delete_cropped", "", "Delete what the crops cut away", editing.operation("delete_cropped")),
        _edit("turn_over", "", "Turn the scene over: upside down, as files of another frame are",
            editing.turn_over, "Turn over", words=("turn over", "flip the scene", "y up", "rub", "rdf"),
            lacks=_a_scene_at_rest),
        _tool("Edit", "ground", "", "Set the scene on the ground by picking three points of it"),
        *(
            _edit(f"find_{name}", "", f"Find {detector.label.lower()}", partial(cleanup.find, detector=name),
                tip=detector.what, words=DETECTOR_WORDS.get(name, ()), lacks=_a_scene)
            for name, detector in DETECTORS.items()
        ),
        _window("toggle_palette", "Ctrl+P", "Find a command by its name",
            partial(toggle_dialog, name="palette")),
        _of_sequence("play", "Space", "Play or pause the sequence", sequence.play_or_pause, "Play",
            words=("play", "pause", "timeline", "playback"),
            checked=lambda app: app.feature(Sequences).playing),
        _of_sequence("next_frame", "Period", "Next frame of the sequence", partial(sequence.step, by=1),
            "Next frame", words=("forward",)),
        _of_sequence("previous_frame", "Comma", "Previous frame of the sequence",
            partial(sequence.step, by=-1), "Previous frame", words=("backward",)),
        _of_sequence("first_frame", "Shift+Comma", "First frame of the sequence",
            partial(sequence.go_to_end, last=False), "First frame", words=("first frame",)),
        _of_sequence("last_frame", "Shift+Period", "Last frame of the sequence",
            partial(sequence.go_to_end, last=True), "Last frame", words=("last frame",)),
        _play_mode("loop", "Loop: play the sequence again from its first frame"),
        _play_mode("bounce", "Bounce: play the sequence forwards and backwards"),
        _play_mode("once", "Once: stop at the last frame of the sequence"),
        *(
            _of_sequence(f"rate_{fps}", "", f"Frame rate: {fps} frames a second",
                partial(sequence.set_rate, fps=fps), f"{fps} frames a second",
                checked=lambda app, fps=fps: app.preferences.frame_rate == fps)
            for fps in sequence.USUAL_RATES
        ),
        _of_sequence("merge_frames", "", "Merge all frames of the sequence into one scene",
            sequence.merge_frames, "Merge all frames into one scene"),
        _of_sequence("discard_frame_edits", "", "Discard the edits of this frame", sequence.discard_edits,
            "Discard this frame's edits", words=("revert",)),
        _training("pause_training", "Space", "Pause or resume training", training.pause_or_resume, "Pause",
            when=_not_in_sequence),
        _training("step_training", "Period", "Train one step, then pause", training.step_once, "One step",
            when=_not_in_sequence),
        _training("stop_training", "", "Pause training, and save scene and checkpoint",
            training.stop_and_save, "Stop and save"),
        _training("export_training", "", "Export the scene in training", training.export, "Export .ply..."),
        _training("save_checkpoint", "", "Save a checkpoint of the training", training.save_checkpoint,
            "Save a checkpoint"),
        _training("evaluate_training", "", "Measure the held-out photos", training.evaluate),
        _training("show_training", "", "Show the scene in training", training.show_training,
            lacks=needs(_shows_something_else, "It is what is shown")),
        *FILM,
        *ENTRIES,
        _window("toggle_panels", "H", "Only the picture, or the panels again", toggle_panels,
            "Only the picture", words=("hide panels", "clean view"),
            checked=lambda app: app.panels_hidden),
        _window("reset_panels", "", "Reset layout: inspector and strip as in a new window", reset_panels,
            "Reset layout", words=("reset", "layout", "panels")),
        _window("settings", "Ctrl+Comma", "Settings", partial(toggle_dialog, name="settings"), "Settings...",
            words=("settings", "preferences", "options")),
        _window("theme", "", "Theme: dark, light or high contrast", partial(set_dialog, name="settings"),
            words=("theme", "dark mode", "light mode")),
        _window("font", "", "Font size", partial(set_dialog, name="settings"),
            words=("font", "text size")),
        _window("keys", "", "Keys and mouse as in SuperSplat, Blender or Unreal",
            partial(set_dialog, name="settings"),
            words=("key presets", "supersplat", "blender", "unreal", "touchpad", "gestures")),
        _window("toggle_help", "F1", "Keys and mouse: show or hide this page",
            partial(toggle_dialog, name="help"), "Keys and mouse",
            words=("help", "keys", "shortcuts", "hotkeys")),
        _window("cancel", "Escape", "Cancel loading, close what is open", cancel),
    )
}
"""By id, in the order of the palette and the help page; with the keys of the preset in force."""
# fmt: on

DEFAULTS = dict(COMMANDS)
"""The commands with their own keys."""

_not_flying: set[str] = set()
"""Keys that the preset in force gives to commands, though they would fly."""


def use_keys(preset: Preset) -> None:
    """Gives the table the keys of `preset`."""
    _not_flying.clear()
    _not_flying.update(use(COMMANDS, DEFAULTS, preset))


@dataclass(frozen=True, kw_only=True)
class HeldKeys:
    """Keys that move the eye as long as one of them is down."""

    title: str
    keys: tuple[str, ...]
    direction: tuple[float, float, float]
    """(right, up, forward) of the camera."""


HELD_KEYS = (
    HeldKeys(title="Forward", keys=("W", "Up"), direction=(0, 0, 1)),
    HeldKeys(title="Back", keys=("S", "Down"), direction=(0, 0, -1)),
    HeldKeys(title="Left", keys=("A", "Left"), direction=(-1, 0, 0)),
    HeldKeys(title="Right", keys=("D", "Right"), direction=(1, 0, 0)),
    HeldKeys(title="Up", keys=("E",), direction=(0, 1, 0)),
    HeldKeys(title="Down", keys=("Q",), direction=(0, -1, 0)),
)

FAST, SLOW = "Shift", "Alt"
"""Modifiers of the held keys; Ctrl is left to the commands."""

MOUSE: tuple[tuple[str, str], ...] = (
    ("Wheel", "Nearer and farther; when flying: slower and faster"),
    ("Double click", "Turn about the surface under the mouse"),
    ("Drop a file", "Open it; several files are merged"),
)
"""Use of the mouse besides drags, for the help page; `viewer.viewport` implements it."""


def keys_of(id: str) -> str:
    """The first key of a command as menus show it; "" where it has none."""
    return next(iter(COMMANDS[id].keys), "")


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
    if name.startswith("Keypad"):
        rest = name.removeprefix("Keypad")
        return getattr(imgui.Key, f"keypad{rest}" if rest.isdigit() else f"keypad_{rest.lower()}")
    return getattr(imgui.Key, f"_{name}" if name.isdigit() else name.lower())


def post_pressed(app: AppState) -> None:
    """Posts every command whose key is pressed in this frame; an open menu closes then, and Escape does no
    more than that. None while the user is typing, and only the way out while a question is open."""
    if imgui.get_io().want_text_input:
        return
    asked = under_question()
    pressed = [
        command
        for command in ((COMMANDS["cancel"],) if asked else COMMANDS.values())
        if any(imgui.is_key_chord_pressed(chord(key)) for key in command.keys) and command.when(app)
    ]
    if pressed and not asked and imgui.is_popup_open("", imgui.PopupFlags_.any_popup):
        imgui.internal.close_popups_except_modals()
        pressed = [command for command in pressed if command.id != "cancel"]
    for command in pressed:
        app.post(command.run)


def under_question() -> bool:
    """Whether a dialog waits for its answer before anything else."""
    return imgui.internal.get_top_most_popup_modal() is not None


def held_step() -> tuple[float, float, float] | None:
    """(right, up, forward) of the held keys, times 4 when fast and 1/4 when slow; None where none is."""
    io = imgui.get_io()
    if io.want_text_input or io.key_ctrl or under_question():
        return None
    down = [
        held.direction
        for held in HELD_KEYS
        if any(imgui.is_key_down(_key(key)) for key in held.keys if key not in _not_flying)
    ]
    if not down:
        return None
    modifiers = {"Shift": io.key_shift, "Alt": io.key_alt}
    factor = 4.0 if modifiers[FAST] else 0.25 if modifiers[SLOW] else 1.0
    x, y, z = (factor * sum(parts) for parts in zip(*down, strict=True))
    return x, y, z
