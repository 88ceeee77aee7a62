"""A capture as a folder that nerfstudio, and `load_capture`, read: transforms.json, photos and points.

Format: nerfstudio documentation, "Data conventions".
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import InputError
from ..lens import Lens
from .capture import Capture, Photo

POINTS = "sparse_pc.ply"

_POINT = np.dtype([("position", "<f4", 3), ("colour", "u1", 3)])


def save_capture(
    capture: Capture, folder: Path, *, progress: Callable[[float], None] = lambda share: None
) -> None:
    """Writes photos, poses and points into `folder`, which is made; photos' names must end in .png.

    Masks and what photos were laid over are not written. `progress` gets the share done, 0 to 1.

    Raises:
        InputError: the system refuses, or the format does not know a photo's lens.
    """
    lenses = [_lens_values(photo.camera.lens, folder) for photo in capture.photos]
    images = folder / "images"
    try:
        images.mkdir(parents=True, exist_ok=True)
        for i, photo in enumerate(capture.photos):
            Image.fromarray(photo.image()).save(images / photo.name)
            progress((i + 1) / len(capture.photos))
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
    names = [f"property float {name}" for name in "xyz"]
    names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}", *names, "end_header"]
    table = np.empty(len(points), _POINT)
    table["position"], table["colour"] = points, colours
    return ("\n".join(header) + "\n").encode() + table.tobytes()
