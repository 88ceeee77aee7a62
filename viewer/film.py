"""The film of the window: a camera path of keyframes, played, changed, and kept with its scene. `viewer.save`
exports it. No ImGui in here."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from splatview.scene import InputError
from splatview.scene.camera_path import (
    TURNTABLE_SECONDS,
    CameraPath,
    Keyframe,
    Motion,
    Pose,
    turntable,
)
from splatview.scene.camera_path_files import load_camera_path, path_of_values, path_values
from splatview.scene.film import Codec
from splatview.scene.user_dirs import config_folder
from splatview.viewer.first_views import FirstViews, key_of
from splatview.viewer.loading import LoadedScene
from splatview.viewer.navigation import View, view_from_camera
from splatview.viewer.preferences import write_json
from splatview.viewer.state import AppState, Feature

FILE_NAME = "films.json"

MOST = 100
"""Scenes whose films are remembered."""

STEP = 2.0
"""Seconds from the last keyframe to one that is added after it."""

GAP = 0.05
"""Seconds between two keyframes at least."""

KEPT_AFTER = 2.0
"""Seconds from a change until it is in the file of films: a crash loses no more."""


@dataclass(frozen=True, kw_only=True)
class FilmSettings:
    """What the film's file shall be."""

    format: str = "mp4" if find_spec("av") is not None else "folder"
    """Name in `FORMATS`."""
    codec: Codec | None = None
    """Of a video; None: the usual one of its format."""
    size: tuple[int, int] = (1280, 720)
    """Width and height, px."""
    fps: float = 30.0


@dataclass(kw_only=True)
class Grip:
    """What the mouse has hold of in the panel."""

    keyframe: int = -1
    """Number of the keyframe; -1: none."""
    moved: bool = False
    """Whether the drag has changed something: the rest of it is part of the same step."""
    seconds: float = STEP
    """Length of the axis, which rests while something is dragged on it."""


class Film(Feature):
    """The camera path of the open scene, and its playhead."""

    def __init__(self) -> None:
        self.path: CameraPath | None = None
        """None without keyframes."""
        self.time = 0.0
        """Of the playhead, seconds."""
        self.chosen = -1
        """Number of the keyframe that is chosen; -1: none."""
        self.playing = False
        self.settings = FilmSettings()
        self.grip = Grip()
        self._key: str | None = None
        self._paths: Sequence[Path] = ()
        self._past: list[CameraPath | None] = []
        self._changed: float | None = None
        """When the path was changed last, as long as that is not in the file."""
        self._began = 0.0
        self._shown: View | None = None

    # ---- The frame loop.

    def before_frame(self, app: AppState) -> None:
        """Moves the camera on while the film plays, unless the user has moved it; keeps what was changed."""
        if self.playing and (app.transition is not None or app.view is not self._shown):
            self.playing = False
        if self.playing and self.path is not None:
            time, duration = app.now() - self._began, self.path.duration
            if self.path.loop and duration > 0:
                time %= duration
            self.playing = time < duration
            self.show(app, min(time, duration))
        if self._changed is not None and app.now() - self._changed > KEPT_AFTER:
            self.keep()

    def cancel(self, app: AppState) -> bool:
        was_playing, self.playing = self.playing, False
        return was_playing

    def close(self, app: AppState) -> None:
        self.keep()

    # ---- With its scene.

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.keep()
        again, self._paths = bool(scene.paths) and scene.paths == self._paths, scene.paths
        self._key = key_of(scene.paths)
        found = remembered_path(self._key)
        if again and found is None:  # its files were written anew: the way through them stays
            self._changed = app.now()
            return
        self.path, self._changed, self._past = found, None, []
        self.time, self.chosen, self.playing = 0.0, -1, False

    def on_scene_saved(self, app: AppState) -> None:
        self._key = key_of(app.scene.paths)
        self._changed = app.now()

    def keep(self) -> None:
        """Writes the path into the file of films, if it has changed and the scene has a file."""
        changed, self._changed = self._changed, None
        if changed is None or self._key is None:
            return
        entries = [entry for entry in remembered() if entry.get("scene") != self._key]
        if self.path is not None:
            entries.insert(0, {"scene": self._key, **path_values(self.path)})
        with contextlib.suppress(InputError):  # Save path says why
            write_json(config_folder() / FILE_NAME, {"version": 1, "films": entries[:MOST]})

    # ---- Changes.

    def change(self, app: AppState, path: CameraPath | None, *, again: bool = False) -> None:
        """Another path, to be undone in one step; `again`: as part of the step before."""
        if not again:
            self._past.append(self.path)
        self.path, self._changed = path, app.now()
        self.playing = self.playing and path is not None
        self.chosen = min(self.chosen, len(path.keyframes) - 1 if path is not None else -1)
        self.time = min(self.time, path.duration if path is not None else 0.0)

    @property
    def can_undo(self) -> bool:
        return bool(self._past)

    def undo(self, app: AppState) -> None:
        if self._past:
            self.change(app, self._past.pop(), again=True)

    def show(self, app: AppState, time: float) -> None:
        """Puts the playhead to `time`, and the camera to where it is then."""
        if self.path is None:
            return
        self.time = min(max(time, 0.0), self.path.duration)
        app.steer(view_of(self.path.pose(self.time), app.view))
        self._shown = app.view

    def play(self, app: AppState) -> None:
        if self.path is None or not self.path.duration > 0:
            return
        start = 0.0 if self.time >= self.path.duration else self.time
        self._began, self.playing = app.now() - start, True
        self.show(app, start)


