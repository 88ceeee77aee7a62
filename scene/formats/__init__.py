"""Scenes and cameras from and to files: one module a format."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from splatview.scene.camera import Camera
from splatview.scene.errors import InputError
from splatview.scene.formats.cameras import read_cameras_file, write_camera
from splatview.scene.formats.ply import load_ply, save_ply
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import NO_PROGRESS, Progress

__all__ = [
    "check_saving",
    "load_cameras",
    "load_scene",
    "save_camera",
    "save_scene",
]


def load_scene(
    path: str | os.PathLike[str],
    *,
    progress: Progress = NO_PROGRESS,
) -> Gaussians:
    """The splats in a file; the format is told by its first bytes.

    Raises:
        InputError: the file is missing, damaged or of another kind.
        Cancelled: nobody waits for it any more.
    """
    return load_ply(Path(path), progress)


def save_scene(gaussians: Gaussians, path: str | os.PathLike[str]) -> None:
    """Writes a scene in the format of the suffix, wholly or not at all: an older file stays until then.

    Raises:
        InputError: the suffix names no format that can be written, or the system refuses.
    """
    path = Path(path)
    check_format(path)
    save_ply(gaussians, path)


def check_format(path: Path) -> None:
    """Raises InputError if the suffix names no format that can be written."""
    if path.suffix.lower() != ".ply":
        raise InputError(f"{path}: scenes are saved as .ply; give it that suffix")
    if path.name.lower().endswith(".compressed.ply"):
        raise InputError(f"{path}: compressed .ply cannot be written yet; drop .compressed from the name")


def check_saving(path: Path) -> None:
    """Raises InputError where `save_scene` could not write `path`, so that nobody works on it in vain."""
    check_format(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: is a folder; name a file in it")
        folder = path.resolve().parent
        if not folder.is_dir():
            raise InputError(f"{path}: the folder {folder} does not exist; make it first")
        if not os.access(folder, os.W_OK):
            raise InputError(f"{path}: the folder {folder} cannot be written to")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def load_cameras(
    path: str | os.PathLike[str], *, on_note: Callable[[str], None] | None = None
) -> list[Camera]:
    """The cameras in a file or folder, at least one.

    Read are our own JSON (one camera or a list), the ``cameras.json`` that the 3DGS trainer writes, and
    COLMAP models (a folder, or its ``cameras`` or ``images`` file, .bin or .txt; sorted by image name).
    `on_note` gets a line about each lens that is no pinhole.

    Raises:
        InputError: the file is missing, damaged or of another kind.
    """
    return read_cameras_file(Path(path), on_note or (lambda note: None))


def save_camera(camera: Camera, path: str | os.PathLike[str]) -> None:
    """Writes a camera as JSON that `load_cameras` reads, wholly or not at all. Raises InputError."""
    write_camera(camera, Path(path))
