"""Commands on the view: framing, axes, field of view, focus, camera lists, the clipboard, bookmarks."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.camera import likely_ups
from splatview.scene.captures import read_poses
from splatview.scene.captures.colmap import find_colmap
from splatview.scene.captures.nerfstudio import find_transforms
from splatview.scene.edits import SELECTED, SceneEdits, bake, shown
from splatview.scene.errors import one_line
from splatview.scene.formats import load_cameras
from splatview.scene.formats.cameras import camera_values, is_orthographic, lens_of
from splatview.scene.formats.sequence import NERF
from splatview.scene.framing import SAMPLE, bulk
from splatview.scene.progress import Progress
from splatview.viewer.loading import Reading
from splatview.viewer.navigation import View, axis_view, focus, frame, level, pick, view_from_camera, with_up
from splatview.viewer.navigation.controllers import axis
from splatview.viewer.navigation.view import MAX_FOV, MIN_FOV
from splatview.viewer.preferences import Bookmark, load_bookmarks, save_bookmarks
from splatview.viewer.state import AppState, Feature

UP_NAMES = ("+Y", "-Y", "+Z", "-Z", "+X", "-X")
"""In the order in which one key goes through them: the likeliest first."""

FOV_STEP = 1.1
"""Factor on the angle for one press of a key."""

LEAST_CAMERAS_FOR_UP = 3
"""Fewer photos may all have been taken at a slant."""

LEAST_COMMON_UP = 0.5
"""Length of the mean of the cameras' ups from which on they have one in common."""


def bounds(app: AppState, *, selected: bool = False) -> tuple[np.ndarray, float] | None:
    """Centre (3,) float64 and radius > 0, world, of the bulk of all splats that are shown, or of the selected
    ones. None where there are none."""
    sample = shown_sample(app, selected=selected)
    return None if sample is None else bulk(sample)