def view_of(pose: Pose, like: View) -> View:
    """The view of a pose, through the lens of another one."""
    return replace(
        like,
        target=pose.target,
        distance=pose.distance,
        R_camera_world=pose.R_camera_world,
        lens=replace(like.lens, fov_y=pose.fov_y),
    )


def pose_of(view: View) -> Pose:
    return Pose(
        target=view.target,
        distance=view.distance,
        R_camera_world=view.R_camera_world,
        fov_y=view.lens.fov_y,
    )


def remembered() -> list[dict[str, Any]]:
    """Entries of the file of films, the newest first; none where it is missing or damaged."""
    try:
        data = json.loads((config_folder() / FILE_NAME).read_text(encoding="utf-8"))
        return [entry for entry in data["films"] if isinstance(entry, dict)]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return []


def remembered_path(key: str | None) -> CameraPath | None:
    entry = next((entry for entry in remembered() if entry.get("scene") == key), None)
    if key is None or entry is None:
        return None
    with contextlib.suppress(InputError):
        return path_of_values(entry, "a remembered film")
    return None


# ---- Commands.


def add_keyframe(app: AppState) -> None:
    """At the playhead or, where a keyframe is there already, some time after the last."""
    film, path = app.feature(Film), app.feature(Film).path
    time, pose = film.time, pose_of(app.destination)
    if path is None:
        time = 0.0
        key = Keyframe(time=time, pose=pose)
        changed = CameraPath(keyframes=(key,), duration=time, up=app.destination.up)
    else:
        keys = path.keyframes
        if any(abs(key.time - time) < GAP for key in keys):
            time = keys[-1].time + STEP
        room = path.duration - keys[-1].time if path.loop else 0.0  # for the way back to the first
        key = Keyframe(time=time, pose=pose)
        changed = replace(path, keyframes=(*keys, key), duration=max(path.duration, time + room))
    film.playing = False
    film.change(app, changed)
    film.time = time
    film.chosen = next(i for i, other in enumerate(changed.keyframes) if other.time == time)
    app.tell(f"Keyframe {film.chosen + 1} of {len(changed.keyframes)} at {time:.2f} s")


def update_keyframe(app: AppState) -> None:
    """Gives the chosen keyframe the view that is seen."""
    film = app.feature(Film)
    if film.path is None or not 0 <= film.chosen < len(film.path.keyframes):
        app.tell("Choose a keyframe first")
        return
    keys = list(film.path.keyframes)
    keys[film.chosen] = replace(keys[film.chosen], pose=pose_of(app.destination))
    film.change(app, replace(film.path, keyframes=tuple(keys)))
    app.tell(f"Keyframe {film.chosen + 1} has this view")


def delete_keyframe(app: AppState) -> None:
    film, path = app.feature(Film), app.feature(Film).path
    if path is None or not 0 <= film.chosen < len(path.keyframes):
        app.tell("Choose a keyframe first")
        return
    keys = [key for i, key in enumerate(path.keyframes) if i != film.chosen]
    film.playing = False
    if not keys:
        film.change(app, None)
        return
    duration = path.duration if path.loop else keys[-1].time
    film.change(app, replace(path, keyframes=tuple(keys), duration=duration))


def go_to_keyframe(app: AppState, index: int) -> None:
    """Chooses a keyframe, counted round, and goes to it."""
    film = app.feature(Film)
    if film.path is None:
        app.tell("There are no keyframes yet")
        return
    keys = film.path.keyframes
    film.playing, film.chosen = False, index % len(keys)
    film.time = keys[film.chosen].time
    app.go_to(view_of(keys[film.chosen].pose, app.destination))


