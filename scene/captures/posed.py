"""What the readers of the formats hand on: where each photo lies and how it was taken."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..camera import Camera

SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp")
"""Of photos whose names come without."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Shot:
    """A photo on disk with its pose."""

    name: str
    path: Path
    camera: Camera
    """With its lens, at the size of the file."""
    mask: Path | None = None
    held_out: bool | None = None
    """None: the capture does not say."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PosedPhotos:
    """All that a capture says, before its photos are read."""

    source: Path
    """The file or folder that names the photos."""
    images: Path
    """Where they were looked for."""
    shots: Sequence[Shot]
    missing: Sequence[str] = ()
    """Photos with a pose that are not on disk."""
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    """(P, 3) float64, any values."""
    point_colours: np.ndarray = field(default_factory=lambda: np.empty((0, 3), dtype=np.uint8))
    """(P, 3) uint8."""
    warnings: Sequence[str] = ()


def find_photo(folder: Path, name: str) -> Path | None:
    """The photo `name` in `folder`, its suffix added where it has none; None where there is none."""
    path = folder / name.replace("\\", "/")
    candidates = [path, *(path.with_name(path.name + suffix) for suffix in SUFFIXES)]
    return next((candidate for candidate in candidates if _is_file(candidate)), None)


def find_mask(capture: Path, name: str) -> Path | None:
    """The mask of photo `name` in the capture's ``masks`` folder.

    It has the photo's name, the same with ".png" behind it (COLMAP's way), or with another suffix.
    `name` is relative to the folder of the photos, whatever that is called.
    """
    folder = capture / "masks"
    path = folder / name.replace("\\", "/")
    candidates = [
        path,
        path.with_name(path.name + ".png"),
        *(path.with_suffix(suffix) for suffix in SUFFIXES),
    ]
    return next((candidate for candidate in candidates if _is_file(candidate)), None)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        # A name that no file can have (too long, a zero byte) is the name of none.
        return False


def tidy_name(name: str) -> str:
    """`name` with forward slashes and without "./" in front."""
    return os.path.normpath(name.replace("\\", "/")).replace(os.sep, "/")
