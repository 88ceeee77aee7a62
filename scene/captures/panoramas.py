"""Panoramas that were taken to be trained on: equirectangular pictures, each cut into six faces of a cube.

Two fisheyes back to back see all around, and their programs write one picture of it: longitude from left to
right, latitude from top to bottom, the middle straight ahead (nerfstudio, "camera models": EQUIRECTANGULAR).
Each face is what a pinhole camera at the same place sees, 90 degrees wide, so that everything that is known
about such photos holds for them. A panorama's camera has the axes of a photo's: x right, y down, z forward.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.captures.capture import PosedPhoto
from splatview.scene.errors import InputError
from splatview.scene.formats.panorama import side_of

FACES: dict[str, np.ndarray] = {
    name: np.array(axes, dtype=np.float64).T
    for name, axes in {
        "front": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
        "right": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
        "back": ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
        "left": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
        "up": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
        "down": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    }.items()
}
"""Name of a face -> R_panorama_face, (3, 3): its columns are the face's right, down and ahead."""


def is_panorama(width: int, height: int) -> bool:
    """Whether a picture of this size, px, may go all the way round."""
    return width == 2 * height


def pixels_of_file(entry: PosedPhoto) -> int:
    """Those that the file of a photo, or of a face, has: what its decoder holds."""
    width, height = entry.camera.width, entry.camera.height
    return width * height if entry.face is None else math.ceil((math.pi * width) ** 2 / 2)


def places_in(face: str, side: int, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where in the panorama the middles of a face's pixels are: shares of its width and of its height, each
    (R, side) float64, for rows (R,) of the face."""
    x = (np.arange(side) + 0.5) * (2 / side) - 1
    y = (rows + 0.5) * (2 / side) - 1
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], np.float64(1)), axis=-1) @ FACES[face].T
    across, down, ahead = np.moveaxis(rays, -1, 0)
    longitude = np.arctan2(across, ahead)
    below = np.arctan2(down, np.hypot(across, ahead))
    return longitude / (2 * math.pi) + 0.5, below / math.pi + 0.5


def faces_of(
    path: Path,
    size: tuple[int, int],
    name: str,
    world_to_camera: np.ndarray,
    mask: Path | None,
    held_out: bool | None,
) -> Iterator[PosedPhoto]:
    """The photos that a panorama is cut into: its file, the width and height of that, px, its name, and its
    pose (4, 4).

    Raises:
        InputError: the file does not go all the way round.
        ValueError: the pose is none.
    """
    width, height = size
    if not is_panorama(width, height):
        raise InputError(
            f"{path}: is {width}x{height} pixels, but a panorama that goes all the way round is"
            " twice as wide as it is high; cut it into views of a pinhole camera"
        )
    side, (stem, suffix) = side_of(width), os.path.splitext(name)
    for face, R_panorama_face in FACES.items():
        world_to_face = world_to_camera.copy()
        world_to_face[:3] = R_panorama_face.T @ world_to_face[:3]
        face_name = f"{stem}_{face}{suffix}"
        camera = Camera(
            width=side,
            height=side,
            fx=side / 2,
            fy=side / 2,
            cx=side / 2,
            cy=side / 2,
            world_to_camera=world_to_face,
            name=face_name,
        )
        yield PosedPhoto(name=face_name, path=path, camera=camera, mask=mask, held_out=held_out, face=face)


def lines_about(entries: Sequence[PosedPhoto]) -> list[str]:
    """What is said about panoramas among photos; nothing where there are none."""
    panoramas = sum(entry.face is not None for entry in entries) // len(FACES)
    return (
        [f"{panoramas} panoramas are cut into {len(FACES)} photos each, 90 degrees wide"] if panoramas else []
    )
