"""Cameras of a COLMAP model: ``cameras`` (intrinsics) and ``images`` (poses), binary or text.

Format: COLMAP documentation, "Output Format". Poses are world-to-camera; the centre of the top-left pixel
is (0.5, 0.5); both are ours too.
"""

from __future__ import annotations

import io
import math
import os
import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.errors import InputError
from splatview.scene.formats.io import excerpt, open_regular, require_regular_file
from splatview.scene.formats.panorama import side_of
from splatview.scene.lens import COUNTS, Lens
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.scene.projection import rotation_matrices

MAX_NAME_BYTES = 4096
"""Bytes of an image's name; longer than any file system's."""

LEAST_IMAGE_BYTES = 64
"""That ``images.bin`` has for each image, its name aside."""

MODELS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
    "RAD_TAN_THIN_PRISM_FISHEYE",
    "SIMPLE_DIVISION",
    "DIVISION",
    "SIMPLE_FISHEYE",
    "FISHEYE",
    "EUCM",
    "EQUIRECTANGULAR",
)
"""Camera models by COLMAP's number."""

PANORAMAS = {"EQUIRECTANGULAR": 2, "SPHERICAL": 2, "SPHERE": 3}
"""Models of pictures that go all the way round, and how many parameters a row has, which say nothing: the
size again, or a focal length and the middle. COLMAP's own name, an earlier one, and SphereSfM's."""

ONE_FOCAL_LENGTH = {
    "SIMPLE_PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "SIMPLE_DIVISION",
    "SIMPLE_FISHEYE",
}
"""Models that begin with f, cx, cy; the others begin with fx, fy, cx, cy. The distortion follows."""


@dataclass(frozen=True, kw_only=True)
class ColmapCamera:
    """A row of ``cameras``: intrinsics that several images may share."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    lens: Lens
    panorama: bool = False
    """Whether the picture goes all the way round; all else is of what is ahead then, 90 degrees wide."""


@dataclass(frozen=True, kw_only=True)
class ColmapImage:
    """A row of ``images``: a photo's pose. (w, x, y, z) and t of world-to-camera."""

    name: str
    camera_id: int
    quat: tuple[float, ...]
    translation: tuple[float, ...]


def is_colmap(path: Path) -> bool:
    """Whether `path` names a COLMAP model: a folder, or its ``cameras`` or ``images`` file."""
    return os.path.isdir(path) or path.suffix.lower() in (".bin", ".txt")


def load_colmap_cameras(path: Path, on_note: Callable[[str], None], progress: Progress) -> list[Camera]:
    """A camera for each image, sorted by name. `path`: see `is_colmap`.

    `on_note` gets a line about each lens that is no pinhole.

    Raises:
        InputError: a file is missing, truncated or holds an unknown camera model.
        Cancelled: nobody waits for it any more.
    """
    cameras_path, images_path = find_model(path)
    intrinsics = read_cameras(cameras_path)
    images = read_images(images_path)
    cameras = []
    for i, image in enumerate(images):
        progress.step(i / len(images))
        lens = image_lens(image, intrinsics, (cameras_path, images_path))
        cameras.append(image_camera(image, lens, images_path))
    for note in _distortion_notes(intrinsics, images):
        on_note(f"{cameras_path}: {note}")
    return sorted(cameras, key=lambda camera: camera.name)


def image_lens(
    image: ColmapImage, intrinsics: Mapping[int, ColmapCamera], paths: tuple[Path, Path]
) -> ColmapCamera:
    """The image's camera; `paths` are those of `find_model`. Raises InputError where there is none."""
    lens = intrinsics.get(image.camera_id)
    if lens is None:
        raise InputError(
            f"{paths[1]}: image {excerpt(image.name)} has camera {image.camera_id}, which is not in "
            f"{paths[0].name}; both files must come from the same model"
        )
    return lens


def image_camera(image: ColmapImage, lens: ColmapCamera, path: Path) -> Camera:
    """The lens at the image's pose. Raises InputError, naming `path`."""
    try:
        matrix = np.eye(4)
        matrix[:3, :3] = rotation_matrices(np.array([image.quat]))[0]
        matrix[:3, 3] = image.translation
        intrinsics = {name: value for name, value in vars(lens).items() if name != "panorama"}
        return Camera(**intrinsics, world_to_camera=matrix, name=image.name)
    except ValueError as error:
        raise InputError(f"{path}: image {excerpt(image.name)}: {error}") from None


