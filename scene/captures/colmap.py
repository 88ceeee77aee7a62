"""COLMAP captures: a model of cameras, images and points, and a folder of photos.

Format: COLMAP documentation, "Output Format". Files that older versions do not have (rigs, frames) say
nothing about single photos and are not read.
"""

from __future__ import annotations

import io
import os
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from splatview.scene.captures.capture import AT_ONCE, Files, PosedPhoto, PosedPhotos, check_photos, tidy_name
from splatview.scene.captures.panoramas import faces_of, lines_about
from splatview.scene.captures.photo_files import FOLDERS, photo_folders
from splatview.scene.captures.photos import image_size
from splatview.scene.errors import InputError
from splatview.scene.formats.colmap import (
    find_model,
    image_camera,
    image_lens,
    images_file,
    models_in,
    numbered,
    posed_images,
    read_cameras,
    read_images,
)
from splatview.scene.formats.io import excerpt, open_regular
from splatview.scene.progress import Progress

MODEL_FOLDERS = ("", "sparse/0", "sparse", "colmap/sparse/0")

MAX_TEXT_BYTES = 1 << 31

MAX_NAMES_BYTES = 1 << 26

_POINT = np.dtype(
    [("number", "<u8"), ("position", "<f8", 3), ("colour", "u1", 3), ("error", "<f8"), ("track", "<u8")]
)
"""Fixed part of a point; two uint32 for each image in its track follow."""


DISTORTED = "distorted/sparse"
"""Where the 3DGS trainer keeps models of photos whose lens is still in them."""


DENSE = "dense"
"""Where COLMAP puts photos that it takes out of their lens."""


class Model(NamedTuple):
    folder: Path
    photos: int = 0
    """That have a pose in it; 0 where nobody looked."""
    others: Mapping[Path, int] = {}
    """Those beside it that have a photo, and larger ones of before lenses were taken out: a reconstruction
    that falls apart leaves several, and programs go on with the first, which may have two photos."""

    @property
    def warnings(self) -> list[str]:
        """A line about models that are not used."""
        if not self.others:
            return []
        others = ", ".join(f"{path} ({count})" for path, count in self.others.items())
        return [
            f"{self.folder} is trained on, with poses of {self.photos} photos; there are others, which train"
            f" when they are named: {others}"
        ]


def find_colmap(folder: Path) -> Model | None:
    """The model in a capture's folder, of several in ``sparse`` the one with most photos, the first of such;
    None where there is none."""
    for name in MODEL_FOLDERS:
        found = folder / name
        if not name.endswith("/0"):
            if images_file(found) is None:
                continue
            return Model(found)
        models, before = models_in(found.parent), models_in(folder / DISTORTED)
        if not models:
            continue
        if len(models) == 1 and not before:
            return Model(models[0])
        counts = {model: posed_images(model) for model in models}
        most = max(models, key=lambda model: counts[model])
        others = {model: count for model, count in counts.items() if count and model != most}
        larger = {model: posed_images(model) for model in before}
        others |= {model: count for model, count in larger.items() if count > counts[most]}
        return Model(most, counts[most], others)
    return None


def find_undistorted(folder: Path) -> Path | None:
    """The capture in a workspace of COLMAP whose photos have no lens any more: ``dense``, or of ``dense/0``
    and so on, as automatic reconstruction has it, that of most poses; None where there is none."""
    dense = folder / DENSE
    places = [place for place in (dense, *numbered(dense)) if os.path.isdir(place / FOLDERS[0])]
    models = {place: found for place in places if (found := find_colmap(place))}
    return max(models, key=lambda place: posed_images(models[place].folder), default=None)


def find_part_of_colmap(folder: Path) -> Path | None:
    """The folder of a model that lacks its images, as where a large file was not copied, in a capture's
    folder; None where there is none."""
    for name in MODEL_FOLDERS:
        if any(os.path.isfile(folder / name / f"cameras{suffix}") for suffix in (".bin", ".txt")):
            return folder / name
    return None


