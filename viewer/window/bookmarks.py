"""Views that the user keeps, in SCENE.bookmarks.json beside the scene."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...scene import InputError
from ...scene.files.cameras import is_orthographic, lens_of
from ..folders import config_folder
from .navigation import Lens, View
from .navigation.rotations import orthonormal, unit
from .navigation.view import MAX_FOV, MIN_FOV
from .preferences import write_json


@dataclass(frozen=True, eq=False, kw_only=True)
class Bookmark:
    name: str
    view: View
    entry: str = ""
    """The text that it was read from, which tells it from others of its name; none for a new one."""


def beside(scene: Path) -> Path:
    """Where the bookmarks of `scene` belong."""
    return scene.with_name(scene.name + ".bookmarks.json")


def in_config(scene: Path) -> Path:
    """Where they go if the scene's folder cannot be written to; told apart by the scene's full path."""
    digest = hashlib.sha256(str(scene.absolute()).encode()).hexdigest()[:12]
    return config_folder() / "bookmarks" / f"{scene.name}.{digest}.bookmarks.json"


def load_bookmarks(scene: Path) -> list[Bookmark]:
    """The bookmarks of a scene; none where there is no file. Those beside the scene come first.

    Raises:
        InputError: a file cannot be read or is no list of bookmarks.
    """
    found = []
    for path in (beside(scene), in_config(scene)):
        try:
            text = path.read_text(encoding="utf-8")
        except FileNotFoundError:
            continue
        except (OSError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: cannot read the bookmarks ({error})") from None
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                found += [_bookmark(entry) for entry in json.loads(text)["bookmarks"]]
        except (
            *(ValueError, KeyError, TypeError, OverflowError, RecursionError),
            np.linalg.LinAlgError,
        ) as error:
            raise InputError(f"{path}: not a bookmarks file ({error}); move it away to start anew") from None
    return found


def save_bookmarks(scene: Path, bookmarks: list[Bookmark]) -> Path:
    """Writes them beside the scene or, where that is not allowed, in the configuration folder.

    Returns:
        The file that now holds them all.

    Raises:
        OSError: neither place can be written to.
    """
    data = {"version": 1, "bookmarks": [_as_json(bookmark) for bookmark in bookmarks]}
    try:
        write_json(beside(scene), data)
    except OSError:
        write_json(in_config(scene), data)
        return in_config(scene)
    # What an earlier run had to put elsewhere is now here: it must not come back twice.
    in_config(scene).unlink(missing_ok=True)
    return beside(scene)


def _as_json(bookmark: Bookmark) -> dict[str, Any]:
    view = bookmark.view
    return {
        "name": bookmark.name,
        "target": view.target.tolist(),
        "distance": view.distance,
        "rotation": view.R_camera_world.tolist(),
        "up": view.up.tolist(),
        "fov_y": view.lens.fov_y,
        "shift": list(view.lens.shift),
        "squeeze": view.lens.squeeze,
        **_rays(view.lens),
    }


def _rays(lens: Lens) -> dict[str, Any]:
    """What only lenses that are no pinholes have, in the form of camera files."""
    values: dict[str, Any] = {}
    if lens.distortion is not None:
        values["lens"] = {"model": lens.distortion.model, "parameters": list(lens.distortion.parameters)}
    if lens.orthographic:
        values["orthographic"] = True
    return values


def _bookmark(entry: dict[str, Any]) -> Bookmark:
    """Raises ValueError, KeyError or TypeError where `entry` is no bookmark."""
    target, rotation = np.array(entry["target"], np.float64), np.array(entry["rotation"], np.float64)
    distance, fov_y, squeeze = (float(entry[name]) for name in ("distance", "fov_y", "squeeze"))
    x, y = entry["shift"]
    if target.shape != (3,) or rotation.shape != (3, 3):
        raise ValueError("a target or rotation has the wrong shape")
    if not np.isfinite([*target, *rotation.ravel(), distance, float(x), float(y), squeeze]).all():
        raise ValueError("a number is not finite")
    if not (distance > 0 and squeeze > 0 and MIN_FOV <= fov_y <= MAX_FOV):
        raise ValueError("a distance or field of view is out of range")
    # Large entries first, whose products overflow.
    if not (
        (abs(rotation) <= 2).all()
        and (abs(rotation @ rotation.T - np.eye(3)) <= 1e-3).all()
        and np.linalg.det(rotation) > 0
    ):
        raise ValueError("a rotation is not one")
    return Bookmark(
        name=str(entry["name"]),
        entry=json.dumps(entry, sort_keys=True),
        view=View(
            target=target,
            distance=distance,
            R_camera_world=orthonormal(rotation),
            up=unit(np.array(entry["up"], np.float64).reshape(3)),
            lens=Lens(
                fov_y=fov_y,
                shift=(float(x), float(y)),
                squeeze=squeeze,
                distortion=lens_of(entry, "a bookmark"),
                orthographic=is_orthographic(entry, "a bookmark"),
            ),
        ),
    )
