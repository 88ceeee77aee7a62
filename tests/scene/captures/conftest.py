"""Small captures on disk, written by writers of their own: the readers are not tested with themselves."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatview.scene import Camera, look_at

WIDTH, HEIGHT = 40, 30
MODELS = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV")


def ring(count: int) -> list[Camera]:
    """Cameras around the origin that look at it."""
    cameras = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        eye = (4 * np.cos(angle), -1.0, 4 * np.sin(angle))
        cameras.append(look_at(eye, (0, 0, 0), up=(0, -1, 0), width=WIDTH, height=HEIGHT, fov_y=45))
    return cameras


def picture(seed: int, width: int = WIDTH, height: int = HEIGHT, channels: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, size=(height, width, channels), dtype=np.uint8)


def quat_of(R: np.ndarray) -> np.ndarray:
    """wxyz of a rotation: the eigenvector of Bar-Itzhack's symmetric matrix with the largest eigenvalue."""
    (a, b, c), (d, e, f), (g, h, i) = R
    k = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def write_colmap(
    folder: Path,
    *,
    cameras: Sequence[Camera] | None = None,
    names: Sequence[str] | None = None,
    text: bool = False,
    model: int = 1,
    distortion: Sequence[float] = (),
    points: np.ndarray | None = None,
    photos: bool = True,
) -> list[Camera]:
    """A COLMAP capture of PNG photos; each camera has an entry of its own."""
    cameras = ring(9) if cameras is None else list(cameras)
    names = [f"p{i:02d}.png" for i in range(len(cameras))] if names is None else names
    points = np.random.default_rng(1).normal(size=(12, 3)) if points is None else points
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    lenses, images = [], []
    for i, camera in enumerate(cameras):
        focal = [camera.fx] if model in (0, 2, 3) else [camera.fx, camera.fy]
        lenses.append((i + 1, camera.width, camera.height, [*focal, camera.cx, camera.cy, *distortion]))
        images.append((i + 1, [*quat_of(camera.R_camera_world), *camera.t_camera_world], names[i]))
    colours = [(i % 256, 10, 250) for i in range(len(points))]
    if text:
        lines = [f"{n} {MODELS[model]} {w} {h} {' '.join(map(repr, map(float, p)))}" for n, w, h, p in lenses]
        (sparse / "cameras.txt").write_text("# cameras\n" + "\n".join(lines) + "\n")
        lines = [f"{n} {' '.join(map(repr, map(float, p)))} {n} {name}\n1.5 2.5 -1" for n, p, name in images]
        (sparse / "images.txt").write_text("# images\n" + "\n".join(lines) + "\n")
        lines = [
            f"{i + 1} {' '.join(map(repr, map(float, p)))} {r} {g} {b} 0.5 1 0 2 3"
            for i, (p, (r, g, b)) in enumerate(zip(points, colours, strict=True))
        ]
        (sparse / "points3D.txt").write_text("# points\n" + "\n".join(lines) + "\n")
    else:
        raw = struct.pack("<Q", len(lenses))
        for n, w, h, p in lenses:
            raw += struct.pack(f"<IiQQ{len(p)}d", n, model, w, h, *p)
        (sparse / "cameras.bin").write_bytes(raw)
        raw = struct.pack("<Q", len(images))
        for n, p, name in images:
            raw += struct.pack("<I7dI", n, *p, n) + name.encode() + b"\0"
            raw += struct.pack("<QddQ", 1, 1.5, 2.5, 2**64 - 1)
        (sparse / "images.bin").write_bytes(raw)
        raw = struct.pack("<Q", len(points))
        for i, (p, colour) in enumerate(zip(points, colours, strict=True)):
            track = i % 4
            raw += struct.pack(f"<Q3d3BdQ{2 * track}I", i + 1, *p, *colour, 0.5, track, *range(2 * track))
        (sparse / "points3D.bin").write_bytes(raw)
    if photos:
        for i, (camera, name) in enumerate(zip(cameras, names, strict=True)):
            save_png(folder / "images" / name, picture(i, camera.width, camera.height))
    return cameras


def save_png(path: Path, pixels: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def opengl_matrix(camera: Camera) -> list[list[float]]:
    """Camera-to-world with y up and z backward."""
    return (np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])).tolist()


def write_transforms(path: Path, frames: Sequence[Mapping[str, Any]], **top: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({**top, "frames": list(frames)}))


@pytest.fixture
def colmap_capture() -> Callable[..., list[Camera]]:
    """`colmap_capture(folder, ...)`: see `write_colmap`."""
    return write_colmap


@pytest.fixture
def cameras_of() -> Callable[[int], list[Camera]]:
    return ring


@pytest.fixture
def pixels_of() -> Callable[..., np.ndarray]:
    """`pixels_of(seed, width, height, channels)`: noise, uint8."""
    return picture


@pytest.fixture
def png() -> Callable[[Path, np.ndarray], None]:
    return save_png


@pytest.fixture
def transforms() -> Callable[..., None]:
    """`transforms(path, frames, **top)`: see `write_transforms`."""
    return write_transforms


@pytest.fixture
def to_opengl() -> Callable[[Camera], list[list[float]]]:
    return opengl_matrix
