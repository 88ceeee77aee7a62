"""Panoramas of a world whose colours are known in each direction, cut into faces."""

from __future__ import annotations

import json
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from splatview.scene import InputError
from splatview.scene.captures import load_capture, read_poses
from splatview.scene.captures.panoramas import FACES, side_of
from splatview.scene.captures.photos import downscaled_size
from splatview.scene.progress import NO_PROGRESS
from splatview.trainer.memory import sizes_of_files

WIDTH = 256


def colours(directions: np.ndarray) -> np.ndarray:
    """(..., 3) unit directions in the world -> (..., 3) uint8, smooth, and different in each."""
    return np.round(127.5 * (1 + directions)).astype(np.uint8)


def panorama(to_world: np.ndarray, width: int = WIDTH) -> np.ndarray:
    """(width / 2, width, 3) uint8 by nerfstudio's formula, for a camera with OpenGL's axes."""
    height = width // 2
    x = (np.arange(width) + 0.5 - width / 2) / height
    y = (np.arange(height) + 0.5 - height / 2) / height
    theta, phi = np.meshgrid(-np.pi * x, np.pi * (0.5 + y))
    local = np.stack([-np.sin(theta) * np.sin(phi), np.cos(phi), -np.cos(theta) * np.sin(phi)], axis=-1)
    return colours(local @ to_world[:3, :3].T)


def pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3] = rotation * np.sign(np.linalg.det(rotation))
    matrix[:3, 3] = rng.normal(size=3)
    return matrix


