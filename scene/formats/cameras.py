"""Lists of cameras: our own JSON, the ``cameras.json`` of the 3DGS trainer, and COLMAP models."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.errors import InputError
from splatview.scene.formats.colmap import is_colmap, load_colmap_cameras
from splatview.scene.formats.io import array, atomic_write, excerpt, integer, number, read_json
from splatview.scene.lens import Lens
from splatview.scene.progress import Progress

MAX_SIDE = 1 << 16
"""Pixels; a larger picture fits in no memory."""

PARSING = 0.2
"""Share of the time that a list of cameras takes which is spent on its JSON."""

INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")


def read_cameras_file(path: Path, on_note: Callable[[str], None], progress: Progress) -> list[Camera]:
    """See `load_cameras`."""
    # What numbers out of all bounds make of a pose is told by `Camera`.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if is_colmap(path):
            cameras = load_colmap_cameras(path, on_note, progress)
        else:
            cameras = _load_json(path, progress)
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
    with atomic_write(path) as file:
        file.write((json.dumps(camera_values(camera), indent=1) + "\n").encode())


def camera_values(camera: Camera) -> dict[str, Any]:
    """The camera as our JSON has it."""
    values: dict[str, Any] = {name: getattr(camera, name) for name in INTRINSICS}
    values["world_to_camera"] = camera.world_to_camera.tolist()
    if camera.name:
        values["name"] = camera.name
    if camera.lens is not None:
        values["lens"] = {"model": camera.lens.model, "parameters": list(camera.lens.parameters)}
    if camera.orthographic:
        values["orthographic"] = True
    return values


def lens_of(entry: dict[str, Any], where: str) -> Lens | None:
    """The key "lens" of a camera in our JSON; None without one. Raises InputError, ValueError."""
    lens = entry.get("lens")
    if lens is None:
        return None
    if not (isinstance(lens, dict) and isinstance(lens.get("model"), str)):
        raise InputError(f"{where}: 'lens' must be an object with the keys model, parameters")
    parameters = lens.get("parameters", [])
    if not (isinstance(parameters, list) and all(type(value) in (int, float) for value in parameters)):
        raise InputError(f"{where}: the 'parameters' of the lens must be a list of numbers")
    return Lens(model=lens["model"], parameters=tuple(map(float, parameters)))


def is_orthographic(entry: dict[str, Any], where: str) -> bool:
    """The key "orthographic" of a camera in our JSON. Raises InputError."""
    value = entry.get("orthographic", False)
    if not isinstance(value, bool):
        raise InputError(f"{where}: 'orthographic' must be true or false")
    return value


def _load_json(path: Path, progress: Progress) -> list[Camera]:
    content = read_json(path, what="camera file", progress=progress.part(0.0, PARSING))
    progress = progress.part(PARSING, 1.0)
    if isinstance(content, dict) and "frames" in content and "world_to_camera" not in content:
        raise InputError(f"{path}: is a capture's transforms.json, not a list of cameras")
    entries = content if isinstance(content, list) else [content]
    cameras = []
    for i, entry in enumerate(entries):
        progress.step(i / len(entries))
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
        width=integer(entry, "width", where),
        height=integer(entry, "height", where),
        **{name: number(entry, name, where) for name in INTRINSICS[2:]},
        world_to_camera=array(entry, "world_to_camera", (4, 4), where),
        name=str(entry.get("name", "")),
        lens=lens_of(entry, where),
        orthographic=is_orthographic(entry, where),
    )


def _trainer_camera(entry: dict[str, Any], where: str) -> Camera:
    """``position`` is the eye, ``rotation`` turns camera axes to world axes."""
    width, height = integer(entry, "width", where), integer(entry, "height", where)
    matrix = np.eye(4)
    matrix[:3, :3] = array(entry, "rotation", (3, 3), where).T
    matrix[:3, 3] = -matrix[:3, :3] @ array(entry, "position", (3,), where)
    return Camera(
        width=width,
        height=height,
        fx=number(entry, "fx", where),
        fy=number(entry, "fy", where),
        # The file has no principal point: the trainer knows only the centre.
        cx=width / 2,
        cy=height / 2,
        world_to_camera=matrix,
        name=str(entry.get("img_name", entry.get("id", ""))),
    )
