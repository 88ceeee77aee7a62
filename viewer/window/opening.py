"""Opening scenes and camera lists: by dialog, drop, recent file or command line."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ...scene import Camera, InputError
from ...scene.demo import demo_camera
from ...scene.files import load_cameras
from ...scene.framing import frame_camera
from .bookmarks import load_bookmarks
from .camera_list import go_to_camera
from .core import Core
from .editing.taking_up import take_up
from .loading import Examination, LoadedScene, load_demo, load_files
from .navigation import view_from_camera
from .preferences import with_recent, without_missing

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