def read_colmap(folder: Path, found: Model, progress: Progress) -> PosedPhotos:
    """The capture in `folder` whose model was `found`. Raises InputError, Cancelled."""
    model = found.folder
    paths = find_model(model)
    intrinsics = read_cameras(paths[0])
    images = read_images(paths[1], progress.part(0.0, 0.5))
    if not images:
        raise InputError(f"{paths[1]}: holds no images: the reconstruction found no poses")
    root, photos = _photo_folder(folder, model, [image.name for image in images], progress)
    masks = Files(root / "masks")
    held_out = _held_out_names(model)
    entries, missing = [], []
    for number, image in enumerate(images):
        if number % AT_ONCE == 0:
            progress.step(0.5 + 0.5 * number / len(images))
        path = photos.photo(image.name)
        name = tidy_name(image.name)
        if path is None:
            missing.append(name)
            continue
        lens = image_lens(image, intrinsics, paths)
        camera, mask = image_camera(image, lens, paths[1]), masks.mask(name)
        shot_held_out = None if held_out is None else name in held_out
        if lens.panorama:
            entries += faces_of(path, image_size(path), name, camera.world_to_camera, mask, shot_held_out)
        else:
            entries.append(PosedPhoto(name=name, path=path, camera=camera, mask=mask, held_out=shot_held_out))
    check_photos(paths[1], photos.root, entries, missing)
    points, colours = read_points(model)
    return PosedPhotos(
        source=paths[1],
        images=photos.root,
        entries=entries,
        missing=missing,
        points=points,
        point_colours=colours,
        warnings=[*found.warnings, *lines_about(entries)],
    )


def _photo_folder(folder: Path, model: Path, names: list[str], progress: Progress) -> tuple[Path, Files]:
    """(capture, photos): the folder of the capture and where in it the first photo is that there is at all.

    The user may have named the capture or, deeper, its model.
    """
    roots = list(dict.fromkeys((folder, model, *model.absolute().parents[:3])))
    for root in roots:
        for photos in map(Files, photo_folders(root)):
            progress.check()
            if any(photos.photo(name) for name in names):
                return root, photos
    whole = model.absolute()
    whole = next((one.parent for one in (whole, whole.parent) if one.name == "sparse"), folder)
    return whole, Files(whole / "images")


def _held_out_names(model: Path) -> set[str] | None:
    """Of ``test.txt`` beside the model: one photo a line, held out instead of every 8th."""
    path = model / "test.txt"
    if not os.path.isfile(path):
        return None
    with open_regular(path) as file:
        text = file.read(MAX_NAMES_BYTES + 1)
    if len(text) > MAX_NAMES_BYTES:
        raise InputError(f"{path}: is too large for a list of photos")
    lines = text.decode("utf-8", "replace").splitlines()
    return {tidy_name(line.strip()) for line in lines if line.strip()}


def read_points(model: Path) -> tuple[np.ndarray, np.ndarray]:
    """``points3D`` as (P, 3) float64 and (P, 3) uint8; empty where the model has none. Raises InputError."""
    for suffix, parse in ((".bin", _points_binary), (".txt", _points_text)):
        path = model / f"points3D{suffix}"
        if os.path.isfile(path):
            with open_regular(path) as file:
                return parse(file, path)
    return np.empty((0, 3)), np.empty((0, 3), dtype=np.uint8)


def _points_binary(file: BinaryIO, path: Path) -> tuple[np.ndarray, np.ndarray]:
    raw = file.read()
    cut = InputError(f"{path}: is truncated; copy or export it again")
    if len(raw) < 8:
        raise cut
    (count,) = struct.unpack_from("<Q", raw)
    if not count * _POINT.itemsize <= len(raw) - 8:
        raise cut
    starts = np.empty(count, dtype=np.int64)
    at, track_at = 8, _POINT.fields["track"][1] if _POINT.fields else 0
    unpack = struct.Struct("<Q").unpack_from
    for i in range(count):
        if at + _POINT.itemsize > len(raw):
            raise cut
        starts[i] = at
        at += _POINT.itemsize + 8 * unpack(raw, at + track_at)[0]
    if at > len(raw):
        raise cut
    table = np.frombuffer(raw, dtype=np.uint8)[starts[:, None] + np.arange(_POINT.itemsize)]
    points = table.reshape(-1).view(_POINT)
    return points["position"].astype(np.float64), points["colour"].copy()


def _points_text(file: BinaryIO, path: Path) -> tuple[np.ndarray, np.ndarray]:
    if os.fstat(file.fileno()).st_size > MAX_TEXT_BYTES:
        raise InputError(f"{path}: is too large for text; export the model as .bin")
    positions, colours = [], []
    for line in io.TextIOWrapper(file, encoding="utf-8", errors="replace"):
        words = line.split(maxsplit=7)
        if not words or words[0].startswith("#"):
            continue
        try:
            position, colour = [float(word) for word in words[1:4]], [int(word) for word in words[4:7]]
            if not (len(colour) == 3 and all(0 <= value <= 255 for value in colour)):
                raise ValueError
        except ValueError:
            raise InputError(f"{path}: the line {excerpt(line.strip())} is no point") from None
        positions.append(position)
        colours.append(colour)
    return (
        np.array(positions, dtype=np.float64).reshape(-1, 3),
        np.array(colours, dtype=np.uint8).reshape(-1, 3),
    )
