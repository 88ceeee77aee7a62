"""Lists of cameras: our own JSON, the ``cameras.json`` of the 3DGS trainer, and COLMAP models."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from ..camera import Camera
from ..errors import InputError
from .atomic import atomic_write
from .colmap import is_colmap, load_colmap_cameras
from .excerpt import excerpt

MAX_JSON_BYTES = 1 << 28
"""A camera takes some 500 bytes; a file of more than this is no list of cameras."""

MAX_SIDE = 1 << 16
"""Pixels; a larger picture fits in no memory."""

INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")


def read_cameras_file(path: Path, on_note: Callable[[str], None]) -> list[Camera]:
    """See `load_cameras`."""
    cameras = load_colmap_cameras(path, on_note) if is_colmap(path) else _load_json(path)
    if not cameras:
        raise InputError(f"{path}: holds no cameras")
    for camera in cameras:
        if not (camera.width <= MAX_SIDE and camera.height <= MAX_SIDE):
            raise InputError(
                f"{path}: camera {excerpt(camera.name)} is {camera.width} x {camera.height} pixels large, "
                f"more than {MAX_SIDE} a side; the file is damaged"
            )
    return cameras


def write_camera(camera: Camera, path: Path) -> None:
    """See `save_camera`."""
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: cameras are saved as .json; give it that suffix")
    values: dict[str, Any] = {name: getattr(camera, name) for name in INTRINSICS}
    values["world_to_camera"] = camera.world_to_camera.tolist()
    if camera.name:
        values["name"] = camera.name
    with atomic_write(path) as file:
        file.write((json.dumps(values, indent=1) + "\n").encode())


def _load_json(path: Path) -> list[Camera]:
    try:
        # A device or a pipe may never end: only files are opened.
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        if path.stat().st_size > MAX_JSON_BYTES:
            raise InputError(f"{path}: is too large for a list of cameras")
        content = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no camera file: not JSON ({error})") from None
    if isinstance(content, dict) and "frames" in content and "world_to_camera" not in content:
        raise InputError(f"{path}: is a capture's transforms.json, not a list of cameras")
    entries = content if isinstance(content, list) else [content]
    cameras = []
    for i, entry in enumerate(entries):
        where = f"{path}: camera {i}" if isinstance(content, list) else str(path)
        if not isinstance(entry, dict):
            raise InputError(
                f"{where}: must be an object with the keys {', '.join(INTRINSICS)}, world_to_camera"
            )
        parse = _trainer_camera if "rotation" in entry and "world_to_camera" not in entry else _own_camera
        try:
            cameras.append(parse(entry, where))
        except InputError:
            raise
        except (ValueError, OverflowError) as error:
            raise InputError(f"{where}: {error}") from None
    return cameras


def _own_camera(entry: dict[str, Any], where: str) -> Camera:
    return Camera(
        width=_integer(entry, "width", where),
        height=_integer(entry, "height", where),
        fx=_number(entry, "fx", where),
        fy=_number(entry, "fy", where),
        cx=_number(entry, "cx", where),
        cy=_number(entry, "cy", where),
        world_to_camera=_array(entry, "world_to_camera", (4, 4), where),
        name=str(entry.get("name", "")),
    )


def _trainer_camera(entry: dict[str, Any], where: str) -> Camera:
    """``position`` is the eye, ``rotation`` turns camera axes to world axes."""
    width, height = _integer(entry, "width", where), _integer(entry, "height", where)
    matrix = np.eye(4)
    matrix[:3, :3] = _array(entry, "rotation", (3, 3), where).T
    matrix[:3, 3] = -matrix[:3, :3] @ _array(entry, "position", (3,), where)
    return Camera(
        width=width,
        height=height,
        fx=_number(entry, "fx", where),
        fy=_number(entry, "fy", where),
        # The file has no principal point: the trainer knows only the centre.
        cx=width / 2,
        cy=height / 2,
        world_to_camera=matrix,
        name=str(entry.get("img_name", entry.get("id", ""))),
    )


def _value(entry: dict[str, Any], key: str, where: str) -> Any:
    if key not in entry:
        raise InputError(f"{where}: the key {key!r} is missing")
    return entry[key]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _number(entry: dict[str, Any], key: str, where: str) -> float:
    value = _value(entry, key, where)
    if not _is_number(value):
        raise InputError(f"{where}: {key!r} must be a number, not {excerpt(json.dumps(value))}")
    return float(value)


def _integer(entry: dict[str, Any], key: str, where: str) -> int:
    value = _number(entry, key, where)
    if not (math.isfinite(value) and value == int(value)):
        raise InputError(f"{where}: {key!r} must be a whole number of pixels, not {value:g}")
    return int(value)


def _array(entry: dict[str, Any], key: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    value = _value(entry, key, where)
    rows = value if len(shape) == 2 else [value]
    count = shape[-1]
    if not (
        isinstance(rows, list)
        and len(rows) == (shape[0] if len(shape) == 2 else 1)
        and all(isinstance(row, list) and len(row) == count and all(map(_is_number, row)) for row in rows)
    ):
        size = " x ".join(map(str, shape))
        raise InputError(f"{where}: {key!r} must be {size} numbers in brackets")
    return np.array(value, dtype=np.float64)
