"""Captures by the ``cameras.json`` that the 3DGS trainer (Kerbl et al. 2023) writes beside its results."""

from __future__ import annotations

from pathlib import Path

from ..files import load_cameras
from .ply_points import first_points
from .posed import PosedPhotos, Shot, find_mask, find_photo, tidy_name

FILE_NAME = "cameras.json"

POINTS = ("input.ply", "points3d.ply")
"""Where that trainer keeps the points that it started from."""


def read_camera_list(folder: Path, path: Path) -> PosedPhotos:
    """The capture in `folder` by the list of cameras at `path`. Raises InputError.

    The list gives the photos' names, with or without suffix, but not where they are: looked at are
    ``images``, ``input`` and the folder itself.
    """
    cameras = load_cameras(path)
    places = (folder / "images", folder / "input", folder)
    photos = next((p for p in places if any(find_photo(p, camera.name) for camera in cameras)), places[0])
    shots, missing = [], []
    for camera in cameras:
        name, photo = tidy_name(camera.name), find_photo(photos, camera.name)
        if photo is None:
            missing.append(name)
            continue
        shots.append(Shot(name=name, path=photo, camera=camera, mask=find_mask(folder, name)))
    points, colours, warnings = first_points(folder, (), POINTS)
    return PosedPhotos(
        source=path,
        images=photos,
        shots=shots,
        missing=missing,
        points=points,
        point_colours=colours,
        warnings=warnings,
    )
