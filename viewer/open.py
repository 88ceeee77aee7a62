"""Opening scenes and camera lists: by dialog, drop, recent file or command line."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatview.scene import Camera, InputError
from splatview.scene.demo import demo_camera
from splatview.scene.edits import SELECTED, SceneEdits, bake, shown
from splatview.scene.errors import one_line
from splatview.scene.formats import load_cameras
from splatview.scene.formats.cameras import camera_values, is_orthographic, lens_of
from splatview.scene.framing import SAMPLE, bulk, frame_camera
from splatview.viewer.editing.session import take_up
from splatview.viewer.loading import Examination, LoadedScene, load_demo, load_files
from splatview.viewer.navigation import view_from_camera
from splatview.viewer.preferences import load_bookmarks, with_recent, without_missing
from splatview.viewer.state import AppState

# ---- Going to cameras that come from elsewhere: a loaded list, the clipboard.


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


CAMERA_SUFFIXES = {".json", ".bin", ".txt"}
"""A dropped file with one of these is a camera list."""

UPLOAD_SECONDS = 0.012
"""Of each frame's time; the rest keeps the window alive."""

LEAST_CAMERAS_FOR_UP = 3
"""Fewer photos may all have been taken at a slant."""


def open_paths(app: AppState, paths: Sequence[Path]) -> None:
    """Opens what was dropped or chosen: scenes (several are merged), camera lists, a COLMAP folder."""
    scenes = []
    for path in paths:
        if path.suffix.lower() in CAMERA_SUFFIXES or path.is_dir():
            open_camera_list(app, path)
        else:
            scenes.append(path)
    if scenes:
        begin(app, scenes)


def begin(app: AppState, paths: Sequence[Path], *, add: bool = False) -> None:
    """Starts to load; a load under way is cancelled, and the shown scene stays until the new one is here."""
    cancel_loading(app, quiet=True)
    app.loading = load_files([Path(path) for path in paths], added_to=app.scene if add else None)


def begin_demo(app: AppState) -> None:
    cancel_loading(app, quiet=True)
    app.loading = load_demo()


def reload(app: AppState) -> None:
    """Reads the open files again, as training writes them say; the view stays."""
    if app.scene and app.scene.paths:
        begin(app, app.scene.paths)


def cancel_loading(app: AppState, *, quiet: bool = False) -> None:
    """Stops reading or uploading; the shown scene stays."""
    if not quiet and app.loading:
        app.tell(f"Cancelled loading {app.loading.name}")
    if app.loading:
        app.loading.cancel()
        app.loading = None
    if app.upload:
        app.upload.close()
        app.upload = None


def continue_loading(app: AppState) -> None:
    """Called every frame: takes over a scene that has been read, for a few milliseconds of uploading."""
    loading = app.loading
    if loading is None or not loading.done:
        return
    if loading.error is not None or loading.result is None:
        app.loading = None
        if loading.error is not None:
            app.complain(loading.error)
            app.preferences = without_missing(app.preferences)
        return
    if app.upload is None and app.picture is not None:
        loading.stage = "Uploading"
        app.upload = app.picture.load_steps(loading.result.gaussians)
    if upload_for(app, UPLOAD_SECONDS):
        app.upload = app.loading = None
        adopt(app, loading.result)


def upload_for(app: AppState, seconds: float) -> bool:
    """Uploads for about so long; True when all is done. A scene that does not fit is told of and dropped."""
    until = time.perf_counter() + seconds
    try:
        while app.upload is not None and app.loading is not None:
            app.loading.progress = next(app.upload)
            if time.perf_counter() >= until:
                return False
    except StopIteration:
        return True
    except InputError as error:
        app.complain(f"{app.loading.name if app.loading else 'The scene'}: {error}")
        app.upload = app.loading = None
        return False
    return True


