"""Captures in ``transforms*.json``: NeRF-synthetic scenes, nerfstudio and instant-ngp.

Formats: the NeRF synthetic data set (Mildenhall et al. 2020); nerfstudio documentation, "Data conventions";
instant-ngp documentation, "Tips for training NeRF models". ``transform_matrix`` is camera-to-world with
OpenGL's axes (x right, y up, z backward). Keys of a frame win over those of the file.
"""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from plyfile import PlyData, PlyElement

from splatview.scene.camera import Camera
from splatview.scene.captures.capture import (
    AT_ONCE,
    Capture,
    Files,
    Photo,
    PosedPhoto,
    PosedPhotos,
    check_photos,
    tidy_name,
)
from splatview.scene.captures.panoramas import faces_of, lines_about
from splatview.scene.captures.photo_files import photo_folders
from splatview.scene.captures.photos import image_size
from splatview.scene.captures.points import first_points
from splatview.scene.errors import InputError
from splatview.scene.formats.io import array, excerpt, integer, number, read_json
from splatview.scene.lens import Lens
from splatview.scene.progress import Progress

PERSPECTIVE = ("", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
FISHEYE = ("OPENCV_FISHEYE", "FISHEYE")
"""Names of lenses in ``camera_model``; the coefficients decide what is left of them."""

PANORAMAS = ("EQUIRECTANGULAR", "SPHERICAL")
"""Names of cameras that see all around."""

MATRICES = ("K", "intrinsics", "intrinsic_matrix")
"""Keys by which some programs write intrinsics, px, as a matrix."""

MOST_SKEW = 1e-4
"""Of the focal length, up to which axes count as perpendicular: at the border of a photo that moves what is
seen by 1/20,000 of its height."""

Frames = tuple[Path, bool | None]
"""A file, and whether its photos are held out (None: it does not say)."""

DEFAULT_POINTS = ("sparse_pc.ply", "points3d.ply")
"""Where other programs put points that the file does not mention."""


def find_transforms(folder: Path) -> list[Frames]:
    """The files that make up the capture in `folder`; none where there is none."""
    train, *others = (folder / f"transforms_{part}.json" for part in ("train", "test", "val"))
    if os.path.isfile(train):
        held_out = next(filter(os.path.isfile, others), None)
        return [(train, None)] if held_out is None else [(train, False), (held_out, True)]
    single = folder / "transforms.json"
    return [(single, None)] if os.path.isfile(single) else []


def read_transforms(folder: Path, files: list[Frames], progress: Progress) -> PosedPhotos:
    """The capture in `folder` by `files` of `find_transforms`. Raises InputError, Cancelled."""
    whole, masks = Files(folder), Files(folder / "masks")
    entries, missing, ply_names = [], [], []
    contents = [_content(path) for path, _ in files]
    photos, lost = _photo_folder(folder, [frame for one in contents for frame in one["frames"]])
    for (path, held_out), content in zip(files, contents, strict=True):
        frames = content["frames"]
        held_out_names = _held_out_names(content, path)
        for i, frame in enumerate(frames):
            if i % AT_ONCE == 0:
                progress.step(i / len(frames))
            where = f"{path}: frame {i}"
            if not (isinstance(frame, dict) and isinstance(frame.get("file_path"), str)):
                raise InputError(f"{where}: must be an object with the keys file_path, transform_matrix")
            listed, name = tidy_name(frame["file_path"]), tidy_name(_without(frame["file_path"], lost))
            photo = photos.photo(name)
            if photo is None:
                missing.append(listed)
                continue
            shot_held_out = held_out if held_out_names is None else listed in held_out_names
            values, where = {**content, **frame, "file_path": name}, f"{where} ({excerpt(name)})"
            mask = _mask(values, where, whole, masks, name, lost)
            if _kind(values) in PANORAMAS:
                entries += _faces(values, where, photo, mask, shot_held_out)
            else:
                entries.append(_shot(values, where, photo, mask, shot_held_out))
        if isinstance(content.get("ply_file_path"), str):
            listed = content["ply_file_path"]
            ply_names.append(listed if whole.photo(listed) else _without(listed, lost))
    check_photos(files[0][0], folder, entries, missing)
    points, colours, warnings = first_points(folder, ply_names, DEFAULT_POINTS)
    return PosedPhotos(
        source=files[0][0],
        images=folder,
        entries=entries,
        missing=missing,
        points=points,
        point_colours=colours,
        warnings=[*warnings, *lines_about(entries)],
    )


def _content(path: Path) -> dict[str, Any]:
    """What a file says, with a list of frames. Raises InputError."""
    content = read_json(path, what="capture")
    if not (isinstance(content, dict) and isinstance(content.get("frames"), list)):
        raise InputError(f"{path}: is no capture: the list 'frames' is missing")
    return content


MOST_FOLDERS = 16
"""In front of a photo's name, of which some may be left out."""


def _photo_folder(folder: Path, frames: list[Any]) -> tuple[Files, int]:
    """Where the photos are, and how many folders in front of their names are not there: files often name
    photos from the root of the machine that wrote them, or were moved since. The fewest left out with which a
    photo is found, in the capture's folder first; none where two frames would have one photo."""
    places = [Files(place) for place in dict.fromkeys((folder, *photo_folders(folder)))]
    names = [frame.get("file_path") for frame in frames if isinstance(frame, dict)]
    names = [name for name in names if isinstance(name, str)]
    depth = min(max((len(_parts(name)) for name in names), default=1), MOST_FOLDERS)
    for lost in range(depth):
        for place in places:
            found = [place.photo(_without(name, lost)) for name in names]
            there = [photo for photo in found if photo is not None]
            if there and (lost == 0 or len(set(there)) == len(there)):
                return place, lost
    return places[0], 0


def _parts(name: str) -> list[str]:
    return name.replace("\\", "/").split("/")


def _without(name: str, lost: int) -> str:
    """A name without so many of its folders, from the front; its last part at least."""
    parts = _parts(name)
    return "/".join(parts[min(lost, len(parts) - 1) :]) if lost else name


def _held_out_names(content: Mapping[str, Any], path: Path) -> set[str] | None:
    """Names in nerfstudio's lists; None where the file has none."""
    for key in ("test_filenames", "val_filenames"):
        names = content.get(key)
        if names:
            if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
                raise InputError(f"{path}: {key!r} must be a list of file names")
            return {tidy_name(name) for name in names}
    return None


def _shot(
    values: Mapping[str, Any], where: str, photo: Path, mask: Path | None, held_out: bool | None
) -> PosedPhoto:
    name = tidy_name(values["file_path"])
    try:
        camera = _camera(values, where, photo, name)
    except InputError:
        raise
    except (ValueError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from None
    return PosedPhoto(
        name=name,
        path=photo,
        camera=camera,
        mask=mask,
        held_out=held_out,
    )


def _faces(
    values: Mapping[str, Any], where: str, photo: Path, mask: Path | None, held_out: bool | None
) -> list[PosedPhoto]:
    """Of a panorama, whose intrinsics are its size alone, and that is the file's."""
    name, pose = tidy_name(values["file_path"]), _world_to_camera(values, where)
    try:
        return list(faces_of(photo, image_size(photo), name, pose, mask, held_out))
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None


def _kind(values: Mapping[str, Any]) -> str:
    return str(values.get("camera_model") or "").upper()


def _mask(
    values: Mapping[str, Any], where: str, files: Files, masks: Files, name: str, lost: int
) -> Path | None:
    # Photos are named from the capture's folder, masks from that of the photos.
    by_name = masks.mask(name) or masks.mask(name.partition("/")[2] or name)
    listed = values.get("mask_path")
    if not isinstance(listed, str):
        return by_name
    # Some writers name photos from the root of their machine, and masks from the capture.
    found = files.photo(listed) or files.photo(_without(listed, lost)) or (by_name if lost else None)
    if found is None:
        raise InputError(f"{where}: the mask {excerpt(listed)} is not in {files.root}")
    return found


def _world_to_camera(values: Mapping[str, Any], where: str) -> np.ndarray:
    rows = values.get("transform_matrix")
    shape = (3, 4) if isinstance(rows, list) and len(rows) == 3 else (4, 4)
    to_world = array(values, "transform_matrix", shape, where)[:3]
    # Where a scene was resized its cameras may be too, which changes no ray.
    scale = np.cbrt(np.linalg.det(to_world[:, :3]))
    rotation = to_world[:, :3] / scale if scale > 0 else to_world[:, :3]
    matrix = np.eye(4)
    matrix[:3, :3] = (rotation * (1, -1, -1)).T
    matrix[:3, 3] = -matrix[:3, :3] @ to_world[:, 3]
    return matrix


def _camera(values: Mapping[str, Any], where: str, photo: Path, name: str) -> Camera:
    """Raises InputError, or ValueError of `Camera`."""
    if "w" in values and "h" in values:
        width, height = integer(values, "w", where), integer(values, "h", where)
    else:
        width, height = image_size(photo)

    fx = _focal(values, "x", width, where)
    fy = _focal(values, "y", height, where)
    cx, cy = width / 2, height / 2
    if fx is None and fy is None:
        matrix = next((key for key in MATRICES if key in values), None)
        if matrix is None:
            raise InputError(f"{where}: has neither fl_x nor camera_angle_x; the focal length is unknown")
        fx, fy, cx, cy = _intrinsics(values, matrix, where)
    return Camera(
        width=width,
        height=height,
        fx=fx or fy or 0.0,
        fy=fy or fx or 0.0,
        cx=_optional(values, "cx", cx, where),
        cy=_optional(values, "cy", cy, where),
        world_to_camera=_world_to_camera(values, where),
        name=name,
        lens=_lens(values, where),
    )


def _intrinsics(values: Mapping[str, Any], key: str, where: str) -> tuple[float, float, float, float]:
    """Focal lengths and principal point of a matrix, 3x3 or larger."""
    rows = values[key]
    size = len(rows) if isinstance(rows, list) and len(rows) == 4 else 3
    matrix = array(values, key, (size, size), where)
    (fx, skew, cx), (shear, fy, cy), last = matrix[:3, :3]
    if not (abs(skew) <= MOST_SKEW * fx and shear == 0 and (last == (0, 0, 1)).all()):
        raise InputError(f"{where}: {key!r} must be a matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]")
    return float(fx), float(fy), float(cx), float(cy)


def _lens(values: Mapping[str, Any], where: str) -> Lens:
    names = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
    k1, k2, k3, k4, k5, k6, p1, p2 = (_optional(values, name, 0.0, where) for name in names)
    kind = _kind(values)
    if kind in FISHEYE or values.get("is_fisheye") is True:
        model, distortion = "OPENCV_FISHEYE", (k1, k2, k3, k4)
    elif kind not in PERSPECTIVE:
        raise InputError(f"{where}: lenses of the kind {excerpt(kind)} cannot be used; undistort the photos")
    elif kind == "FULL_OPENCV":
        model, distortion = kind, (k1, k2, p1, p2, k3, k4, k5, k6)
    else:
        model, distortion = "RADIAL4", (k1, k2, k3, k4, p1, p2)
    if not all(map(math.isfinite, distortion)):
        raise InputError(f"{where}: the distortion must be finite numbers")
    return Lens(model=model, parameters=distortion)


def _focal(values: Mapping[str, Any], axis: str, size: int, where: str) -> float | None:
    """By ``fl_x`` or ``camera_angle_x``, the full angle of view in radians."""
    if f"fl_{axis}" in values:
        return number(values, f"fl_{axis}", where)
    key = f"camera_angle_{axis}"
    if key not in values:
        return None
    angle = number(values, key, where)
    if not 0 < angle < math.pi:
        raise InputError(f"{where}: {key!r} must be an angle in radians between 0 and pi, not {angle:g}")
    return size / 2 / math.tan(angle / 2)


def _optional(values: Mapping[str, Any], key: str, default: float, where: str) -> float:
    return number(values, key, where) if key in values else default


# ---- A capture as a folder that nerfstudio, and `load_capture`, read: transforms.json, photos and points.
#
# Format: nerfstudio documentation, "Data conventions".


POINTS = "sparse_pc.ply"

_POINT = np.dtype([(name, "<f4") for name in "xyz"] + [(name, "u1") for name in ("red", "green", "blue")])


def save_capture(capture: Capture, folder: Path) -> None:
    """Writes photos, poses and points into `folder`, which is made; photos' names must end in .png.

    Masks and what photos were laid over are not written.

    Raises:
        InputError: the system refuses, or the format does not know a photo's lens.
    """
    lenses = [_lens_values(photo.camera.lens, folder) for photo in capture.photos]
    images = folder / "images"
    try:
        images.mkdir(parents=True, exist_ok=True)
        for photo in capture.photos:
            Image.fromarray(photo.image()).save(images / photo.name)
        (folder / POINTS).write_bytes(_point_cloud(capture.points, capture.point_colours))
        content = {
            "ply_file_path": POINTS,
            "train_filenames": [f"images/{photo.name}" for photo in capture.train],
            "test_filenames": [f"images/{photo.name}" for photo in capture.held_out],
            "frames": [{**_frame(photo), **lens} for photo, lens in zip(capture.photos, lenses, strict=True)],
        }
        # Last: a folder with this file is whole.
        (folder / "transforms.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {error.strerror or error}") from None


def _frame(photo: Photo) -> dict[str, object]:
    camera = photo.camera
    to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
    return {
        "file_path": f"images/{photo.name}",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "transform_matrix": to_world.tolist(),
    }


def _lens_values(lens: Lens | None, folder: Path) -> dict[str, object]:
    """The keys of a frame that say how its lens distorts. Raises InputError."""
    if lens is None:
        return {"camera_model": "OPENCV"}
    form = lens.form
    names = ("k1", "k2", "k3", "k4")
    if form.skew_last or any((form.n5, form.n6, form.s1, form.s2, form.s3, form.s4)):
        raise InputError(f"{folder}: transforms.json has no lenses of the model {lens.model}")
    radial = dict(zip(names, (form.n1, form.n2, form.n3, form.n4), strict=True))
    skew = {"p1": form.p1, "p2": form.p2}
    if form.slope:
        if lens.model == "FOV" or form.p1 or form.p2:
            raise InputError(f"{folder}: transforms.json has no lenses of the model {lens.model}")
        return {"camera_model": "OPENCV_FISHEYE", **radial}
    if lens.model == "FULL_OPENCV":
        keys = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        return {"camera_model": lens.model, **dict(zip(keys, lens.parameters, strict=True))}
    return {"camera_model": "OPENCV", **radial, **skew}


def _point_cloud(points: np.ndarray, colours: np.ndarray) -> bytes:
    """A binary .ply of (P, 3) positions and (P, 3) uint8 colours."""
    table = np.empty(len(points), _POINT)
    for name, column in zip(_POINT.names or (), (*points.T, *colours.T), strict=True):
        table[name] = column
    file = io.BytesIO()
    PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(file)
    return file.getvalue()
