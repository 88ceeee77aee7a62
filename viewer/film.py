"""The film of the window: a camera path of keyframes, played, changed, kept with its scene, and exported by
the window's own renderer in a thread beside the frame loop. No ImGui in here."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from splatview.measure.knobs import Plan
from splatview.scene import Camera, InputError
from splatview.scene.camera import stepped_back
from splatview.scene.camera_path import (
    TURNTABLE_SECONDS,
    CameraPath,
    Keyframe,
    Motion,
    Pose,
    turntable,
)
from splatview.scene.camera_path_files import load_camera_path, path_of_values, path_values, save_camera_path
from splatview.scene.errors import one_line
from splatview.scene.film import FORMATS, Codec, check_film, film_format, film_writer
from splatview.scene.progress import Cancelled
from splatview.scene.user_dirs import config_folder
from splatview.viewer.command import Command, needs
from splatview.viewer.first_views import FirstViews, key_of
from splatview.viewer.loading import LoadedScene
from splatview.viewer.navigation import View, view_from_camera
from splatview.viewer.preferences import write_json
from splatview.viewer.quality.measurement import WindowScene
from splatview.viewer.save import levels, next_free, picture_folder, picture_stem
from splatview.viewer.state import AppState, Feature
from splatview.viewer.tasks import Task

FILE_NAME = "films.json"

MOST = 100
"""Scenes whose films are remembered."""

STEP = 2.0
"""Seconds from the last keyframe to one that is added after it."""

GAP = 0.05
"""Seconds between two keyframes at least."""

KEPT_AFTER = 2.0
"""Seconds from a change until it is in the file of films: a crash loses no more."""

DIALOG = "film"


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
    """The camera path of the open scene, its playhead, and the export under way."""

    wake: Callable[[], object] = lambda: None

    def __init__(self) -> None:
        self.path: CameraPath | None = None
        """None without keyframes."""
        self.time = 0.0
        """Of the playhead, seconds."""
        self.chosen = -1
        """Number of the keyframe that is chosen; -1: none."""
        self.playing = False
        self.settings = FilmSettings()
        self.file = ""
        """Where the film goes, as it is typed."""
        self.export: Task[str] | None = None
        self.grip = Grip()
        self._key: str | None = None
        self._past: list[CameraPath | None] = []
        self._changed: float | None = None
        """When the path was changed last, as long as that is not in the file."""
        self._began = 0.0
        self._shown: View | None = None

    # ---- The frame loop.

    def before_frame(self, app: AppState) -> None:
        """Moves the camera on while the film plays, unless the user has moved it; takes over an export that
        has ended; keeps what was changed."""
        if self.playing and (app.transition is not None or app.view is not self._shown):
            self.playing = False
        if self.playing and self.path is not None:
            time, duration = app.now() - self._began, self.path.duration
            if self.path.loop and duration > 0:
                time %= duration
            self.playing = time < duration
            self.show(app, min(time, duration))
        task = self.export
        if task is not None and task.done:
            self.export = None
            if isinstance(task.error, InputError):
                app.complain(str(task.error))
            elif isinstance(task.error, Cancelled) or task.cancelled:
                app.tell("The film was stopped; nothing is written")
            elif task.error is not None:
                app.fail(task.error if isinstance(task.error, Exception) else RuntimeError(str(task.error)))
            else:
                app.tell(f"Film saved: {task.result}")
        if self._changed is not None and app.now() - self._changed > KEPT_AFTER:
            self.keep()

    def busy(self, app: AppState) -> bool:
        return self.export is not None

    def cancel(self, app: AppState) -> bool:
        if self.export is not None:
            self.export.cancel()
            return True
        was_playing, self.playing = self.playing, False
        return was_playing

    def close(self, app: AppState) -> None:
        self.keep()
        if self.export is not None:
            self.export.cancel()
            self.export.join(10.0)  # which removes what is half written

    # ---- With its scene.

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.keep()
        self._key = key_of(scene.paths)
        self.path, self._changed, self._past = remembered_path(self._key), None, []
        self.time, self.chosen, self.playing, self.file = 0.0, -1, False, ""

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

    def problem(self) -> str:
        """What is in the way of an export, in a line; "" where nothing is."""
        settings = self.settings
        if self.path is None:
            return "Add keyframes first"
        if not self.file.strip():
            return "Name the file"
        file, known = Path(os.path.expanduser(self.file)), FORMATS[settings.format]
        try:
            if film_format(file) is not known:
                return f"The name must end in {known.suffix}" if known.suffix else "Name a new folder"
            check_film(file, size=settings.size, fps=settings.fps, codec=settings.codec)
        except InputError as error:
            return str(error)
        return ""

    def choose(self, **changes: Any) -> None:
        """Changes settings of the export; the file's name follows the format."""
        self.settings = replace(self.settings, **changes)
        if "format" in changes:
            known = FORMATS[self.settings.format]
            if self.settings.codec not in known.codecs:
                self.settings = replace(self.settings, codec=None)
            if self.file:
                self.file = str(next_free(Path(self.file).with_suffix(known.suffix)))


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
    if path is None:
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


def choose_path_to_save(app: AppState) -> None:
    if app.feature(Film).path is None:
        app.tell("There are no keyframes yet")
        return
    name = f"{picture_stem(app)}-path.json"
    app.choose_files(
        "Save the camera path", lambda paths: app.post(save_path, paths[0]), kind="save_camera", name=name
    )


def save_path(app: AppState, file: Path) -> None:
    film = app.feature(Film)
    if film.path is None:
        return
    file = file if file.suffix.lower() == ".json" else file.with_name(f"{file.name}.json")
    try:
        save_camera_path(film.path, file, fps=film.settings.fps, size=film.settings.size)
    except InputError as error:
        app.complain(str(error))
    else:
        app.tell(f"Camera path saved: {file}")


