"""Captures with a ``poses_bounds.npy``: those of LLFF, as NeRF's forward-facing scenes come in.

Format: the README of LLFF (Mildenhall et al. 2019), "Using your own poses without running COLMAP". A row for
each photo, by sorted name: 3x5 numbers, and the nearest and farthest depth that the photo shows. The first
three columns are the camera's axes in the world, down, right and backward, the fourth is its place, and the
fifth height, width and focal length of the photos that were posed, px. A lens is not told, nor are photos.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.captures.capture import (
    AT_ONCE,
    Files,
    PosedPhoto,
    PosedPhotos,
    check_photos,
    some,
)
from splatview.scene.captures.colmap import find_part_of_colmap, read_points
from splatview.scene.captures.photo_files import photo_folders, pictures_in
from splatview.scene.captures.photos import image_size
from splatview.scene.errors import InputError
from splatview.scene.formats.io import require_regular_file
from splatview.scene.progress import Progress

POSES_BOUNDS = "poses_bounds.npy"

COLUMNS = 17

SHAPE_TOLERANCE = 0.02
"""Relative difference of a photo's scales across and down from the size that was posed: smaller copies are
rounded to whole pixels."""


def read_poses_bounds(folder: Path, path: Path, progress: Progress) -> PosedPhotos:
    """The capture in `folder` by the poses at `path`. Points are those of a COLMAP model that lies there
    without its images, for LLFF leaves COLMAP's world as it is. Raises InputError, Cancelled."""
    rows = _rows(path)
    images, names = _photos(folder, len(rows))
    if not names:
        check_photos(path, images, (), [f"photo {i + 1}" for i in range(len(rows))])
    if len(names) != len(rows):
        raise InputError(
            f"{path}: has {len(rows)} poses for {len(names)} photos in {images} ({some(names)}); poses are"
            " told by the order of names alone, so all of these photos must be there, and no others"
        )
    masks, entries = Files(folder / "masks"), []
    for i, (name, row) in enumerate(zip(names, rows, strict=True)):
        if i % AT_ONCE == 0:
            progress.step(i / len(rows))
        photo = images / name
        try:
            camera = _camera(row[:15].reshape(3, 5), photo, name)
        except (ValueError, OverflowError) as error:
            raise InputError(f"{path}: row {i} ({name}): {error}") from None
        entries.append(PosedPhoto(name=name, path=photo, camera=camera, mask=masks.mask(name)))
    model = find_part_of_colmap(folder)
    points = {} if model is None else dict(zip(("points", "point_colours"), read_points(model), strict=True))
    return PosedPhotos(source=path, images=images, entries=entries, **points)


def _rows(path: Path) -> np.ndarray:
    """(N, 17) float64. Raises InputError."""
    require_regular_file(path)
    try:
        # Mapped, so that a header cannot claim more memory than there is file.
        rows = np.lib.format.open_memmap(path, mode="r")
    except Exception:
        # Headers are Python's text: damaged ones raise ValueError, TypeError, tokenize.TokenError...
        raise InputError(f"{path}: is no array of numpy, or damaged; copy or make it again") from None
    if not (rows.ndim == 2 and rows.shape[1] == COLUMNS and rows.dtype.kind in "fiu"):
        raise InputError(f"{path}: must be N x {COLUMNS} numbers, not {rows.dtype} of shape {rows.shape}")
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array(rows, dtype=np.float64)


def _photos(folder: Path, count: int) -> tuple[Path, list[str]]:
    """The folder of the photos and their names, sorted: the first that has as many as asked for, else the
    first that has any."""
    first: tuple[Path, list[str]] | None = None
    for place in photo_folders(folder):
        names = sorted(pictures_in(place))
        if len(names) == count:
            return place, names
        if names and first is None:
            first = place, names
    return first or (folder / "images", [])


def _camera(columns: np.ndarray, photo: Path, name: str) -> Camera:
    """By (3, 5) numbers. Raises InputError, or ValueError of `Camera`."""
    down, right, backward, eye, (height, width, focal) = columns.T
    if not (np.isfinite(columns).all() and min(height, width, focal) > 0):
        raise ValueError("its numbers must be finite, its height, width and focal length more than 0")
    stored = image_size(photo)
    # The second: photos that EXIF turns, and were posed so.
    misfit, size = min((abs(w / width / (h / height) - 1), (w, h)) for w, h in (stored, stored[::-1]))
    if not misfit <= SHAPE_TOLERANCE:
        raise ValueError(
            f"the photo has {stored[0]}x{stored[1]} px, which is no smaller copy of the {width:g}x{height:g}"
            " px that were posed"
        )
    matrix = np.eye(4)
    matrix[:3, :3] = right, down, -backward
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return Camera(
        width=size[0],
        height=size[1],
        fx=focal * size[0] / width,
        fy=focal * size[1] / height,
        cx=size[0] / 2,
        cy=size[1] / 2,
        world_to_camera=matrix,
        name=name,
    )
