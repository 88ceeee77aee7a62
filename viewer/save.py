"""Pictures, cameras, camera paths and films to files."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from splatview.measure.knobs import Plan
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, InputError
from splatview.scene.camera import stepped_back
from splatview.scene.camera_path import CameraPath
from splatview.scene.camera_path_files import save_camera_path
from splatview.scene.depth_of_field import Aperture, mean_picture
from splatview.scene.errors import one_line
from splatview.scene.film import FORMATS, check_film, film_format, film_writer
from splatview.scene.formats import save_camera
from splatview.scene.formats.io import atomic_write
from splatview.scene.progress import Cancelled
from splatview.viewer.depth_of_field import SAVED_SAMPLES, DepthOfField, is_pinhole
from splatview.viewer.editing.session import at_rest, session_of
from splatview.viewer.film import Film, view_of
from splatview.viewer.loading import LoadedScene
from splatview.viewer.quality.measurement import WindowScene
from splatview.viewer.state import AppState, Feature
from splatview.viewer.tasks import Task
from splatview.viewer.training.live import LiveTraining

MAX_SIDE = 8192
"""Px: larger than this and common GL implementations refuse the target."""


def screenshot(app: AppState) -> None:
    """Saves what is seen, without panels, beside the scene; never over an existing file."""
    save_picture(app, app.camera, next_free(picture_folder(app) / f"{picture_stem(app)}.png"))


def save_picture(app: AppState, camera: Camera, path: Path) -> None:
    """Renders `camera` at full quality into the PNG `path`, and says where it is."""
    try:
        session = session_of(app)
        edits = session.document.edits if session else None
        picture, aperture = app.picture, app.feature(DepthOfField).aperture(app)

        def read(camera: Camera) -> np.ndarray:
            return picture.read(FrameRequest(None, camera, app.seen_settings, mode=app.mode, edits=edits))

        if aperture is None or not is_pinhole(camera):
            image = read(camera)
        else:
            image = mean_picture(read, camera, aperture, SAVED_SAMPLES)
        write_png(path, image)
    except InputError as error:
        app.complain(str(error))
    else:
        app.tell(f"Picture saved: {path}")


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The view on width x height px with square pixels: another aspect ratio shows more or less at the
    sides, and what is above and below stays."""
    scale = height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=width / 2 + (camera.cx - camera.width / 2) * scale,
        cy=camera.cy * scale,
    )


def picture_folder(app: AppState) -> Path:
    """Beside the scene, or where the program was started."""
    return app.scene_path.parent if app.scene_path else Path.cwd()


def picture_stem(app: AppState) -> str:
    return app.scene_path.stem if app.scene_path else "splatview"


def next_free(path: Path) -> Path:
    """`path`, or with -2, -3, ... before its suffix the first that does not exist."""
    number, candidate = 1, path
    while os.path.lexists(candidate):
        number += 1
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return candidate


def write_png(path: Path, image: np.ndarray) -> None:
    """Writes the colours of `image` (H, W, 4) float, clipped to [0, 1], as 8-bit RGB, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    with atomic_write(path) as file:
        Image.fromarray(levels(image)).save(file, format="PNG")


def levels(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: the colours of `image` (H, W, 4) float, clipped to [0, 1] and rounded."""
    return (np.clip(np.nan_to_num(image[..., :3]), 0, 1) * 255 + 0.5).astype(np.uint8)


def save_current_camera(app: AppState, path: Path) -> None:
    """Writes the view as CAM.json, for `splatview render --camera`."""
    try:
        save_camera(app.camera, path)
    except InputError as error:
        app.complain(str(error))
    else:
        app.tell(f"Camera saved: {path}")


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


# ---- The film, by the window's own renderer, in a thread beside the frame loop.


FILM_DIALOG = "film"

LONGEST_END = 10.0
"""Seconds that a film which is stopped may take to remove what is half written, as the window closes."""


