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
from splatview.viewer.state import Core

# ---- Going to cameras that come from elsewhere: a loaded list, the clipboard.


def go_to_camera(core: Core, index: int) -> None:
    """Jumps to the loaded camera `index`, counted round the list."""
    if not core.cameras:
        core.tell("No cameras are loaded: File > Load a list of cameras")
        return
    core.camera_index = index % len(core.cameras)
    camera = core.cameras[core.camera_index]
    take_position(core, camera)
    core.tell(f"Camera {core.camera_index + 1} of {len(core.cameras)}: {camera.name or 'unnamed'}")


def step_camera(core: Core, step: int) -> None:
    """Next or previous: the first step goes to the first or last camera."""
    go_to_camera(core, core.camera_index + step if core.camera_index >= 0 or step > 0 else -1)


def take_position(core: Core, camera: Camera) -> None:
    """Looks as `camera` does; the turning point keeps its distance, the up axis stays."""
    width, height = core.picture_size
    view = core.destination
    if not core.through_lenses:
        camera = replace(camera, lens=None)
    core.go_to(view_from_camera(camera, distance=view.distance, up=view.up, width=width, height=height))


def copy_camera(core: Core) -> None:
    """Puts the view on the clipboard in the form that `splatview render --camera` reads."""
    core.clipboard_write = camera_text(core.camera)
    core.tell("The camera is on the clipboard")


def paste_camera(core: Core) -> None:
    try:
        camera = camera_from_text(core.clipboard_read())
    except ValueError as error:
        core.tell(f"There is no camera on the clipboard: {error}")
        return
    take_position(core, camera)


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


def open_paths(core: Core, paths: Sequence[Path]) -> None:
    """Opens what was dropped or chosen: scenes (several are merged), camera lists, a COLMAP folder."""
    scenes = []
    for path in paths:
        if path.suffix.lower() in CAMERA_SUFFIXES or path.is_dir():
            open_camera_list(core, path)
        else:
            scenes.append(path)
    if scenes:
        begin(core, scenes)


def begin(core: Core, paths: Sequence[Path], *, add: bool = False) -> None:
    """Starts to load; a load under way is cancelled, and the shown scene stays until the new one is here."""
    cancel_loading(core, quiet=True)
    core.loading = load_files([Path(path) for path in paths], added_to=core.scene if add else None)


def begin_demo(core: Core) -> None:
    cancel_loading(core, quiet=True)
    core.loading = load_demo()


def reload(core: Core) -> None:
    """Reads the open files again, as training writes them say; the view stays."""
    if core.scene and core.scene.paths:
        begin(core, core.scene.paths)


def cancel_loading(core: Core, *, quiet: bool = False) -> None:
    """Stops reading or uploading; the shown scene stays."""
    if not quiet and core.loading:
        core.tell(f"Cancelled loading {core.loading.name}")
    if core.loading:
        core.loading.cancel()
        core.loading = None
    if core.upload:
        core.upload.close()
        core.upload = None


def continue_loading(core: Core) -> None:
    """Called every frame: takes over a scene that has been read, for a few milliseconds of uploading."""
    loading = core.loading
    if loading is None or not loading.done:
        return
    if loading.error is not None or loading.result is None:
        core.loading = None
        if loading.error is not None:
            core.complain(loading.error)
            core.preferences = without_missing(core.preferences)
        return
    if core.upload is None and core.picture is not None:
        loading.stage = "Uploading"
        core.upload = core.picture.load_steps(loading.result.gaussians)
    if upload_for(core, UPLOAD_SECONDS):
        core.upload = core.loading = None
        adopt(core, loading.result)


def upload_for(core: Core, seconds: float) -> bool:
    """Uploads for about so long; True when all is done. A scene that does not fit is told of and dropped."""
    until = time.perf_counter() + seconds
    try:
        while core.upload is not None and core.loading is not None:
            core.loading.progress = next(core.upload)
            if time.perf_counter() >= until:
                return False
    except StopIteration:
        return True
    except InputError as error:
        core.complain(f"{core.loading.name if core.loading else 'The scene'}: {error}")
        core.upload = core.loading = None
        return False
    return True