def write(folder: Path, count: int = 9, suffix: str = ".png", **more: Any) -> list[np.ndarray]:
    """A capture of panoramas, and their poses."""
    (folder / "images").mkdir(parents=True, exist_ok=True)
    poses = [pose(i) for i in range(count)]
    frames = []
    for i, matrix in enumerate(poses):
        name = f"images/p{i}{suffix}"
        Image.fromarray(panorama(matrix)).save(folder / name, quality=95)
        frames.append({"file_path": name, "transform_matrix": matrix.tolist()})
    content = {"camera_model": "EQUIRECTANGULAR", "w": WIDTH, "h": WIDTH // 2, "frames": frames, **more}
    (folder / "transforms.json").write_text(json.dumps(content))
    return poses


def write_colmap(folder: Path, *, text: bool) -> list[np.ndarray]:
    """The capture of `write` as COLMAP has it, whose cameras look along z, y down; and its poses."""
    poses = write(folder)
    (folder / "transforms.json").unlink()
    model = folder / "sparse/0"
    model.mkdir(parents=True)
    size = (WIDTH, WIDTH // 2)
    rows = []
    for i, matrix in enumerate(poses):
        world_to_camera = np.linalg.inv(matrix @ np.diag([1.0, -1.0, -1.0, 1.0]))
        R = world_to_camera[:3, :3]
        w = math.sqrt(1 + np.trace(R)) / 2
        quat = (w, *(np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / (4 * w)))
        rows.append((f"p{i}.png", (*quat, *world_to_camera[:3, 3])))
    if text:
        (model / "cameras.txt").write_text(f"1 EQUIRECTANGULAR {size[0]} {size[1]} {size[0]} {size[1]}\n")
        lines = [
            f"{i} {' '.join(map(str, map(float, pose)))} 1 {name}\n\n" for i, (name, pose) in enumerate(rows)
        ]
        (model / "images.txt").write_text("".join(lines))
        return poses
    (model / "cameras.bin").write_bytes(struct.pack("<QIiQQ2d", 1, 1, 17, *size, *size))
    data = struct.pack("<Q", len(rows))
    for i, (name, pose) in enumerate(rows):
        data += struct.pack("<I7dI", i, *pose, 1) + name.encode() + b"\0" + struct.pack("<Q", 0)
    (model / "images.bin").write_bytes(data)
    return poses


def expected(camera: Any) -> np.ndarray:
    """(H, W, 3) uint8: what a photo's camera sees of the world."""
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    rays = camera.points_at(np.stack(np.meshgrid(x, y), axis=-1), 1.0) @ camera.R_camera_world
    return colours(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


@pytest.mark.parametrize(
    ("downscale", "suffix", "tolerance"), [(1, ".png", 2), (3, ".png", 3), (4, ".jpg", 8)]
)
def test_each_face_shows_what_its_camera_sees(tmp_path, downscale, suffix, tolerance):
    poses = write(tmp_path, suffix=suffix)
    capture = load_capture(tmp_path, downscale=downscale)
    assert len(capture.photos) == len(FACES) * len(poses)
    side, _ = downscaled_size(side_of(WIDTH), side_of(WIDTH), downscale)
    eyes = np.array([matrix[:3, 3] for matrix in poses])
    for photo in capture.photos:
        assert (photo.camera.width, photo.camera.height) == (side, side)
        assert photo.camera.fx == pytest.approx(side / 2)
        assert np.linalg.norm(eyes - photo.camera.eye, axis=1).min() < 1e-9
        difference = photo.image().astype(int) - expected(photo.camera)
        assert abs(difference).max() <= tolerance, photo.name
    assert "9 panoramas are cut into 6 photos each, 90 degrees wide" in capture.warnings


@pytest.mark.parametrize("text", [False, True])
def test_colmap_has_panoramas_too(tmp_path, text):
    poses = write_colmap(tmp_path, text=text)
    (tmp_path / "sparse/0/test.txt").write_text("p3.png\n")
    capture = load_capture(tmp_path)
    assert len(capture.photos) == len(FACES) * len(poses)
    for photo in capture.photos:
        assert abs(photo.image().astype(int) - expected(photo.camera)).max() <= 2, photo.name
    assert [photo.name for photo in capture.held_out] == sorted(f"p3_{face}.png" for face in FACES)
    assert "9 panoramas are cut into 6 photos each, 90 degrees wide" in capture.warnings


def test_faces_meet_without_gap(tmp_path):
    """All pixels of a face are filled, and the faces' angles add up to the whole sphere."""
    write(tmp_path)
    solid = 0.0
    for photo in load_capture(tmp_path).photos[: len(FACES)]:
        camera = photo.camera
        assert photo.mask() is None
        x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
        squared = 1 + x[None, :] ** 2 + x[:, None] ** 2
        solid += float((squared**-1.5).sum()) / camera.fx**2
    assert solid == pytest.approx(4 * math.pi, rel=1e-4)


def test_a_panorama_is_held_out_as_a_whole(tmp_path):
    write(tmp_path)
    capture = load_capture(tmp_path)
    held_out = {photo.name.rpartition("_")[0] for photo in capture.held_out}
    assert held_out == {"images/p0", "images/p8"}
    assert len(capture.held_out) == 2 * len(FACES)
    write(tmp_path, test_filenames=["images/p3.png"])
    held_out = [photo.name for photo in load_capture(tmp_path).held_out]
    assert held_out == sorted(f"images/p3_{face}.png" for face in FACES)


def test_masks_and_transparency(tmp_path):
    """Of a mask that hides what is below the camera, and of a panorama that is transparent there."""
    poses = write(tmp_path)
    (tmp_path / "masks").mkdir()
    below = np.zeros((WIDTH // 2, WIDTH), np.uint8)
    below[: WIDTH // 4] = 255
    for i, matrix in enumerate(poses):
        Image.fromarray(below).save(tmp_path / "masks" / f"p{i}.png")
        rgba = np.dstack([panorama(matrix), below])
        Image.fromarray(rgba).save(tmp_path / "images" / f"p{i}.png")
    capture = load_capture(tmp_path, masks="cut-out")
    by_face = {face: [one for one in capture.photos if one.name.endswith(f"_{face}.png")] for face in FACES}
    side = side_of(WIDTH)
    for photo in by_face["front"]:
        alpha = photo.pixels().alpha
        assert alpha is not None
        assert (alpha[: side // 2 - 1] == 255).all() and (alpha[side // 2 + 1 :] == 0).all()
    assert all((one.pixels().alpha == 255).all() for one in by_face["up"])
    assert all((one.pixels().alpha == 0).all() for one in by_face["down"])
    for i, matrix in enumerate(poses):
        Image.fromarray(panorama(matrix)).save(tmp_path / "images" / f"p{i}.png")
    capture = load_capture(tmp_path, downscale=2)
    assert not any(photo.name.endswith("_down.png") for photo in capture.photos)  # nothing of them is left
    mask = next(photo.mask() for photo in capture.photos if photo.name.endswith("_left.png"))
    assert mask is not None and mask[: side // 4 - 1].all() and not mask[side // 4 + 1 :].any()


@pytest.mark.parametrize("count", [7, 9])
def test_where_all_are_transparent_at_the_pole_it_is_not_empty(tmp_path, count):
    """As where a tripod was taken out: what it hides is unknown."""
    opacity = np.full((WIDTH // 2, WIDTH), 255, np.uint8)
    opacity[-20:] = 0
    for i, matrix in enumerate(write(tmp_path, count)):
        Image.fromarray(np.dstack([panorama(matrix), opacity])).save(tmp_path / "images" / f"p{i}.png")
    capture = load_capture(tmp_path)
    assert capture.background is None
    for photo in capture.photos:
        assert photo.pixels().alpha is None
        assert (photo.mask() is None) == (not photo.name.endswith("_down.png")), photo.name


def test_a_file_that_does_not_go_all_the_way_round(tmp_path):
    write(tmp_path)
    Image.new("RGB", (WIDTH, 100)).save(tmp_path / "images/p4.png")
    with pytest.raises(InputError, match=r"p4\.png: is 256x100 pixels, but a panorama"):
        load_capture(tmp_path)


def test_memory_counts_the_whole_file(tmp_path):
    write(tmp_path)
    _, posed = read_poses(tmp_path, NO_PROGRESS)
    assert sizes_of_files(posed.entries, 1).stored == pytest.approx(WIDTH**2 / 2, rel=0.02)
