"""Opening scenes and camera lists: by dialog, drop, recent file or command line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...scene import InputError
from ...scene.files import load_cameras
from ...scene.framing import frame_camera
from .bookmarks import load_bookmarks
from .camera_list import go_to_camera
from .core import Core
from .loading import LoadedScene, load_demo, load_files
from .navigation import view_from_camera
from .picture import EMPTY
from .preferences import with_recent

CAMERA_SUFFIXES = {".json", ".bin", ".txt"}
"""A dropped file with one of these is a camera list."""


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


def cancel_loading(core: Core, *, quiet: bool = False) -> None:
    if core.loading:
        core.loading.cancel()
        if not quiet:
            core.tell(f"Cancelled loading {core.loading.name}")
        core.loading = None


def finish_loading(core: Core) -> None:
    """Called every frame: takes over a scene that has been read, or shows why it could not be."""
    loading = core.loading
    if loading is None or not loading.done:
        return
    core.loading = None
    if loading.cancelled:
        return
    if loading.error is not None:
        core.complain(loading.error)
    elif loading.result is not None:
        show(core, loading.result)


def show(core: Core, scene: LoadedScene) -> None:
    """Puts `scene` on the GPU and makes it the open one; where it does not fit, the old one comes back."""
    if core.picture is not None:
        try:
            core.picture.load(scene.gaussians)
        except InputError as error:
            core.picture.load(core.scene.gaussians if core.scene else EMPTY)
            core.complain(f"{scene.name}: {error}")
            return
    same_place = core.scene is not None and scene.paths[:1] == core.scene.paths[:1]
    core.scene = scene
    if not same_place:
        look_at_all_of(core, scene)
        core.bookmarks, core.bookmark_index = [], -1
        core.cameras, core.camera_index = [], -1
        try:
            core.bookmarks = load_bookmarks(scene.paths[0]) if scene.paths else []
        except InputError as error:
            core.complain(str(error))
    for path in reversed(scene.paths):
        core.preferences = with_recent(core.preferences, path)
    core.tell(f"{scene.name}: {len(scene.gaussians):,} splats in {scene.seconds:.2f} s")
    for finding in scene.findings:
        if finding.count:
            core.tell(f"{scene.name}: {finding.count:,} splats: {finding.name}")


def look_at_all_of(core: Core, scene: LoadedScene) -> None:
    """The first view of a scene, upright as it seems to be."""
    width, height = core.picture_size
    camera = frame_camera(scene.gaussians, width, height, fov_y=core.preferences.fov_y)
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
        cameras = load_cameras(path)
    except InputError as error:
        core.complain(str(error))
        return
    core.cameras, core.camera_index = cameras, -1
    core.tell(f"{path.name}: {len(cameras)} cameras")
    go_to_camera(core, 0)


def choose_scene(core: Core) -> None:
    core.choose_files("Open a scene", lambda paths: core.post(open_paths, paths), kind="scene")


def choose_addition(core: Core) -> None:
    core.choose_files(
        "Add a scene", lambda paths: core.post(lambda core: begin(core, paths, add=True)), kind="scene"
    )


def choose_cameras(core: Core) -> None:
    core.choose_files(
        "Load cameras",
        lambda paths: [core.post(open_camera_list, path) for path in paths],
        kind="cameras",
    )
