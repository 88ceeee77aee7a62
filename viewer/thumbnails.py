"""Small pictures: of scenes that were shown, kept in the cache, and of photos; read beside the frame loop."""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import moderngl
import numpy as np
from PIL import Image

from splatview.renderers.request import FrameRequest
from splatview.scene import InputError
from splatview.scene.user_dirs import cache_folder
from splatview.viewer.loading import LoadedScene
from splatview.viewer.save import resized, write_png
from splatview.viewer.state import AppState, Feature
from splatview.viewer.tasks import Task

WIDTH, HEIGHT = 320, 200
"""Px of a kept picture; shown smaller, it stays sharp at twice the DPI."""

SHOWN_SECONDS = 1.0
"""After a scene was opened: what was only passed by gets no picture."""

MOST_BYTES = 40_000_000
"""Of photos that thumbnails are made of; larger files take too long to decode for a glance."""


def thumbnail_file(scene: Path) -> Path:
    """Where the picture of the scene in the file `scene` is kept."""
    digest = hashlib.sha256(os.fsencode(os.path.realpath(scene))).hexdigest()[:24]
    return cache_folder() / "thumbnails" / f"{digest}.png"


class SceneThumbnails(Feature):
    """Keeps a picture of each scene that was looked at for a moment, or was saved."""

    def __init__(self) -> None:
        self._due: float | None = None
        """When to take the next one."""
        self._writing: Task[None] | None = None

    def on_scene_opened(self, app: AppState, scene: LoadedScene) -> None:
        self._due = app.now() + SHOWN_SECONDS if scene.paths else None

    def on_scene_saved(self, app: AppState) -> None:
        self._due = app.now()

    def before_frame(self, app: AppState) -> None:
        if self._due is None or app.now() < self._due or app.scene_path is None:
            return
        if app.loading is not None or app.transition is not None or app.picture.busy:
            return
        self._due = None
        camera, file = resized(app.camera, WIDTH, HEIGHT), thumbnail_file(app.scene_path)
        settings = replace(app.settings, background=(0.0, 0.0, 0.0))
        with contextlib.suppress(InputError):  # a picture that cannot be made is missed by nobody
            image = app.picture.read(FrameRequest(None, camera, settings, edits=app.edits))
            self._writing = Task(lambda _: write_quietly(file, image), name="splatview-thumbnail")

    def close(self, app: AppState) -> None:
        if self._writing is not None:
            self._writing.join(2.0)


def write_quietly(file: Path, image: np.ndarray) -> None:
    """Writes a picture that nobody asked for, or none."""
    with contextlib.suppress(InputError, OSError):
        file.parent.mkdir(parents=True, exist_ok=True)
        write_png(file, image)


def read_picture(path: Path, side: int) -> np.ndarray | None:
    """(H, W, 3) uint8 of at most `side` px each way, from a picture file; None where it is none."""
    try:
        if path.stat().st_size > MOST_BYTES:
            return None
        with Image.open(path) as image:
            image.draft("RGB", (side, side))  # JPEG: decodes fewer pixels
            image.thumbnail((side, side))
            return np.array(image.convert("RGB"))
    except Exception:  # Pillow raises whatever its decoders do
        return None


class Thumbnails:
    """Textures of picture files, read in a thread, a few at a time. For the GL thread."""

    def __init__(self, side: int = WIDTH, on_change: Callable[[], object] = lambda: None):
        """`side`: px of the longer side; `on_change` is called in the thread when one has been read."""
        self._side, self._on_change = side, on_change
        self._wanted: list[Path] = []
        self._textures: dict[Path, moderngl.Texture | None] = {}
        self._task: Task[tuple[Path, np.ndarray | None]] | None = None

    def get(self, path: Path) -> moderngl.Texture | None:
        """The texture of `path`; None while it is read, and where it is no picture. Called in each frame."""
        self._collect()
        if path not in self._textures and path not in self._wanted:
            self._wanted.append(path)
        if self._task is None and self._wanted:
            wanted = self._wanted.pop(0)
            self._task = Task(
                lambda _: (wanted, read_picture(wanted, self._side)),
                name="splatview-thumbnail",
                on_done=self._on_change,
            )
            self._textures[wanted] = None
        return self._textures.get(path)

    @property
    def busy(self) -> bool:
        return self._task is not None or bool(self._wanted)

    def forget(self) -> None:
        """Releases all: they are read again when asked for."""
        for texture in self._textures.values():
            if texture is not None:
                texture.release()
        self._textures.clear()
        self._wanted.clear()
        self._task = None

    def _collect(self) -> None:
        if self._task is None or not self._task.done:
            return
        result, self._task = self._task.result, None
        path, image = result if result is not None else (None, None)
        if path is None or image is None:
            return
        height, width = image.shape[:2]
        texture = moderngl.get_context().texture((width, height), 3, np.ascontiguousarray(image), alignment=1)
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        self._textures[path] = texture
