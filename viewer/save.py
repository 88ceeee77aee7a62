"""Pictures and cameras to files."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image

from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, InputError
from splatview.scene.depth_of_field import mean_picture
from splatview.scene.formats import save_camera
from splatview.scene.formats.io import atomic_write
from splatview.viewer.depth_of_field import SAVED_SAMPLES, DepthOfField, is_pinhole
from splatview.viewer.editing.session import session_of
from splatview.viewer.state import AppState

MAX_SIDE = 8192
"""Px: larger than this and common GL implementations refuse the target."""


def screenshot(app: AppState) -> None:
    """Saves what is seen, without panels, beside the scene; never over an existing file."""
    save_picture(app, app.camera, next_free(picture_folder(app) / f"{picture_stem(app)}.png"))


def save_picture(app: AppState, camera: Camera, path: Path) -> None:
    """Renders `camera` at full quality into the PNG `path`, and says where it is."""
    try:
        session = session_of(app)
        edits = session.document.edits if session else None
        picture, aperture = app.picture, app.feature(DepthOfField).aperture(app)

        def read(camera: Camera) -> np.ndarray:
            return picture.read(FrameRequest(None, camera, app.settings, mode=app.mode, edits=edits))

        if aperture is None or not is_pinhole(camera):
            image = read(camera)
        else:
            image = mean_picture(read, camera, aperture, SAVED_SAMPLES)
        write_png(path, image)
    except InputError as error:
        app.complain(str(error))
    else:
        app.tell(f"Picture saved: {path}")


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


def picture_folder(app: AppState) -> Path:
    """Beside the scene, or where the program was started."""
    return app.scene_path.parent if app.scene_path else Path.cwd()


def picture_stem(app: AppState) -> str:
    return app.scene_path.stem if app.scene_path else "splatview"


def next_free(path: Path) -> Path:
    """`path`, or with -2, -3, ... before its suffix the first that does not exist."""
    number, candidate = 1, path
    while os.path.lexists(candidate):
        number += 1
        candidate = path.with_name(f"{path.stem}-{number}{path.suffix}")
    return candidate


def write_png(path: Path, image: np.ndarray) -> None:
    """Writes the colours of `image` (H, W, 4) float, clipped to [0, 1], as 8-bit RGB, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    with atomic_write(path) as file:
        Image.fromarray(levels(image)).save(file, format="PNG")


def levels(image: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: the colours of `image` (H, W, 4) float, clipped to [0, 1] and rounded."""
    return (np.clip(np.nan_to_num(image[..., :3]), 0, 1) * 255 + 0.5).astype(np.uint8)


def save_current_camera(app: AppState, path: Path) -> None:
    """Writes the view as CAM.json, for `splatview render --camera`."""
    try:
        save_camera(app.camera, path)
    except InputError as error:
        app.complain(str(error))
    else:
        app.tell(f"Camera saved: {path}")
