"""Camera paths in files: nerfstudio's ``camera_path.json``, with the keyframes in a key of our own, is read
and written; the camera animations of SuperSplat's experience settings are read.

Formats: nerfstudio documentation, "Render"; PlayCanvas developer site, "Experience settings". nerfstudio's
file has one camera per frame, ``camera_to_world`` in rows with OpenGL's axes; SuperSplat's has keyframes at
numbers of frames.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.camera import look_at_matrix
from splatview.scene.camera_path import MOTIONS, CameraPath, Keyframe, Pose, matrix_of, quaternion
from splatview.scene.errors import InputError
from splatview.scene.formats.io import array, atomic_write, excerpt, number, read_json

OWN = "splatview"
"""Key of our keyframes in a file that is nerfstudio's otherwise."""

OPENGL = np.diag((1.0, -1.0, -1.0))
"""Camera axes of nerfstudio: y up, z backward."""

PLAYCANVAS = np.diag((-1.0, -1.0, 1.0))
"""SuperSplat shows files turned by half a turn about z."""


@dataclass(frozen=True, kw_only=True)
class PathFile:
    """What a file says of a film."""

    path: CameraPath
    fps: float | None = None
    size: tuple[int, int] | None = None
    """Width and height, px."""


def load_camera_path(file: Path, *, aspect: float = 16 / 9) -> PathFile:
    """Reads a path that `save_camera_path` wrote, nerfstudio's ``camera_path.json``, or the first camera
    animation of SuperSplat's experience settings, whose field of view is that of the longer side of a picture
    of this `aspect`.

    Raises:
        InputError: it is none of these, or cannot be read; one line that says where.
    """
    content = read_json(file, what="camera path")
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            if isinstance(content, dict) and isinstance(content.get(OWN), dict):
                return PathFile(path=_own(content[OWN], str(file)), **_film_of(content, str(file)))
            if isinstance(content, dict) and isinstance(content.get("camera_path"), list):
                return _nerfstudio(content, str(file))
            if isinstance(content, dict) and isinstance(content.get("animTracks"), list):
                return _supersplat(content["animTracks"], str(file), aspect)
    except InputError:
        raise
    except (ValueError, OverflowError) as error:
        raise InputError(f"{file}: {error}") from None
    raise InputError(f"{file}: is no camera path: it has neither of the lists camera_path and animTracks")