def shown_sample(app: AppState, *, selected: bool = False) -> Gaussians | None:
    """Some of the splats that are shown, or of the selected ones, as they are after edits; None where there
    are none."""
    gaussians, edits = app.scene.gaussians, app.edits
    if not app.is_open or (selected and edits is None):
        return None
    if edits is None:
        return gaussians
    kept = shown(gaussians, edits)
    if selected:
        kept &= (edits.marks & SELECTED) != 0
    indices = np.flatnonzero(kept)
    if not len(indices):
        return None
    indices = indices[:: -(-len(indices) // SAMPLE)]
    sample = replace(gaussians, sh=gaussians.sh[:, :1], extras={}).take(indices)
    return bake(sample, SceneEdits(marks=edits.marks[indices], palette=edits.palette))


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
    if not app.is_open:
        return
    found = pick(app.scene.gaussians, app.camera, app.seen_settings, x, y, edits=app.edits)
    if found is None:
        app.tell("Nothing to turn about there: the pixel shows the background")
        return
    app.go_to(focus(app.view, found.point))
    app.tell(f"Turning about splat {found.index:,}, {found.depth:.4g} units ahead")


def go_to_camera(app: AppState, index: int) -> None:
    """Jumps to the loaded camera `index`, counted round the list."""
    if not app.cameras:
        app.tell("No cameras are loaded: File > Load a list of cameras")
        return
    app.camera_index = index % len(app.cameras)
    camera = app.cameras[app.camera_index]
    take_position(app, camera)
    app.tell(f"Camera {app.camera_index + 1} of {len(app.cameras)}: {camera.name or 'unnamed'}")


def step_camera(app: AppState, step: int) -> None:
    """Next or previous: the first step goes to the first or last camera."""
    go_to_camera(app, app.camera_index + step if app.camera_index >= 0 or step > 0 else -1)


def take_position(app: AppState, camera: Camera) -> None:
    """Looks as `camera` does; the turning point keeps its distance, the up axis stays."""
    width, height = app.picture_size
    view = app.destination
    if not app.through_lenses:
        camera = replace(camera, lens=None)
    app.go_to(view_from_camera(camera, distance=view.distance, up=view.up, width=width, height=height))


def copy_camera(app: AppState) -> None:
    """Puts the view on the clipboard in the form that `splatview render --camera` reads."""
    app.clipboard_write = camera_text(app.camera)
    app.tell("The camera is on the clipboard")


def paste_camera(app: AppState) -> None:
    try:
        camera = camera_from_text(app.clipboard_read())
    except ValueError as error:
        app.tell(f"There is no camera on the clipboard: {error}")
        return
    take_position(app, camera)


def camera_text(camera: Camera) -> str:
    """The camera as CAM.json has it."""
    return json.dumps(camera_values(camera))


def camera_from_text(text: str) -> Camera:
    """The camera that `text` describes.

    Raises:
        ValueError: it is no camera; the message says why.
    """
    try:
        data = json.loads(text)
        return Camera(
            width=int(data["width"]),
            height=int(data["height"]),
            fx=float(data["fx"]),
            fy=float(data["fy"]),
            cx=float(data["cx"]),
            cy=float(data["cy"]),
            world_to_camera=np.array(data["world_to_camera"], dtype=np.float64),
            lens=lens_of(data, "the clipboard"),
            orthographic=is_orthographic(data, "the clipboard"),
        )
    except json.JSONDecodeError:
        raise ValueError("it holds no JSON") from None
    except KeyError as error:
        raise ValueError(f"{error} is missing") from None
    except (TypeError, RecursionError, OverflowError):
        raise ValueError("it is not an object with the numbers of a camera") from None
    except ValueError as error:
        raise ValueError(one_line(str(error))) from None


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraList:
    """What a file of cameras holds."""

    cameras: list[Camera]
    up: np.ndarray | None
    """Their common up axis, see `common_up`."""
    notes: list[str]


@dataclass(frozen=True)
class _ToRead:
    """A file of cameras, and what to do with it; see `CameraLists.open`."""

    path: Path
    beside: bool = False
    jump: bool = True


class CameraLists(Feature):
    """Files of cameras on their way, one after another."""

    def __init__(self) -> None:
        self.reading: Reading[CameraList] | None = None
        self._waiting: list[_ToRead] = []
        self._asked = _ToRead(Path())

    def open(self, path: Path, *, beside: bool = False, jump: bool = True) -> None:
        """Reads `path` in the background. `beside`: it lies with the scene, and counts only if it is the
        scene's. `jump`: goes to one of the cameras then."""
        self._waiting.append(_ToRead(path, beside=beside, jump=jump))

    def before_frame(self, app: AppState) -> None:
        """Takes over a list that has been read, after the scene that was opened with it, and jumps to its
        first camera."""
        if self.reading is None and self._waiting:
            self._asked = self._waiting.pop(0)
            path = self._asked.path
            self.reading = Reading(path.name, partial(read_camera_list, path))
        reading = self.reading
        if reading is None or not reading.done or app.loading is not None:
            return
        self.reading, found = None, reading.result
        if reading.problem is not None:
            (app.tell if self._asked.beside else app.complain)(reading.problem)
        if found is None:
            return
        first = 0
        if self._asked.beside:
            centre = app.scene.centre
            first = next((i for i, camera in enumerate(found.cameras) if sees(camera, centre)), -1)
            if first < 0:
                app.tell(f"{reading.name} beside the scene is not used: none of its cameras sees the scene")
                return
        app.cameras, app.camera_index = found.cameras, -1
        for note in (*found.notes, f"{len(found.cameras):,} cameras"):
            app.tell(f"{reading.name}: {note}")
        if not self._asked.jump:
            return
        if found.up is not None:
            app.steer(replace(app.destination, up=found.up))
        go_to_camera(app, first)

    def busy(self, app: AppState) -> bool:
        return self.reading is not None or bool(self._waiting)

    def cancel(self, app: AppState) -> bool:
        reading, self.reading = self.reading, None
        self._waiting.clear()
        if reading is not None:
            reading.cancel()
            app.tell(f"Cancelled loading {reading.name}")
        return reading is not None

    def close(self, app: AppState) -> None:
        if self.reading is not None:
            self.reading.cancel()


def read_camera_list(path: Path, progress: Progress) -> CameraList:
    notes: list[str] = []
    is_folder = os.path.isdir(path)
    if (is_folder and (find_transforms(path) or find_colmap(path) is None)) or path.name in NERF:
        cameras = [entry.camera for entry in read_poses(path, progress)[1].entries]
    else:
        cameras = load_cameras(path, on_note=notes.append, progress=progress)
    return CameraList(cameras=cameras, up=common_up(cameras), notes=notes)


def sees(camera: Camera, point: np.ndarray) -> bool:
    """Whether `point` (3,), world, is in the camera's picture."""
    t = camera.R_camera_world @ (point - camera.eye)
    if not t[2] > 0:
        return False
    x, y = camera.image_points(t[None])[0]
    return bool(0 <= x <= camera.width and 0 <= y <= camera.height)


def common_up(cameras: Sequence[Camera]) -> np.ndarray | None:
    """Mean up axis of the cameras, as people hold them upright, or all on the same side: (3,) float64 unit;
    None where they differ."""
    if len(cameras) < LEAST_CAMERAS_FOR_UP:
        return None
    return next(iter(likely_ups(cameras, LEAST_COMMON_UP)), None)


def choose_cameras(app: AppState) -> None:
    app.choose_files(
        "Load cameras", lambda paths: [app.feature(CameraLists).open(path) for path in paths], kind="cameras"
    )


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
    if app.scene.bookmarked is None:
        app.tell("Bookmarks of the demo are not saved: it has no file to put them beside")
        return
    try:
        # What another window on the scene has added since stays, and a file that is damaged is not lost.
        app.bookmarks += [
            bookmark
            for bookmark in load_bookmarks(app.scene.bookmarked)
            if bookmark.entry not in app.bookmarks_read
        ]
        path = save_bookmarks(app.scene.bookmarked, app.bookmarks)
        app.bookmarks_read = frozenset(bookmark.entry for bookmark in load_bookmarks(app.scene.bookmarked))
    except InputError as error:
        app.complain(f"The bookmarks cannot be saved: {error}")
        return
    app.tell(f"Bookmarks saved in {path}")
