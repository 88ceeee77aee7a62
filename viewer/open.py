"""Opening scenes: by dialog, drop, recent file or command line."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from splatview.scene import InputError
from splatview.scene.formats import is_camera_list
from splatview.scene.formats.sequence import SceneSequence, resolve_all
from splatview.viewer.camera import CameraLists
from splatview.viewer.first_views import FirstViews
from splatview.viewer.loading import Examination, LoadedScene, SequenceLoading, load_demo, load_files
from splatview.viewer.preferences import load_bookmarks, with_recent, without_missing
from splatview.viewer.state import AppState

UPLOAD_SECONDS = 0.012
"""Seconds of each frame for uploading; the rest keeps the window alive."""


def open_paths(app: AppState, paths: Sequence[Path], *, merge: bool = False) -> None:
    """Opens what was dropped or chosen: scenes (several are merged), a sequence, camera lists, a COLMAP
    folder. `merge`: scenes that are numbered alike, too, become one."""
    try:
        found = resolve_all(paths, merge=merge)
    except InputError as error:
        app.complain(str(error))
        return
    if isinstance(found, SceneSequence):
        begin_sequence(app, found)
        return
    scenes = []
    for path in found:
        if is_camera_list(path):
            app.feature(CameraLists).open(path)
        else:
            scenes.append(path)
    if scenes:
        begin(app, scenes)


def begin(app: AppState, paths: Sequence[Path]) -> None:
    """Starts to load; a load under way is cancelled, and the shown scene stays until the new one is here.
    Where it has unsaved edits the user is asked first."""
    app.leave(partial(_begin, paths=paths))


def _begin(app: AppState, paths: Sequence[Path]) -> None:
    cancel_loading(app, quiet=True)
    leave_start_screen(app)
    app.loading = load_files([Path(path) for path in paths])


def leave_start_screen(app: AppState) -> None:
    """Something was chosen: its progress is not to lie on what it was chosen from."""
    if app.dialog == "start":
        app.dialog = None


def begin_sequence(app: AppState, sequence: SceneSequence, *, start: int = 0) -> None:
    """Starts to load the first frame from `start` on that can be read; the others follow once it is shown.
    Where the open scene has unsaved edits the user is asked first."""
    app.leave(partial(_begin_sequence, sequence=sequence, start=start))


def _begin_sequence(app: AppState, sequence: SceneSequence, start: int) -> None:
    cancel_loading(app, quiet=True)
    leave_start_screen(app)
    app.loading = SequenceLoading(sequence, start)


def begin_demo(app: AppState) -> None:
    app.leave(_begin_demo)


def _begin_demo(app: AppState) -> None:
    cancel_loading(app, quiet=True)
    app.loading = load_demo()


def reload(app: AppState) -> None:
    """Reads the open files again, as training writes them say; the view stays."""
    if app.scene.sequence is not None:
        try:
            begin_sequence(app, app.scene.sequence.again(), start=app.scene.frame)
        except InputError as error:
            app.complain(str(error))
    elif app.scene.paths:
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
    if loading.result is None:
        app.loading = None
        if loading.problem is not None:
            app.complain(loading.problem)
            app.preferences = without_missing(app.preferences)
        return
    if app.upload is None:
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
    same_place = app.is_open and scene.bookmarked == app.scene.bookmarked
    app.scene = scene
    for feature in app.features.values():
        feature.on_scene_opened(app, scene)
    if same_place:
        app.call_for(scene.settings)
    else:
        app.called_for = scene.settings
        app.settings = replace(
            scene.settings, background=app.preferences.background, blend=app.preferences.blend
        )
        app.bookmarks, app.bookmark_index, app.bookmarks_read = [], -1, frozenset()
        app.cameras, app.camera_index = [], -1
        app.feature(FirstViews).look(app, scene)
        try:
            app.bookmarks = load_bookmarks(scene.bookmarked) if scene.bookmarked else []
            app.bookmarks_read = frozenset(bookmark.entry for bookmark in app.bookmarks)
        except InputError as error:
            app.complain(str(error))
    folder = scene.sequence.folder if scene.sequence else None
    for path in reversed(scene.paths if folder is None else (folder,)):
        app.preferences = with_recent(app.preferences, path)
    if scene.sequence is None:
        app.tell(f"{scene.name}: {len(scene.gaussians):,} splats in {scene.seconds:.2f} s")
    else:
        app.tell(f"{scene.name}: {scene.sequence.in_words}")
    for note in scene.gaussians.notes:
        app.tell(f"{scene.name}: {note}")
    app.examination, app.examined = Examination(scene.gaussians), False


def report_examination(app: AppState) -> None:
    """Called every frame: says once which splats of a new scene are left out."""
    if app.examination is None or app.examined or not app.examination.done:
        return
    app.examined = True
    if app.examination.error is not None:
        raise app.examination.error
    for finding in app.examination.findings:
        if finding.count and finding.culled:
            app.tell(f"{finding.count:,} splats are left out: {finding.name}")


def choose_scene(app: AppState) -> None:
    app.choose_files("Open a scene", lambda paths: app.post(open_paths, paths), kind="scene")


def choose_folder(app: AppState) -> None:
    app.choose_files(
        "Open a folder of scenes as a sequence", lambda paths: app.post(open_paths, paths), kind="folder"
    )
