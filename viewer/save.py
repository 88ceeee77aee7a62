"""Pictures and cameras to files."""

from __future__ import annotations

import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from splatview.scene import Camera, InputError
from splatview.scene.depth_of_field import mean_picture
from splatview.scene.formats import save_camera
from splatview.viewer.depth_of_field import SAVED_SAMPLES, is_pinhole
from splatview.viewer.state import Core

MAX_SIDE = 8192
"""Px: larger than this and common GL implementations refuse the target."""


def screenshot(core: Core) -> None:
    """Saves what is seen, without panels, beside the scene; never over an existing file."""
    save_picture(core, core.camera, next_free(picture_folder(core) / f"{picture_stem(core)}.png"))


def save_picture(core: Core, camera: Camera, path: Path) -> None:
    """Renders `camera` at full quality into the PNG `path`, and says where it is."""
    if core.picture is None:
        return
    try:
        edits = core.desk.document.edits if core.desk else None
        picture, aperture = core.picture, core.depth_of_field.aperture(core)

        def read(camera: Camera) -> np.ndarray:
            return picture.read(camera, core.settings, core.mode, edits=edits)

        if aperture is None or not is_pinhole(camera):
            image = read(camera)
        else:
            image = mean_picture(read, camera, aperture, SAVED_SAMPLES)
        write_png(path, image)
    except InputError as error:
        core.complain(str(error))
    except OSError as error:
        core.complain(f"{path}: cannot be written ({error.strerror or error})")
    else:
        core.tell(f"Picture saved: {path}")


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The view on width x height px with square pixels: another aspect ratio shows more or less at the
    sides, and what is above and below stays."""
    scale = height / camera.height
    return replace(
        camera,
        width=width,
        height=height,
        fx=camera.fx * scale,
        fy=camera.fy * scale,
        cx=width / 2 + (camera.cx - camera.width / 2) * scale,
        cy=camera.cy * scale,
    )


def picture_folder(core: Core) -> Path:
    """Beside the scene, or where the program was started."""
    return core.scene_path.parent if core.scene_path else Path.cwd()


def picture_stem(core: Core) -> str:
    return core.scene_path.stem if core.scene_path else "splatview"


def next_free(path: Path) -> Path:
    """`path`, or with -2, -3, ... before its suffix the first that does not exist."""
    number, candidate = 1, path
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return candidate


def write_png(path: Path, image: np.ndarray) -> None:
    """Writes the colours of `image` (H, W, 4) float, clipped to [0, 1], as 8-bit RGB, whole or not at all.

    Raises:
        OSError: the file cannot be written.
    """
    levels = (np.clip(np.nan_to_num(image[..., :3]), 0, 1) * 255 + 0.5).astype(np.uint8)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".tmp")
    try:
        with os.fdopen(handle, "wb") as file:
            Image.fromarray(levels).save(file, format="PNG")
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def save_current_camera(core: Core, path: Path) -> None:
    """Writes the view as CAM.json, for `splatview render --camera`."""
    try:
        save_camera(core.camera, path)
    except InputError as error:
        core.complain(str(error))
    except OSError as error:
        core.complain(f"{path}: cannot be written ({error.strerror or error})")
    else:
        core.tell(f"Camera saved: {path}")
