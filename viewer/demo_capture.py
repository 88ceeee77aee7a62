"""The photos of `splatview train --demo`: pictures by the program, made once in the user's cache folder."""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path

from ..raster import render
from ..scene import InputError
from ..scene import captures as captures_package
from ..scene.captures.demo import demo_capture
from ..scene.captures.write import save_capture
from .demo_cache import cached_demo, demo_stamp
from .folders import cache_folder

PREFIX = "demo-photos-"

PHOTOS, WIDTH, HEIGHT = 40, 400, 300
"""Enough to show the scene from all the places on its arcs, and few enough to be drawn in seconds."""


def cached_demo_capture(*, progress: Callable[[float], None] = lambda share: None) -> Path:
    """A folder with pictures of the demo scene, their poses and points, as `load_capture` reads it.

    It appears whole or not at all; earlier versions' folders are removed. `progress` gets the share done.

    Raises:
        InputError: the folder cannot be written.
    """
    folder = cache_folder() / f"{PREFIX}{_stamp()}" / "demo"
    if _is_whole(folder):
        return folder
    capture = demo_capture(
        render, truth=cached_demo(), photos=PHOTOS, width=WIDTH, height=HEIGHT, progress=progress
    )
    try:
        cache_folder().mkdir(parents=True, exist_ok=True)
        for old in cache_folder().glob(f"{PREFIX}*"):
            if old != folder.parent or not _is_whole(folder):
                shutil.rmtree(old, ignore_errors=True)
        with tempfile.TemporaryDirectory(dir=cache_folder(), prefix=".demo-") as made:
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
    for name in ("demo.py", "write.py"):
        digest.update(resources.files(captures_package).joinpath(name).read_bytes())
    return digest.hexdigest()[:16]
