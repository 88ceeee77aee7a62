"""Files of photos: folders that hold them, copies in another size, duplicates, and photos without a pose.

Poses are often found on photos in full size, and smaller copies kept beside them, in ``images_2``,
``images_4`` and ``images_8`` (LLFF, Mip-NeRF 360, nerfstudio), or in their place.
"""

from __future__ import annotations

import filecmp
import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from splatview.scene.captures.capture import (
    AT_ONCE,
    SUFFIXES,
    PosedPhoto,
    PosedPhotos,
    intrinsics_of,
    some,
)
from splatview.scene.captures.photos import are_copies, image_size
from splatview.scene.errors import InputError
from splatview.scene.progress import Progress

FOLDERS = ("images", "input")
"""Folders of photos in a capture's."""

SMALLER = "images_"
"""How folders of smaller copies begin; the factor follows."""


def photo_folders(folder: Path) -> Iterator[Path]:
    """Where the photos of a capture in `folder` may be, the largest first."""
    yield from (folder / name for name in FOLDERS)
    try:
        found = [name for name in os.listdir(folder) if name.startswith(SMALLER)]
    except OSError:
        found = []
    factors = {int(rest): name for name in found if (rest := name[len(SMALLER) :]).isdecimal()}
    yield from (folder / factors[factor] for factor in sorted(factors))
    yield folder


def may_hold_photos(folder: Path) -> bool:
    """Whether a capture's folder has one for photos, or photos itself."""
    return any(os.path.isdir(place) for place in photo_folders(folder) if place != folder) or bool(
        pictures_in(folder)
    )


def pictures_in(folder: Path) -> list[str]:
    """Names of the files in a folder that are photos by their suffix; none where it cannot be read."""
    try:
        with os.scandir(folder) as entries:
            return [one.name for one in entries if one.name.lower().endswith(SUFFIXES) and one.is_file()]
    except OSError:
        return []


def unposed(posed: PosedPhotos) -> str | None:
    """A line about photos that lie beside the capture's and have no pose, as where a reconstruction did not
    find it; None where there are none. Looked at are folders for photos alone, as others hold more, and no
    captures in parts, of which one may not be used."""
    if posed.source.name == "transforms_train.json":
        return None
    used: dict[Path, set[str]] = {}
    for entry in posed.entries:
        used.setdefault(entry.path.parent, set()).add(entry.path.name)
    without, total = [], 0
    for folder, names in used.items():
        if any(part in FOLDERS or part.startswith(SMALLER) for part in folder.parts[-2:]):
            found = pictures_in(folder)
            total += len(found)
            without += sorted(name for name in found if name not in names)
    if not without:
        return None
    return f"{len(without)} of {total} photos have no pose and are not used: {some(without)}"


def without_duplicates(posed: PosedPhotos) -> PosedPhotos:
    """The capture without photos whose file and pose are those of another, of which one that is trained on
    stays where there is one. Some files hold out what they train on: where all that is held out would go,
    nothing is by them."""
    by_pose: dict[tuple, list[PosedPhoto]] = {}
    for entry in sorted(posed.entries, key=lambda entry: entry.held_out is True):
        pose = entry.camera.world_to_camera.tobytes(), intrinsics_of(entry.camera)
        by_pose.setdefault(pose, []).append(entry)
    duplicates: set[str] = set()
    for alike in by_pose.values():
        if len(alike) > 1:  # files are looked at only then
            duplicates |= _duplicates(alike)
    if not duplicates:
        return posed
    left = [entry for entry in posed.entries if entry.name not in duplicates]
    if any(entry.held_out for entry in posed.entries) and not any(entry.held_out for entry in left):
        left = [replace(entry, held_out=None) for entry in left]
    names = some(sorted(duplicates))
    warning = f"{len(duplicates)} photos are duplicates of others, with their pose, and are left out: {names}"
    return replace(posed, entries=left, warnings=[*posed.warnings, warning])


def _duplicates(entries: Sequence[PosedPhoto]) -> set[str]:
    """Names of the photos whose file is that of one before, of another name."""
    kept: dict[int, list[PosedPhoto]] = {}
    duplicates = set()
    for entry in entries:
        try:
            # A camera that stands still has many frames, and hardly two of them are of one size.
            of_size = kept.setdefault(entry.path.stat().st_size, [])
            others = (other.path for other in of_size if other.name != entry.name)
            if any(filecmp.cmp(entry.path, other, shallow=False) for other in others):
                duplicates.add(entry.name)
            else:
                of_size.append(entry)
        except OSError:  # whoever reads the photos says so
            continue
    return duplicates


def fitted_to_copies(posed: PosedPhotos, progress: Progress) -> PosedPhotos:
    """The capture with cameras as large as the files are, where these are copies in another size of what was
    posed. What else differs is told when photos are read. Raises Cancelled."""
    entries, first = list(posed.entries), None
    count = 0
    for i, entry in enumerate(entries):
        if i % AT_ONCE == 0:
            progress.check()
        size = None if entry.face is not None else _size_of_copy(entry)
        if size is not None:
            entries[i] = replace(entry, camera=entry.camera.resized(*size))
            first, count = first or (entry, size), count + 1
    if first is None:
        return posed
    (entry, size), camera = first, first[0].camera
    warning = (
        f"{count} photos are copies in another size of those that poses were found with ({entry.name} has"
        f" {size[0]}x{size[1]} pixels, its camera {camera.width}x{camera.height}); their cameras are scaled"
    )
    return replace(posed, entries=entries, warnings=[*posed.warnings, warning])


def _size_of_copy(entry: PosedPhoto) -> tuple[int, int] | None:
    """Width and height of the file the way that it was posed; None where that is the camera's size, or is no
    copy of it."""
    posed = entry.camera.width, entry.camera.height
    try:
        stored = image_size(entry.path)
    except InputError:
        return None
    # The second: photos that EXIF turns, and were posed so.
    ways = [stored, (stored[1], stored[0])]
    return None if posed in ways else next((size for size in ways if are_copies(size, posed)), None)
