"""The bundled demo, made once and then read back: five seconds of numpy become a tenth of a second."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import shutil
import tempfile
from importlib import resources
from pathlib import Path

import numpy as np

from splatview.raster import render
from splatview.scene import Gaussians, InputError, demo
from splatview.scene.captures import demo as capture_demo
from splatview.scene.captures import nerfstudio
from splatview.scene.captures.demo import demo_capture
from splatview.scene.captures.nerfstudio import save_capture
from splatview.scene.demo import demo_scene
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.scene.user_dirs import cache_folder

PATTERN = "demo-*.ply"


def demo_stamp() -> str:
    """Changes with anything that the demo's values depend on: its sources, and numpy's random numbers."""
    digest = hashlib.sha256(np.__version__.encode())
    for source in sorted(resources.files(demo).iterdir(), key=lambda entry: entry.name):
        if source.name.endswith(".py"):
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def cached_demo(*, progress: Progress = NO_PROGRESS) -> Gaussians:
    """`demo_scene()`, bit for bit, from the user's cache folder where it was made before.

    A cache that cannot be read or written costs only time. Earlier versions' files are removed.

    Raises:
        Cancelled: nobody waited any more while the cached file was read.
    """
    path = cache_folder() / PATTERN.replace("*", demo_stamp())
    if path.exists():
        with contextlib.suppress(InputError):
            return load_scene(path, progress=progress)
    gaussians = demo_scene()
    with contextlib.suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        for old in path.parent.glob(PATTERN):
            old.unlink(missing_ok=True)
        save_scene(gaussians, path)
    return gaussians


PREFIX = "demo-photos-"

PHOTOS, WIDTH, HEIGHT = 40, 400, 300
"""Enough to show the scene from all the places on its arcs, and few enough to be drawn in seconds."""


def cached_demo_capture(*, progress: Progress = NO_PROGRESS) -> Path:
    """A folder with pictures of the demo scene, their poses and points, as `load_capture` reads it.

    It appears whole or not at all; earlier versions' folders are removed.

    Raises:
        InputError: the folder cannot be written.
    """
    folder = cache_folder() / f"{PREFIX}{_stamp()}" / "demo"
    if _is_whole(folder):
        return folder
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        for old in cache_folder().glob(f"{PREFIX}*"):
            if old != folder.parent or not _is_whole(folder):
                shutil.rmtree(old, ignore_errors=True)
        with tempfile.TemporaryDirectory(dir=cache_folder(), prefix=".demo-") as made:
            capture = demo_capture(
                render, truth=cached_demo(), photos=PHOTOS, width=WIDTH, height=HEIGHT, progress=progress
            )
            save_capture(capture, Path(made) / "demo")
            folder.parent.mkdir(exist_ok=True)
            try:
                (Path(made) / "demo").rename(folder)
            except OSError:
                # Another process may have been faster; its photos are the same.
                if not _is_whole(folder):
                    raise
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written: {error.strerror or error}; SPLATVIEW_CACHE_DIR names another place"
        ) from None
    return folder


def _is_whole(folder: Path) -> bool:
    return (folder / "transforms.json").is_file()


def _stamp() -> str:
    """Changes with the scene, and with anything else that the photos depend on."""
    digest = hashlib.sha256(f"{demo_stamp()} {PHOTOS} {WIDTH} {HEIGHT}".encode())
    for module in (capture_demo, nerfstudio):
        digest.update(inspect.getsource(module).encode())
    return digest.hexdigest()[:16]
