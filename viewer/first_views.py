"""Where an opened scene is first looked at from: where it was left, else the cameras that lie with its file,
else its front."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene import Camera, InputError
from splatview.scene.demo import demo_camera
from splatview.scene.first_view import Front
from splatview.scene.framing import frame_camera, pivot
from splatview.scene.user_dirs import config_folder
from splatview.viewer.camera import CameraLists, shown_sample
from splatview.viewer.loading import LoadedScene
from splatview.viewer.navigation import View, view_from_camera
from splatview.viewer.preferences import view_from_json, view_to_json, write_json
from splatview.viewer.state import AppState, Feature

FILE_NAME = "views.json"

MOST = 200
"""Scenes whose views are remembered."""

ITERATION = "iteration_"
"""How folders begin in which the 3DGS trainer leaves scenes: cameras.json lies three above the file."""


class FirstViews(Feature):
    """Views that scenes were left from, by their files."""

    def __init__(self) -> None:
        self.key: str | None = None
        """Of the open scene; None where it has no files."""
        self.given: View | None = None
        """The view that the program chose: as long as it is not moved, the next time chooses anew."""

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.leave(app)
        self.key = key_of(scene.paths)

    def on_scene_saved(self, app: AppState) -> None:
        self.key = key_of(app.scene.paths)

    def close(self, app: AppState) -> None:
        self.leave(app)

    def leave(self, app: AppState) -> None:
        """Remembers the view of the scene that is open."""
        if self.key is None or self.given is None or app.destination is self.given:
            return
        entry = {"scene": self.key, **view_to_json(app.destination)}
        others = [other for other in remembered() if other.get("scene") != self.key]
        with contextlib.suppress(InputError):  # a view that is not kept costs nothing
            write_json(config_folder() / FILE_NAME, {"version": 1, "views": [entry, *others][:MOST]})

    def look(self, app: AppState, scene: LoadedScene) -> None:
        """The first view of `scene`, which is the open one."""
        last = None if self.key is None else last_view(self.key)
        front = front_view(app, scene)
        self.given = front if last is None else last
        app.steer(self.given)
        if last is not None:
            app.tell("The view is where it was left; Shift+Home shows the scene's front")
        lists = app.feature(CameraLists)
        cameras = cameras_beside(scene.paths)
        if cameras is not None and not lists.busy(app):
            lists.open(cameras, beside=True, jump=last is None)


def front_view(app: AppState, scene: LoadedScene) -> View:
    """The scene's front, filling the picture; the demo's own view of the demo."""
    width, height = app.picture_size
    fov_y = app.preferences.fov_y
    if scene.front is None:
        nothing_seen = bool(scene.paths)
        camera = (
            frame_camera(scene.gaussians, width, height, fov_y=fov_y)
            if nothing_seen
            else demo_camera(width, height)
        )
        return _view(camera, pivot(camera, scene.centre), nearest_axis(-camera.R_camera_world[1]))
    found = scene.front.view(width, height, fov_y=fov_y)
    return _view(found.camera, found.target, found.up)


def _view(camera: Camera, target: np.ndarray, up: np.ndarray) -> View:
    distance = float((target - camera.eye) @ camera.forward)
    return view_from_camera(camera, distance=distance, up=up)


def go_home(app: AppState) -> None:
    """Shows the front of what is shown of the scene, upright as it seems to be."""
    if not app.is_open:
        return
    width, height = app.picture_size
    edited = shown_sample(app) if app.edits is not None and app.edits.in_force else None
    front = app.scene.front if edited is None else Front.of(edited)
    if front is None:
        app.go_to(front_view(app, app.scene))
        return
    found = front.view(width, height, fov_y=app.preferences.fov_y)
    app.go_to(_view(found.camera, found.target, found.up))


def nearest_axis(direction: np.ndarray) -> np.ndarray:
    """The world axis (3,) float64, with its sign, that `direction` (3,) is nearest to."""
    axis = np.zeros(3)
    largest = np.argmax(np.abs(direction))
    axis[largest] = np.sign(direction[largest])
    return axis


def cameras_beside(paths: Sequence[Path]) -> Path | None:
    """The file of cameras that belongs to the first of `paths`, by its name and place; None where there is
    none."""
    if not paths:
        return None
    scene = paths[0]
    places = [scene.with_name(f"{scene.stem}.cameras.json"), scene.with_name("cameras.json")]
    if scene.parent.name.startswith(ITERATION):
        places.append(scene.absolute().parent.parent.parent / "cameras.json")
    return next((place for place in places if os.path.isfile(place)), None)


def key_of(paths: Sequence[Path]) -> str | None:
    """What tells the scene of `paths` from others: the files' places and sizes. None for no files."""
    if not paths:
        return None
    digest = hashlib.sha256()
    for path in paths:
        try:
            size = os.stat(path).st_size
        except OSError:
            return None
        digest.update(os.fsencode(path.absolute()) + f"\0{size}\0".encode())
    return digest.hexdigest()[:24]


def remembered() -> list[dict[str, Any]]:
    """Entries of the file of views, the newest first; none where it is missing or damaged."""
    try:
        data = json.loads((config_folder() / FILE_NAME).read_text(encoding="utf-8"))
        return [entry for entry in data["views"] if isinstance(entry, dict)]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []


def last_view(key: str) -> View | None:
    """The view that the scene of `key` was left from."""
    entry = next((entry for entry in remembered() if entry.get("scene") == key), None)
    if entry is None:
        return None
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return view_from_json(entry, "a remembered view")
    except (InputError, ValueError, KeyError, TypeError, OverflowError):
        return None
