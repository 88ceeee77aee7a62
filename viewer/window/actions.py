"""What the user can ask for by name: keys, menus, buttons and the help page all end here.

Every function takes the `Core` first and is posted to it, so it runs on the GL thread between frames.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import get_args

import numpy as np

from ...scene import InputError
from ..gl import VisualMode
from . import backdrop, camera_list, depth_of_field, opening, saving
from .bookmarks import Bookmark, load_bookmarks, save_bookmarks
from .bounds import bounds
from .core import Core
from .editing.commands import EDIT_ACTIONS, cancel_job, take_tool
from .navigation import AXIS_NAMES, View, axis_view, focus, frame, level, pick, with_up
from .navigation.framing import axis
from .navigation.view import MAX_FOV, MIN_FOV
from .preferences import NavigationMode
from .training import actions as training
from .training.held import let_go

NAVIGATION_MODES: tuple[NavigationMode, ...] = get_args(NavigationMode)
VISUAL_MODES: tuple[VisualMode, ...] = get_args(VisualMode)
UP_NAMES = ("+Y", "-Y", "+Z", "-Z", "+X", "-X")
"""In the order in which one key goes through them: the likeliest first."""

FOV_STEP = 1.1
"""Factor on the angle for one press of a key."""


# ---- camera


def frame_all(core: Core) -> None:
    """Shows the whole scene from where the eye is turned; what is deleted or hidden does not count."""
    _frame(core, bounds(core))


def frame_selection(core: Core) -> None:
    """Shows what is selected, else the whole scene."""
    _frame(core, bounds(core, selected=True) or bounds(core))


def _frame(core: Core, found: tuple[np.ndarray, float] | None) -> None:
    if found is not None:
        width, height = core.picture_size
        core.go_to(frame(core.destination, *found, aspect=width / height))


def look_along(core: Core, name: str) -> None:
    core.go_to(axis_view(core.destination, name))


def make_level(core: Core) -> None:
    core.go_to(level(core.destination))


def set_up(core: Core, name: str) -> None:
    """Makes the world axis `name` the up axis, and the horizon level about it."""
    core.go_to(with_up(core.destination, axis(name)))
    core.tell(f"Up is {name}")


def next_up(core: Core) -> None:
    now = up_name(core.destination)
    set_up(core, UP_NAMES[(UP_NAMES.index(now) + 1) % len(UP_NAMES)] if now else UP_NAMES[0])


def up_name(view: View) -> str | None:
    """The world axis that is up, or None where it is oblique."""
    return next((name for name in UP_NAMES if float(axis(name) @ view.up) > 1 - 1e-6), None)


def up_from_view(core: Core) -> None:
    core.steer(replace(core.destination, up=-core.destination.R_camera_world[1]))
    core.tell("Up is what is up in this view")


def change_fov(core: Core, factor: float) -> None:
    lens = core.destination.lens
    fov_y = min(max(lens.fov_y * factor, MIN_FOV), MAX_FOV)
    core.go_to(replace(core.destination, lens=replace(lens, fov_y=fov_y)))


def toggle_orthographic(core: Core) -> None:
    """Parallel rays or a pinhole's; what is at the target's distance stays as large."""
    lens = replace(core.destination.lens, orthographic=not core.destination.lens.orthographic)
    core.steer(replace(core.destination, lens=lens))
    core.tell("Orthographic: rays are parallel" if lens.orthographic else "Perspective: rays meet in the eye")


def toggle_lenses(core: Core) -> None:
    """Shows the views of loaded cameras through their lenses, or as pinholes would."""
    core.through_lenses = not core.through_lenses
    chosen = core.cameras[core.camera_index] if 0 <= core.camera_index < len(core.cameras) else None
    lens = core.destination.lens
    if not core.through_lenses:
        core.steer(replace(core.destination, lens=replace(lens, distortion=None)))
        core.tell("Without lenses: views are those of pinholes")
    elif chosen is not None and chosen.lens is not None:
        core.steer(replace(core.destination, lens=replace(lens, distortion=chosen.lens, orthographic=False)))
        core.tell(f"Through the camera's lens, {chosen.lens.model}")
    else:
        core.tell("Through lenses, where the chosen camera has one")


def focus_at(core: Core, x: float, y: float) -> None:
    """Turns about the surface at (x, y) px of the visible area; without one there, nothing happens."""
    if not core.scene:
        return
    found = pick(core.scene.gaussians, core.camera, core.settings, x, y, edits=core.edits)
    if found is None:
        core.tell("Nothing to turn about there: the pixel shows the background")
        return
    core.go_to(focus(core.view, found.point))
    core.tell(f"Turning about splat {found.index:,}, {found.depth:.4g} units ahead")


# ---- bookmarks


def add_bookmark(core: Core) -> None:
    numbers = {bookmark.name for bookmark in core.bookmarks}
    number = next(n for n in range(1, len(numbers) + 2) if f"View {n}" not in numbers)
    core.bookmarks.append(Bookmark(name=f"View {number}", view=core.destination))
    core.bookmark_index = len(core.bookmarks) - 1
    keep_bookmarks(core)


def rename_bookmark(core: Core, index: int, name: str) -> None:
    if name.strip():
        core.bookmarks[index] = replace(core.bookmarks[index], name=name.strip())
        keep_bookmarks(core)


def delete_bookmark(core: Core, index: int) -> None:
    del core.bookmarks[index]
    core.bookmark_index = -1
    keep_bookmarks(core)


def go_to_bookmark(core: Core, index: int) -> None:
    if not core.bookmarks:
        core.tell("There are no bookmarks yet")
        return
    core.bookmark_index = index % len(core.bookmarks)
    core.go_to(core.bookmarks[core.bookmark_index].view)
    core.tell(f"Bookmark: {core.bookmarks[core.bookmark_index].name}")


def keep_bookmarks(core: Core) -> None:
    """Saves them, and says where."""
    if core.scene_path is None:
        core.tell("Bookmarks of the demo are not saved: it has no file to put them beside")
        return
    try:
        # What another window on the scene has added since stays, and a file that is damaged is not lost.
        core.bookmarks += [
            bookmark
            for bookmark in load_bookmarks(core.scene_path)
            if bookmark.entry not in core.bookmarks_read
        ]
        path = save_bookmarks(core.scene_path, core.bookmarks)
        core.bookmarks_read = frozenset(bookmark.entry for bookmark in load_bookmarks(core.scene_path))
    except (OSError, InputError) as error:
        core.complain(f"The bookmarks cannot be saved: {error}")
        return
    core.tell(f"Bookmarks saved in {path}")


# ---- modes and the window


def navigate(core: Core, mode: NavigationMode) -> None:
    core.prefer(navigation=mode)
    if mode != "trackball":
        core.go_to(level(core.destination))


def next_navigation(core: Core) -> None:
    index = NAVIGATION_MODES.index(core.preferences.navigation)
    navigate(core, NAVIGATION_MODES[(index + 1) % len(NAVIGATION_MODES)])


def set_mode(core: Core, mode: VisualMode) -> None:
    if core.picture and mode not in core.picture.modes:
        core.tell(f"{core.picture.name} cannot show {mode}")
        return
    core.mode = mode


def toggle_dialog(core: Core, name: str) -> None:
    core.dialog = None if core.dialog == name else name


def toggle_panels(core: Core) -> None:
    core.panels_hidden = not core.panels_hidden


def cancel(core: Core) -> None:
    """The way back from whatever is open or under way."""
    if core.problem:
        core.problem = None
    elif core.dialog:
        core.dialog = None
    elif core.depth_of_field.picking:
        core.depth_of_field.picking = False
    elif core.loading:
        opening.cancel_loading(core)
    elif core.desk and core.desk.job:
        cancel_job(core)
    elif core.desk and core.desk.tool != "none":
        take_tool(core, "none")
    elif core.desk and core.desk.trainee:
        let_go(core)


def quit_window(core: Core) -> None:
    core.quitting = True


ACTIONS: dict[str, Callable[[Core], None]] = {
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
    "next_bookmark": lambda core: go_to_bookmark(core, core.bookmark_index + 1),
    "copy_camera": camera_list.copy_camera,
    "paste_camera": camera_list.paste_camera,
    **{f"navigate_{mode}": partial(navigate, mode=mode) for mode in NAVIGATION_MODES},
    "next_navigation": next_navigation,
    "open_background": backdrop.ask_for_picture,
    **{f"mode_{mode}": partial(set_mode, mode=mode) for mode in VISUAL_MODES},
    "pause_training": training.pause_or_resume,
    "step_training": training.step_once,
    "toggle_panels": toggle_panels,
    "toggle_help": partial(toggle_dialog, name="help"),
    "toggle_palette": partial(toggle_dialog, name="palette"),
    **EDIT_ACTIONS,
    "cancel": cancel,
}
"""Every action that has a name in `shortcuts.SHORTCUTS`."""