def _distortion_notes(intrinsics: dict[int, ColmapCamera], images: Sequence[ColmapImage]) -> list[str]:
    """A line about each camera in use that is more than a pinhole."""
    notes = []
    for number in sorted({image.camera_id for image in images}):
        camera = intrinsics[number]
        if camera.panorama:
            notes.append(
                f"camera {number} is panoramic; of its views what is ahead is drawn, 90 degrees wide"
            )
        elif not camera.lens.is_pinhole:
            notes.append(f"camera {number} has the lens {camera.lens}; its views are drawn through it")
    return notes


def find_model(path: Path) -> tuple[Path, Path]:
    """The files (cameras, images) of the model at `path`; a folder may also hold it in ``sparse``, or several
    in ``sparse/0`` and so on, of which the one with most images is taken, the first of such."""
    if os.path.isdir(path):
        models = models_in(path / "sparse")
        if len(models) > 1:
            models.sort(key=posed_images, reverse=True)
        for folder in (path, *models, path / "sparse"):
            for suffix in (".bin", ".txt"):
                pair = folder / f"cameras{suffix}", folder / f"images{suffix}"
                if all(map(os.path.isfile, pair)):
                    return pair
        raise InputError(
            f"{path}: holds no COLMAP model (cameras and images, .bin or .txt, here or in sparse/0)"
        )
    require_regular_file(path)
    if path.stem not in ("cameras", "images"):
        raise InputError(f"{path}: is no camera file; COLMAP's are cameras and images (.bin or .txt)")
    pair = path.with_stem("cameras"), path.with_stem("images")
    for file in pair:
        if not os.path.isfile(file):
            raise InputError(f"{path}: needs {file.name} in the same folder")
    return pair


def models_in(folder: Path) -> list[Path]:
    """Folders of models, as COLMAP numbers them."""
    return [model for model in numbered(folder) if images_file(model)]


def numbered(folder: Path) -> list[Path]:
    """Files and folders in a folder whose names are numbers, in their order; none where it cannot be read."""
    try:
        names = [name for name in os.listdir(folder) if name.isdecimal()]
    except OSError:
        return []
    return [folder / name for name in sorted(names, key=int)]


def images_file(model: Path) -> Path | None:
    """``images`` of the model in a folder; None where it has none."""
    files = (model / f"images{suffix}" for suffix in (".bin", ".txt"))
    return next((file for file in files if os.path.isfile(file)), None)


def posed_images(model: Path) -> int:
    """How many images have a pose in the model in a folder; 0 where that cannot be told."""
    path = images_file(model)
    if path is None:
        return 0
    try:
        with open_regular(path) as file:
            if path.suffix == ".bin":
                count = int.from_bytes(file.read(8), "little")
                return count if count * LEAST_IMAGE_BYTES <= path.stat().st_size else 0
            # Two lines each, of which the second may be empty.
            return sum(not line.startswith(b"#") for line in file) // 2
    except (OSError, InputError):
        return 0


def read_cameras(path: Path) -> dict[int, ColmapCamera]:
    """``cameras.bin`` or ``.txt`` by camera number. Raises InputError."""
    return _read(path, _cameras_binary if path.suffix == ".bin" else _cameras_text)


def read_images(path: Path, progress: Progress = NO_PROGRESS) -> list[ColmapImage]:
    """``images.bin`` or ``.txt`` in the order of the file. Raises InputError, Cancelled."""
    return _read(path, partial(_images_binary if path.suffix == ".bin" else _images_text, progress))


def _read(path: Path, parse: Callable):
    with open_regular(path) as file:
        return parse(file, path)


def _focal_lengths(model: str) -> int:
    return 1 if model in ONE_FOCAL_LENGTH else 2


def _parameters(model: str) -> int:
    """All that a row has: focal lengths, principal point, distortion."""
    return PANORAMAS.get(model) or _focal_lengths(model) + 2 + COUNTS[model]


def _lens(model: str, width: int, height: int, params: Sequence[float], path: Path) -> ColmapCamera:
    if not all(map(math.isfinite, params)):
        raise InputError(f"{path}: a {model} camera has parameters that are not finite")
    if model in PANORAMAS:
        if width != 2 * height or height < 1:
            raise InputError(
                f"{path}: a {model} camera is {width} x {height} pixels large; a panorama that goes all"
                " the way round is twice as wide as it is high"
            )
        return _ahead(width)
    focals = _focal_lengths(model)
    try:
        lens = Lens(model=model, parameters=tuple(params[focals + 2 :]))
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None
    return ColmapCamera(
        width=width,
        height=height,
        fx=params[0],
        fy=params[focals - 1],
        cx=params[focals],
        cy=params[focals + 1],
        lens=lens,
    )