def adopt(core: Core, scene: LoadedScene) -> None:
    """Makes `scene`, which the picture holds already, the open one."""
    same_place = core.scene is not None and scene.paths[:1] == core.scene.paths[:1]
    core.scene = scene
    take_up(core, scene)
    if not same_place:
        core.settings = replace(
            scene.settings, background=core.preferences.background, blend=core.preferences.blend
        )
        look_at_all_of(core, scene)
        core.bookmarks, core.bookmark_index, core.bookmarks_read = [], -1, frozenset()
        core.cameras, core.camera_index = [], -1
        try:
            core.bookmarks = load_bookmarks(scene.paths[0]) if scene.paths else []
            core.bookmarks_read = frozenset(bookmark.entry for bookmark in core.bookmarks)
        except InputError as error:
            core.complain(str(error))
    for path in reversed(scene.paths):
        core.preferences = with_recent(core.preferences, path)
    core.tell(f"{scene.name}: {len(scene.gaussians):,} splats in {scene.seconds:.2f} s")
    core.examination, core.examined, core.examining = Examination(scene.gaussians), False, None


def report_examination(core: Core) -> None:
    """Called every frame: says once which splats of a new scene are left out."""
    if core.examination is None or core.examined or not core.examination.done:
        return
    core.examined = True
    for finding in core.examination.findings:
        if finding.count and finding.culled:
            core.tell(f"{finding.count:,} splats are left out: {finding.name}")


def look_at_all_of(core: Core, scene: LoadedScene) -> None:
    """The first view of a scene, upright as it seems to be."""
    width, height = core.picture_size
    if scene.paths:
        camera = frame_camera(scene.gaussians, width, height, fov_y=core.preferences.fov_y)
    else:
        camera = demo_camera(width, height)
    distance = max(float((scene.centre - camera.eye) @ camera.forward), 1e-3 * scene.radius)
    core.steer(view_from_camera(camera, distance=distance, up=nearest_axis(-camera.R_camera_world[1])))


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The world axis (3,) float64, with its sign, that `direction` (3,) is nearest to."""
    axis = np.zeros(3)
    largest = np.argmax(np.abs(direction))
    axis[largest] = np.sign(direction[largest])
    return axis


def open_camera_list(core: Core, path: Path) -> None:
    """Loads the cameras of `path` and jumps to the first."""
    try:
        cameras = load_cameras(path, on_note=lambda line: core.tell(f"{path.name}: {line}"))
    except InputError as error:
        core.complain(str(error))
        return
    core.cameras, core.camera_index = cameras, -1
    core.tell(f"{path.name}: {len(cameras)} cameras")
    up = common_up(cameras)
    if up is not None:
        core.steer(replace(core.destination, up=up))
    go_to_camera(core, 0)


def common_up(cameras: Sequence[Camera]) -> np.ndarray | None:
    """What is up in most pictures, which people take upright: (3,) float64 unit; None if they differ."""
    mean = -np.mean([camera.R_camera_world[1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(mean))
    return mean / length if len(cameras) >= LEAST_CAMERAS_FOR_UP and length > 0.5 else None


def choose_scene(core: Core) -> None:
    core.choose_files("Open a scene", lambda paths: core.post(open_paths, paths), kind="scene")


def choose_cameras(core: Core) -> None:
    core.choose_files(
        "Load cameras",
        lambda paths: [core.post(open_camera_list, path) for path in paths],
        kind="cameras",
    )


# ---- Where the splats are that the user sees, as edits have left them.


def bounds(core: Core, *, selected: bool = False) -> tuple[np.ndarray, float] | None:
    """Centre (3,) float64 and radius > 0, world, of the bulk of all splats that are shown, or of the selected
    ones. None where there are none."""
    scene, edits = core.scene, core.edits
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