def step_keyframe(app: AppState, by: int) -> None:
    """To the next keyframe or the one before, as seen from the playhead."""
    film = app.feature(Film)
    times = [key.time for key in film.path.keyframes] if film.path is not None else []
    if by > 0:
        go_to_keyframe(app, next((i for i, time in enumerate(times) if time > film.time + 1e-6), 0))
    else:
        before = [i for i, time in enumerate(times) if time < film.time - 1e-6]
        go_to_keyframe(app, before[-1] if before else -1)


def move_keyframe(app: AppState, index: int, time: float, *, again: bool) -> None:
    """Moves a keyframe in time, as far as its neighbours let it; an open path ends with its last one."""
    film, path = app.feature(Film), app.feature(Film).path
    if path is None or not index < len(path.keyframes):  # it was taken back meanwhile
        return
    keys = list(path.keyframes)
    low = keys[index - 1].time + GAP if index else 0.0
    high = keys[index + 1].time - GAP if index + 1 < len(keys) else None
    if high is None and path.loop:
        high = path.duration - GAP + min(keys[0].time, GAP)
    time = max(min(time, high) if high is not None else time, low)
    keys[index] = replace(keys[index], time=time)
    duration = path.duration if path.loop else keys[-1].time
    film.change(app, replace(path, keyframes=tuple(keys), duration=duration), again=again)
    film.time, film.chosen = time, index


def play_or_pause(app: AppState) -> None:
    film = app.feature(Film)
    if film.playing:
        film.playing = False
    elif film.path is None:
        app.tell("There are no keyframes yet")
    else:
        film.play(app)


def set_length(app: AppState, seconds: float, *, again: bool = False) -> None:
    """The same way in another time."""
    film = app.feature(Film)
    if film.path is not None and film.path.duration > 0 and seconds >= GAP * len(film.path.keyframes):
        share = film.time / film.path.duration
        film.change(app, film.path.lasting(seconds), again=again)
        film.time = share * seconds


def toggle_loop(app: AppState) -> None:
    """A loop takes as long from its last keyframe back to the first as it took on average before."""
    film, path = app.feature(Film), app.feature(Film).path
    if path is None:
        app.tell("There are no keyframes yet")
        return
    first, last, count = path.keyframes[0].time, path.keyframes[-1].time, len(path.keyframes)
    back = (last - first) / (count - 1) if count > 1 else STEP
    duration = last if path.loop else max(path.duration, last + back)
    film.change(app, replace(path, loop=not path.loop, duration=duration))


def set_motion(app: AppState, motion: Motion) -> None:
    film = app.feature(Film)
    if film.path is not None:
        film.change(app, replace(film.path, motion=motion))


def make_turntable(app: AppState) -> None:
    """A turn about the view's target; where the view is still the first one of the scene, about its middle,
    from as far as shows it from all sides."""
    film, view = app.feature(Film), app.destination
    if view is app.feature(FirstViews).given and app.scene.front is not None:
        width, height = film.settings.size
        found = app.scene.front.turntable(width, height, fov_y=view.lens.fov_y)
        distance = float((found.target - found.camera.eye) @ found.camera.forward)
        view = replace(view_from_camera(found.camera, distance=distance, up=found.up), lens=view.lens)
    seconds = TURNTABLE_SECONDS
    if film.path is not None and film.path.duration > 0:
        seconds = film.path.duration
    film.playing = False
    film.change(app, turntable(pose_of(view), view.up, seconds))
    film.time, film.chosen = 0.0, -1
    film.play(app)
    app.tell("Turntable: one turn, that begins where it ends")


def undo(app: AppState) -> None:
    app.feature(Film).undo(app)


def choose_path_to_open(app: AppState) -> None:
    app.choose_files("Open a camera path", lambda paths: app.post(open_path, paths[0]), kind="cameras")


def open_path(app: AppState, file: Path) -> None:
    film = app.feature(Film)
    try:
        width, height = film.settings.size
        found = load_camera_path(file, aspect=width / height)
    except InputError as error:
        app.complain(str(error))
        return
    film.change(app, found.path)
    film.settings = replace(
        film.settings, size=found.size or film.settings.size, fps=found.fps or film.settings.fps
    )
    film.time, film.chosen = 0.0, -1
    film.show(app, 0.0)
    count = len(found.path.keyframes)
    app.tell(f"{file.name}: {count:,} keyframe{'s' * (count > 1)}, {found.path.duration:.4g} s")