def save_camera_path(path: CameraPath, file: Path, *, fps: float, size: tuple[int, int]) -> None:
    """Writes nerfstudio's ``camera_path.json`` with our keyframes in it.

    Raises:
        InputError: the name has another suffix, or the system refuses.
    """
    if file.suffix.lower() != ".json":
        raise InputError(f"{file}: camera paths are saved as .json; give it that suffix")
    width, height = size
    content = {
        "camera_type": "perspective",
        "render_width": width,
        "render_height": height,
        "fps": fps,
        "seconds": path.duration,
        "is_cycle": path.loop,
        "keyframes": [_as_nerfstudio(key.pose, width / height, "matrix") for key in path.keyframes],
        "camera_path": [
            _as_nerfstudio(path.pose(float(time)), width / height, "camera_to_world")
            for time in path.frame_times(fps)
        ],
        OWN: path_values(path),
    }
    with atomic_write(file) as out:
        out.write((json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def path_values(path: CameraPath) -> dict[str, Any]:
    """The path as JSON holds it, every digit of it."""
    return {
        "duration": path.duration,
        "loop": path.loop,
        "motion": path.motion,
        "up": path.up.tolist(),
        "keyframes": [
            {
                "time": key.time,
                "target": key.pose.target.tolist(),
                "distance": key.pose.distance,
                "rotation": key.pose.R_camera_world.tolist(),
                "fov_y": key.pose.fov_y,
            }
            for key in path.keyframes
        ],
    }


def path_of_values(values: dict[str, Any], where: str) -> CameraPath:
    """The inverse. Raises InputError; `where` names what they are of."""
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return _own(values, where)
    except InputError:
        raise
    except (ValueError, OverflowError) as error:
        raise InputError(f"{where}: {error}") from None


def _own(values: dict[str, Any], where: str) -> CameraPath:
    motion, loop = values.get("motion"), values.get("loop")
    if motion not in MOTIONS or not isinstance(loop, bool):
        raise InputError(f"{where}: 'motion' must be {' or '.join(MOTIONS)}, and 'loop' true or false")
    keys = []
    for i, entry in enumerate(_entries(values, "keyframes", where)):
        here = f"{where}: keyframe {i}"
        keys.append(
            Keyframe(
                time=number(entry, "time", here),
                pose=Pose(
                    target=array(entry, "target", (3,), here),
                    distance=number(entry, "distance", here),
                    R_camera_world=array(entry, "rotation", (3, 3), here),
                    fov_y=number(entry, "fov_y", here),
                ),
            )
        )
    up = array(values, "up", (3,), where)
    duration = number(values, "duration", where)
    return CameraPath(keyframes=tuple(keys), duration=duration, loop=loop, motion=motion, up=up)


def _entries(values: dict[str, Any], key: str, where: str) -> list[dict[str, Any]]:
    entries = values.get(key)
    if not (isinstance(entries, list) and entries and all(isinstance(entry, dict) for entry in entries)):
        raise InputError(f"{where}: {key!r} must be a list of objects, at least one")
    return entries


def _film_of(content: dict[str, Any], where: str) -> dict[str, Any]:
    """Frame rate and size of the pictures, where a file of nerfstudio says them."""
    fps = number(content, "fps", where) if "fps" in content else None
    if fps is not None and not 0 < fps <= 1000:
        raise InputError(f"{where}: 'fps' must be between 0 and 1000, not {fps:g}")
    sides = [number(content, key, where) for key in ("render_width", "render_height") if key in content]
    whole = len(sides) == 2 and all(1 <= side <= 1 << 16 and side == int(side) for side in sides)
    return {"fps": fps, "size": (int(sides[0]), int(sides[1])) if whole else None}


def _nerfstudio(content: dict[str, Any], where: str) -> PathFile:
    """One camera for each frame of the film."""
    kind = content.get("camera_type", "perspective")
    if kind != "perspective":
        raise InputError(f"{where}: a film of camera_type {excerpt(str(kind))}; only perspective is filmed")
    found = _film_of(content, where)
    entries = _entries(content, "camera_path", where)
    fps = found["fps"] or 24.0
    keys, ups = [], []
    for i, entry in enumerate(entries):
        here = f"{where}: camera {i}"
        matrix = array(entry, "camera_to_world", (16,), here).reshape(4, 4)
        turn = matrix[:3, :3]
        if not (
            np.isfinite(matrix).all()
            and abs(turn @ turn.T - np.eye(3)).max() < 1e-2
            and np.linalg.det(turn) > 0
        ):
            raise InputError(f"{here}: 'camera_to_world' holds no rotation")
        R = OPENGL @ matrix_of(quaternion(turn)).T
        pose = Pose(
            target=matrix[:3, 3] + R[2],
            distance=1.0,
            R_camera_world=R,
            fov_y=number(entry, "fov", here),
        )
        keys.append(Keyframe(time=i / fps, pose=pose))
        ups.append(-R[1])
    up = np.mean(ups, axis=0)
    up = up if np.linalg.norm(up) > 1e-3 else ups[0]
    path = CameraPath(keyframes=tuple(keys), duration=(len(keys) - 1) / fps, motion="fly", up=up)
    return PathFile(path=path, **found)


def _as_nerfstudio(pose: Pose, aspect: float, key: str) -> dict[str, Any]:
    matrix = np.eye(4)
    matrix[:3, :3] = pose.R_camera_world.T @ OPENGL
    matrix[:3, 3] = pose.eye
    return {key: matrix.ravel().tolist(), "fov": pose.fov_y, "aspect": aspect}


def _supersplat(tracks: list[Any], where: str, aspect: float) -> PathFile:
    """Times are in frames, positions in a world with y up."""
    if not (tracks and isinstance(tracks[0], dict)):
        raise InputError(f"{where}: 'animTracks' holds no track")
    track, where = tracks[0], f"{where}: the first track"
    if track.get("interpolation", "spline") != "spline":
        raise InputError(f"{where}: has interpolation {excerpt(str(track['interpolation']))}, not spline")
    keyframes = track.get("keyframes")
    keyframes = keyframes if isinstance(keyframes, dict) else {}
    values, times = keyframes.get("values"), keyframes.get("times")
    if not (isinstance(values, dict) and isinstance(times, list) and times):
        raise InputError(f"{where}: 'keyframes' must have times and values")
    count, fps = len(times), number(track, "frameRate", where)
    if not 0 < fps <= 1000:
        raise InputError(f"{where}: 'frameRate' must be between 0 and 1000, not {fps:g}")
    seconds = array(keyframes, "times", (count,), where) / fps
    eyes = array(values, "position", (3 * count,), where).reshape(-1, 3) @ PLAYCANVAS
    targets = array(values, "target", (3 * count,), where).reshape(-1, 3) @ PLAYCANVAS
    fovs = array(values, "fov", (count,), where) if "fov" in values else np.full(count, 60.0)
    up = np.array((0.0, -1.0, 0.0))
    keys = []
    for time, eye, target, fov in zip(seconds, eyes, targets, fovs, strict=True):
        half = math.tan(math.radians(float(fov)) / 2) / max(aspect, 1.0) if 0 < fov < 180 else math.nan
        pose = Pose(
            target=target,
            distance=float(np.linalg.norm(target - eye)),
            R_camera_world=look_at_matrix(eye, target, up)[:3, :3],
            fov_y=math.degrees(2 * math.atan(half)),
        )
        keys.append(Keyframe(time=float(time), pose=pose))
    duration = max(number(track, "duration", where), float(seconds.max()))
    mode = track.get("loopMode", "none")
    if mode == "pingpong":
        back = [replace(key, time=2 * duration - key.time) for key in keys if 0 < key.time < duration]
        keys, duration = [*keys, *back], 2 * duration
    elif mode == "repeat" and not float(seconds.max() - seconds.min()) < duration:
        duration += 1 / fps
    loop = mode in ("repeat", "pingpong")
    path = CameraPath(keyframes=tuple(keys), duration=duration, loop=loop, motion="fly", up=up)
    return PathFile(path=path, fps=fps)