def open_dialog(app: AppState) -> None:
    film = app.feature(Film)
    if film.path is None:
        app.tell("There are no keyframes yet")
        return
    if not film.file:
        suffix = FORMATS[film.settings.format].suffix
        film.file = str(next_free(picture_folder(app) / f"{picture_stem(app)}-film{suffix}"))
    app.dialog = DIALOG


def choose_place(app: AppState) -> None:
    """Asks for the film's file by the system's dialog."""
    film = app.feature(Film)
    suffix = FORMATS[film.settings.format].suffix

    def take(paths: list[Path]) -> None:
        chosen = paths[0]
        right = chosen.suffix.lower() == suffix
        film.file = str(chosen if right else chosen.with_name(f"{chosen.name}{suffix}"))

    app.choose_files("Export the film as", take, kind="save_film", name=Path(film.file).name)


def film_cameras(app: AppState, path: CameraPath, fps: float, size: tuple[int, int]) -> list[Camera]:
    """The camera of each frame, through the lens of the window's view."""
    cameras = []
    for time in path.frame_times(fps):
        camera = view_of(path.pose(float(time)), app.view).camera(*size)
        if camera.orthographic:
            camera = stepped_back(camera, app.scene.centre, app.scene.radius)
        cameras.append(camera)
    return cameras


def start_export(app: AppState) -> None:
    """Renders and writes the film in a thread; the window goes on."""
    film = app.feature(Film)
    if film.export is not None or film.problem() or film.path is None or not app.is_open:
        return
    settings, plan = film.settings, Plan(settings=app.settings)
    file = Path(os.path.expanduser(film.file))
    cameras = film_cameras(app, film.path, settings.fps, settings.size)
    scene = WindowScene(app, lambda: task_cancelled(film), film.wake)
    if scene.edits is not None:  # which the user may go on with
        scene.edits = replace(scene.edits, marks=scene.edits.marks.copy())
    film.playing = False

    def work(task: Task[str]) -> str:
        with film_writer(file, size=settings.size, fps=settings.fps, codec=settings.codec) as write:
            for number, camera in enumerate(cameras):
                if task.cancelled:
                    raise Cancelled
                task.report(number / len(cameras), f"Frame {number + 1:,} of {len(cameras):,}")
                write(levels(scene.draw(camera, plan)[0]))
                film.wake()
        return one_line(f"{file}, {len(cameras):,} frames")

    film.export = Task(work, name="splatview-film", on_done=film.wake)


def task_cancelled(film: Film) -> bool:
    return film.export is not None and film.export.cancelled


_a_scene = needs(lambda app: app.is_open, "Open a scene first")
_a_path = needs(lambda app: app.feature(Film).path is not None, "Add keyframes first")
_a_choice = needs(lambda app: app.feature(Film).chosen >= 0, "Choose a keyframe first")


def _command(
    id: str,
    keys: str,
    title: str,
    run: Callable[[AppState], object],
    menu: str,
    *words: str,
    lacks: Callable[[AppState], str] = _a_path,
    checked: Callable[[AppState], bool] = lambda app: False,
) -> Command:
    return Command(
        id=id,
        title=title,
        group="Film",
        run=run,
        keys=tuple(keys.split()),
        menu=menu,
        words=words,
        lacks=lacks,
        checked=checked,
    )


# fmt: off
COMMANDS = (
    _command("add_keyframe", "Ctrl+K", "Keyframe: add one with this view to the film", add_keyframe,
        "Add keyframe", "key frame", "add key", "insert keyframe", lacks=_a_scene),
    _command("update_keyframe", "Ctrl+Shift+K", "Update the chosen keyframe: it gets this view",
        update_keyframe, "Update keyframe", "change keyframe", lacks=_a_choice),
    _command("delete_keyframe", "", "Delete the chosen keyframe of the film", delete_keyframe,
        "Delete keyframe", "remove keyframe", lacks=_a_choice),
    _command("next_keyframe", "Ctrl+Right", "Next keyframe of the film", partial(step_keyframe, by=1),
        "Next keyframe"),
    _command("previous_keyframe", "Ctrl+Left", "Previous keyframe of the film", partial(step_keyframe, by=-1),
        "Previous keyframe"),
    _command("play_film", "Shift+Space", "Play or pause the film", play_or_pause, "Play", "play film",
        "preview film", checked=lambda app: app.feature(Film).playing),
    _command("loop_film", "", "Loop: the film ends where it begins", toggle_loop, "Loop",
        checked=lambda app: (path := app.feature(Film).path) is not None and path.loop),
    _command("undo_film", "", "Undo the last change of the film's keyframes", undo, "Undo",
        lacks=needs(lambda app: app.feature(Film).can_undo, "Nothing to undo")),
    _command("turntable", "", "Turntable: a film once round what is seen, evenly", make_turntable,
        "Turntable", "orbit animation", "360", "spin", lacks=_a_scene),
    _command("open_camera_path", "", "Open a camera path of nerfstudio, SuperSplat or this program",
        choose_path_to_open, "Open camera path...", "load camera path", lacks=_a_scene),
    _command("save_camera_path", "", "Save the camera path, as nerfstudio and Blender read it",
        choose_path_to_save, "Save camera path..."),
    _command("export_film", "Ctrl+Shift+F12", "Export the film as a video, a GIF or PNG files", open_dialog,
        "Export film...", "video", "movie", "render film", "export video", "mp4", "gif"),
)
# fmt: on