def _ahead(width: int) -> ColmapCamera:
    """What is ahead of a panorama so wide, px."""
    side = side_of(width)
    half = side / 2
    return ColmapCamera(
        width=side,
        height=side,
        fx=half,
        fy=half,
        cx=half,
        cy=half,
        lens=Lens(model="PINHOLE"),
        panorama=True,
    )


def _unpack(file: io.BufferedReader, layout: str, path: Path) -> tuple:
    size = struct.calcsize(layout)
    raw = file.read(size)
    if len(raw) < size:
        raise InputError(f"{path}: is truncated; copy or export it again")
    return struct.unpack(layout, raw)


def _cameras_binary(file: io.BufferedReader, path: Path) -> dict[int, ColmapCamera]:
    cameras = {}
    (count,) = _unpack(file, "<Q", path)
    for _ in range(count):
        number, model_number, width, height = _unpack(file, "<IiQQ", path)
        if not 0 <= model_number < len(MODELS):
            raise InputError(f"{path}: camera {number} has the unknown model {model_number}")
        model = MODELS[model_number]
        params = _unpack(file, f"<{_parameters(model)}d", path)
        cameras[number] = _lens(model, width, height, params, path)
    return cameras


def _cameras_text(file: io.BufferedReader, path: Path) -> dict[int, ColmapCamera]:
    cameras = {}
    for line in file:
        words = line.decode("utf-8", "replace").split()
        if not words or words[0].startswith("#"):
            continue
        model = words[1] if len(words) > 1 else ""
        if model not in MODELS and model not in PANORAMAS:
            raise InputError(f"{path}: unknown camera model in the line {excerpt(' '.join(words))}")
        try:
            number, width, height = int(words[0]), int(words[2]), int(words[3])
            params = [float(word) for word in words[4:]]
            if len(params) != _parameters(model):
                raise ValueError
        except (ValueError, IndexError):
            line = excerpt(" ".join(words))
            raise InputError(f"{path}: the line {line} is no {model} camera") from None
        cameras[number] = _lens(model, width, height, params, path)
    return cameras


AT_ONCE = 4096
"""Images read between two questions whether to go on."""


def _images_binary(progress: Progress, file: io.BufferedReader, path: Path) -> list[ColmapImage]:
    images = []
    (count,) = _unpack(file, "<Q", path)
    file_bytes = path.stat().st_size
    for number in range(count):
        if number % AT_ONCE == 0:
            progress.step(number / count)
        _, *pose, camera_id = _unpack(file, "<I7dI", path)
        name = bytearray()
        while (byte := file.read(1)) != b"\0":
            if not byte or len(name) == MAX_NAME_BYTES:
                raise InputError(f"{path}: is truncated or damaged: an image's name does not end")
            name += byte
        (points,) = _unpack(file, "<Q", path)
        # The 2D points, (x, y, number) each: of no use here.
        if points * 24 > file_bytes - file.tell():
            raise InputError(f"{path}: is truncated; copy or export it again")
        file.seek(points * 24, io.SEEK_CUR)
        images.append(_image(name.decode("utf-8", "replace"), camera_id, pose))
    return images


def _images_text(progress: Progress, file: io.BufferedReader, path: Path) -> list[ColmapImage]:
    images, file_bytes = [], path.stat().st_size
    lines = (line.decode("utf-8", "replace").strip() for line in file)
    for line in lines:
        if not line or line.startswith("#"):
            continue
        if len(images) % AT_ONCE == 0:
            progress.step(file.tell() / max(file_bytes, 1))
        words = line.split(maxsplit=9)
        try:
            pose = [float(word) for word in words[1:8]]
            images.append(_image(words[9], int(words[8]), pose))
        except (ValueError, IndexError):
            raise InputError(f"{path}: the line {excerpt(line)} is no image") from None
        # The line behind an image has its 2D points, and may be empty.
        next(lines, None)
    return images


def _image(name: str, camera_id: int, pose: Sequence[float]) -> ColmapImage:
    return ColmapImage(name=name, camera_id=camera_id, quat=tuple(pose[:4]), translation=tuple(pose[4:]))