def adopt(app: AppState, scene: LoadedScene) -> None:
    """Makes `scene`, which the picture holds already, the open one."""
    same_place = app.scene is not None and scene.paths[:1] == app.scene.paths[:1]
    app.scene = scene
    take_up(app, scene)
    if not same_place:
        app.settings = replace(
            scene.settings, background=app.preferences.background, blend=app.preferences.blend
        )
        look_at_all_of(app, scene)
        app.bookmarks, app.bookmark_index, app.bookmarks_read = [], -1, frozenset()
        app.cameras, app.camera_index = [], -1
        try:
            app.bookmarks = load_bookmarks(scene.paths[0]) if scene.paths else []
            app.bookmarks_read = frozenset(bookmark.entry for bookmark in app.bookmarks)
        except InputError as error:
            app.complain(str(error))
    for path in reversed(scene.paths):
        app.preferences = with_recent(app.preferences, path)
    app.tell(f"{scene.name}: {len(scene.gaussians):,} splats in {scene.seconds:.2f} s")
    app.examination, app.examined, app.examining = Examination(scene.gaussians), False, None


def report_examination(app: AppState) -> None:
    """Called every frame: says once which splats of a new scene are left out."""
    if app.examination is None or app.examined or not app.examination.done:
        return
    app.examined = True
    for finding in app.examination.findings:
        if finding.count and finding.culled:
            app.tell(f"{finding.count:,} splats are left out: {finding.name}")


def look_at_all_of(app: AppState, scene: LoadedScene) -> None:
    """The first view of a scene, upright as it seems to be."""
    width, height = app.picture_size
    if scene.paths:
        camera = frame_camera(scene.gaussians, width, height, fov_y=app.preferences.fov_y)
    else:
        camera = demo_camera(width, height)
    distance = max(float((scene.centre - camera.eye) @ camera.forward), 1e-3 * scene.radius)
    app.steer(view_from_camera(camera, distance=distance, up=nearest_axis(-camera.R_camera_world[1])))


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The world axis (3,) float64, with its sign, that `direction` (3,) is nearest to."""
    axis = np.zeros(3)
    largest = np.argmax(np.abs(direction))
    axis[largest] = np.sign(direction[largest])
    return axis


def open_camera_list(app: AppState, path: Path) -> None:
    """Loads the cameras of `path` and jumps to the first."""
    try:
        cameras = load_cameras(path, on_note=lambda line: app.tell(f"{path.name}: {line}"))
    except InputError as error:
        app.complain(str(error))
        return
    app.cameras, app.camera_index = cameras, -1
    app.tell(f"{path.name}: {len(cameras)} cameras")
    up = common_up(cameras)
    if up is not None:
        app.steer(replace(app.destination, up=up))
    go_to_camera(app, 0)


def common_up(cameras: Sequence[Camera]) -> np.ndarray | None:
    """What is up in most pictures, which people take upright: (3,) float64 unit; None if they differ."""
    mean = -np.mean([camera.R_camera_world[1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(mean))
    return mean / length if len(cameras) >= LEAST_CAMERAS_FOR_UP and length > 0.5 else None


def choose_scene(app: AppState) -> None:
    app.choose_files("Open a scene", lambda paths: app.post(open_paths, paths), kind="scene")


def choose_cameras(app: AppState) -> None:
    app.choose_files(
        "Load cameras",
        lambda paths: [app.post(open_camera_list, path) for path in paths],
        kind="cameras",
    )


# ---- Where the splats are that the user sees, as edits have left them.


def bounds(app: AppState, *, selected: bool = False) -> tuple[np.ndarray, float] | None:
    """Centre (3,) float64 and radius > 0, world, of the bulk of all splats that are shown, or of the selected
    ones. None where there are none."""
    scene, edits = app.scene, app.edits
    if scene is None or (selected and edits is None):
        return None
    if edits is None:
        return scene.centre, scene.radius
    gaussians = scene.gaussians
    kept = shown(gaussians, edits)
    if selected:
        kept &= (edits.marks & SELECTED) != 0
    indices = np.flatnonzero(kept)
    if not len(indices):
        return None
    indices = indices[:: -(-len(indices) // SAMPLE)]
    sample = replace(gaussians, sh=gaussians.sh[:, :1], extras={}).take(indices)
    return bulk(bake(sample, SceneEdits(marks=edits.marks[indices], palette=edits.palette)))
