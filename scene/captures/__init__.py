"""Captures: photos with known cameras, from the formats that reconstruction tools write."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from splatview.scene.captures.assemble import FILE_NAME, capture_name, capture_of, read_camera_list
from splatview.scene.captures.capture import DEFAULT_LENS_USE, Capture, LensUse, MaskUse, PosedPhotos
from splatview.scene.captures.colmap import (
    find_colmap,
    find_part_of_colmap,
    find_undistorted,
    read_colmap,
)
from splatview.scene.captures.llff import POSES_BOUNDS, read_poses_bounds
from splatview.scene.captures.nerfstudio import find_transforms, read_transforms
from splatview.scene.captures.photo_files import (
    fitted_to_copies,
    may_hold_photos,
    unposed,
    without_duplicates,
)
from splatview.scene.errors import InputError
from splatview.scene.progress import NO_PROGRESS, Progress


def load_capture(
    path: str | os.PathLike[str],
    *,
    downscale: int | Callable[[PosedPhotos], int] = 1,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    lens: LensUse = DEFAULT_LENS_USE,
    masks: MaskUse = "ignore",
    progress: Progress = NO_PROGRESS,
) -> Capture:
    """The capture in a folder, or by its .json or .npy file; all photos are read once, so damage shows early.

    Photos become floor(w / downscale) x floor(h / downscale) by averaging areas, and `downscale` may choose
    by what the capture says before its photos are read, or raise; `lens` says what is done about distortion,
    `masks` what masks mean; transparent photos are laid over `background`, RGB in 0..1. Every 8th photo by
    sorted name, starting with the first, is held out unless the capture says which.

    Raises:
        InputError: there is no capture, or a part of it is damaged or does not fit the rest; or masks are to
            cut out, and there are none.
        Cancelled: nobody waits for it any more.
    """
    if not (callable(downscale) or (downscale >= 1 and downscale == int(downscale))):
        raise InputError(f"photos can be downscaled by a whole number of at least 1, not {downscale}")
    path = Path(path)
    # Numbers out of all bounds are told once they are put together, as what is wrong with the capture.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        folder, posed = read_poses(path, progress.part(0.0, POSES))
        return capture_of(
            posed,
            name=capture_name(folder),
            downscale=downscale(posed) if callable(downscale) else downscale,
            background=background,
            lens=lens,
            masks=masks,
            progress=progress.part(POSES, 1.0),
        )


POSES = 0.05
"""Share of the work that finding the photos is taken to be."""


def read_poses(path: Path, progress: Progress) -> tuple[Path, PosedPhotos]:
    """The folder of the capture and what it says, with cameras of the size of the photos' files. Raises
    InputError, Cancelled."""
    folder, posed = _read_poses(path, progress)
    posed, note = without_duplicates(fitted_to_copies(posed, progress)), unposed(posed)
    return folder, posed if note is None else replace(posed, warnings=[*posed.warnings, note])


def _read_poses(path: Path, progress: Progress) -> tuple[Path, PosedPhotos]:
    """COLMAP first: of several captures in one folder it is the one that has points."""
    if os.path.isfile(path) and path.suffix.lower() == ".json":
        if path.name == FILE_NAME:
            return path.parent, read_camera_list(path.parent, path)
        return path.parent, read_transforms(path.parent, [(path, None)], progress)
    if path.name == POSES_BOUNDS and os.path.isfile(path):
        return path.parent, read_poses_bounds(path.parent, path, progress)
    if not os.path.isdir(path):
        problem = "is no capture; name its folder" if os.path.lexists(path) else "no such folder"
        raise InputError(f"{path}: {problem}")
    model, undistorted = find_colmap(path), find_undistorted(path)
    # In a workspace of COLMAP's the model may be of photos that are elsewhere.
    if model is not None and (undistorted is None or may_hold_photos(path)):
        return path, read_colmap(path, model, progress)
    transforms = find_transforms(path)
    if transforms:
        return path, read_transforms(path, transforms, progress)
    if os.path.isfile(path / FILE_NAME):
        return path, read_camera_list(path, path / FILE_NAME)
    if os.path.isfile(path / POSES_BOUNDS):
        return path, read_poses_bounds(path, path / POSES_BOUNDS, progress)
    if undistorted is not None:
        return path, _read_poses(undistorted, progress)[1]
    part = find_part_of_colmap(path)
    if part is not None:
        raise InputError(
            f"{part}: lacks images.bin or images.txt, the poses; copy or export all of the model"
        )
    raise InputError(
        f"{path}: holds no capture: neither a COLMAP model (sparse/0) nor transforms.json, "
        f"transforms_train.json, {FILE_NAME} or {POSES_BOUNDS}; photos alone need poses first, by COLMAP say"
    )