class FilmExport(Feature):
    """Where the film goes, and the export under way."""

    wake: Callable[[], object] = lambda: None

    def __init__(self) -> None:
        self.file = ""
        """As it is typed."""
        self.task: Task[str] | None = None

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self.file = ""

    def before_frame(self, app: AppState) -> None:
        task = self.task
        if task is None or not task.done:
            return
        self.task = None
        if isinstance(task.error, InputError):
            app.complain(str(task.error))
        elif task.cancelled:
            app.tell("The film was stopped; nothing is written")
        elif isinstance(task.error, Cancelled):
            app.complain("The film was stopped, as another scene is shown now; nothing is written")
        elif isinstance(task.error, Exception):
            app.fail(task.error)
        else:
            app.tell(f"Film saved: {task.result}")

    def busy(self, app: AppState) -> bool:
        return self.task is not None

    def cancel(self, app: AppState) -> bool:
        if self.task is not None:
            self.task.cancel()
        return self.task is not None

    def close(self, app: AppState) -> None:
        if self.task is not None:
            self.task.cancel()
            self.task.join(LONGEST_END)

    def choose(self, film: Film, **changes: Any) -> None:
        """Changes settings of the film; the file's name follows the format."""
        film.settings = replace(film.settings, **changes)
        if "format" in changes:
            known = FORMATS[film.settings.format]
            if film.settings.codec not in known.codecs:
                film.settings = replace(film.settings, codec=None)
            if self.file:
                self.file = str(next_free(Path(self.file).with_suffix(known.suffix)))

    def problem(self, app: AppState, film: Film) -> str:
        """What is in the way of an export, in a line; "" where nothing is."""
        settings = film.settings
        if film.path is None:
            return "Add keyframes first"
        if app.find(LiveTraining) is not None and not at_rest(app):
            return "Stop the training first, as its scene changes"
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


def open_film_dialog(app: AppState) -> None:
    film, made = app.feature(Film), app.feature(FilmExport)
    if film.path is None:
        app.tell("There are no keyframes yet")
        return
    if not made.file:
        suffix = FORMATS[film.settings.format].suffix
        made.file = str(next_free(picture_folder(app) / f"{picture_stem(app)}-film{suffix}"))
    app.dialog = FILM_DIALOG


def choose_film_place(app: AppState) -> None:
    """Asks for the film's file by the system's dialog."""
    made = app.feature(FilmExport)
    suffix = FORMATS[app.feature(Film).settings.format].suffix

    def take(paths: list[Path]) -> None:
        chosen = paths[0]
        right = chosen.suffix.lower() == suffix
        made.file = str(chosen if right else chosen.with_name(f"{chosen.name}{suffix}"))

    app.choose_files("Export the film as", take, kind="save_film", name=Path(made.file).name)


def film_cameras(
    app: AppState, path: CameraPath, fps: float, size: tuple[int, int]
) -> list[tuple[Camera, Aperture | None]]:
    """The camera of each frame, through the lens of the window's view; and its aperture, where the window
    has one."""
    cameras, lens = [], app.feature(DepthOfField)
    for time in path.frame_times(fps):
        view = view_of(path.pose(float(time)), app.view)
        camera = view.camera(*size)
        if camera.orthographic:
            camera = stepped_back(camera, app.scene.centre, app.scene.radius)
        cameras.append((camera, lens.aperture(app, view) if is_pinhole(camera) else None))
    return cameras


def start_film(app: AppState) -> None:
    """Renders and writes the film in a thread; the window goes on."""
    film, made = app.feature(Film), app.feature(FilmExport)
    if made.task is not None or made.problem(app, film) or film.path is None or not app.is_open:
        return
    settings, plan = film.settings, Plan(settings=app.settings)
    file = Path(os.path.expanduser(made.file))
    cameras = film_cameras(app, film.path, settings.fps, settings.size)
    scene = WindowScene(app, lambda: made.task is not None and made.task.cancelled, made.wake, mode=app.mode)
    if scene.edits is not None:  # which the user may go on with
        scene.edits = replace(scene.edits, marks=scene.edits.marks.copy())
    film.playing = False

    def draw(camera: Camera) -> np.ndarray:
        return scene.draw(camera, plan)[0]

    def work(task: Task[str]) -> str:
        with film_writer(file, size=settings.size, fps=settings.fps, codec=settings.codec) as write:
            for number, (camera, aperture) in enumerate(cameras):
                if task.cancelled:
                    raise Cancelled
                task.report(number / len(cameras), f"Frame {number + 1:,} of {len(cameras):,}")
                if aperture is None:
                    image = draw(camera)
                else:
                    image = mean_picture(draw, camera, aperture, SAVED_SAMPLES)
                write(levels(image))
                made.wake()
        return one_line(f"{file}, {len(cameras):,} frames")

    made.task = Task(work, name="splatview-film", on_done=made.wake)
