"""COLMAP captures, binary and text."""

from __future__ import annotations

import os
import shutil
import struct
from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import InputError, Lens, look_at
from splatview.scene.captures import load_capture
from splatview.scene.captures.capture import MOST_STRAY, astray
from splatview.scene.progress import Cancelled, Progress

from .conftest import ring


@pytest.mark.parametrize("text", [False, True])
def test_photos_poses_and_points(tmp_path, colmap_capture, pixels_of, text):
    cameras = colmap_capture(tmp_path / "cap", text=text)
    (tmp_path / "cap/sparse/0/rigs.bin").write_bytes(b"\xff" * 9)
    (tmp_path / "cap/sparse/0/frames.bin").write_bytes(b"")
    capture = load_capture(tmp_path / "cap")
    assert capture.name == "cap"
    assert capture.warnings == ()
    assert [photo.name for photo in capture.photos] == [f"p{i:02d}.png" for i in range(9)]
    assert [photo.name for photo in capture.held_out] == ["p00.png", "p08.png"]
    assert len(capture.train) == 7
    for i, (photo, camera) in enumerate(zip(capture.photos, cameras, strict=True)):
        np.testing.assert_allclose(photo.camera.world_to_camera, camera.world_to_camera, atol=1e-12)
        assert (photo.camera.fx, photo.camera.cx) == (camera.fx, camera.cx)
        np.testing.assert_array_equal(photo.image(), pixels_of(i))
        assert not photo.image().flags.writeable
        assert photo.mask() is None
    np.testing.assert_array_equal(capture.points, np.random.default_rng(1).normal(size=(12, 3)))
    np.testing.assert_array_equal(capture.point_colours, [(i, 10, 250) for i in range(12)])


def test_scene_radius(tmp_path, colmap_capture):
    cameras = colmap_capture(tmp_path)
    eyes = np.array([camera.eye for camera in cameras[1:8]])
    radius = np.linalg.norm(eyes - eyes.mean(axis=0), axis=1).max()
    capture = load_capture(tmp_path)
    assert capture.scene_radius == pytest.approx(1.1 * radius)
    np.testing.assert_allclose(capture.middle, eyes.mean(axis=0))
    around = replace(capture, points=eyes.mean(axis=0) + 0.1 * capture.points)
    assert around.usual_distance == around.scene_radius
    rays = capture.points / np.linalg.norm(capture.points, axis=1, keepdims=True)
    ahead = replace(capture, points=eyes.mean(axis=0) + 7 * radius * rays)
    assert ahead.extent == ahead.usual_distance == pytest.approx(7 * radius)
    assert replace(ahead, guessed=True).extent == ahead.scene_radius


@pytest.mark.parametrize("times", [10, 1e9])
def test_one_camera_far_away_makes_the_scene_no_larger(tmp_path, colmap_capture, times):
    cameras = colmap_capture(tmp_path / "good")
    good = load_capture(tmp_path / "good")
    pose = cameras[3].world_to_camera.copy()
    pose[:3, 3] *= times
    cameras[3] = replace(cameras[3], world_to_camera=pose)
    colmap_capture(tmp_path / "bad", cameras=cameras)
    bad = load_capture(tmp_path / "bad")
    others = replace(good, photos=tuple(photo for photo in good.photos if photo.name != bad.photos[3].name))
    assert bad.scene_radius == pytest.approx(others.scene_radius)
    np.testing.assert_allclose(bad.middle, others.middle)
    assert bad.extent == pytest.approx(others.extent)
    assert np.linalg.norm(bad.centre - good.centre) <= 2 * good.scene_radius
    (told,) = (line for line in bad.warnings if "as far away" in line)
    assert told.startswith("1 of 9 cameras stand") and told.endswith(bad.photos[3].name)
    assert not any("as far away" in line for line in good.warnings)


def test_many_cameras_from_farther_away_are_not_astray(tmp_path, colmap_capture):
    eyes = np.array([camera.eye for camera in colmap_capture(tmp_path)])
    for count in range(len(eyes)):
        few = 0 < count < MOST_STRAY * len(eyes)
        spread = eyes * np.where(np.arange(len(eyes)) < count, 100, 1)[:, None]
        assert np.array_equal(np.flatnonzero(astray(spread)), np.arange(count if few else 0)), count
    assert not astray(np.zeros((3, 3))).any()
    assert not astray(np.eye(9, 3) * [1, 0, 0]).any(), "a tripod, but for one photo"


@pytest.mark.parametrize("stretched", [1.9, 27.0, 1 / 27.0])
def test_pixels_far_from_square_are_told_as_a_wrong_calibration(tmp_path, colmap_capture, stretched):
    cameras = colmap_capture(tmp_path / "good")
    cameras[2] = replace(cameras[2], fy=stretched * cameras[2].fx)
    colmap_capture(tmp_path / "bad", cameras=cameras)
    told = [line for line in load_capture(tmp_path / "bad").warnings if "calibration is wrong" in line]
    assert ["27 times" in line for line in told] == [True] * (stretched != 1.9)


@pytest.mark.parametrize("factor", [1.0, 1e-4])
def test_a_scene_within_the_near_plane_is_told(tmp_path, colmap_capture, cameras_of, factor):
    cameras = []
    for camera in cameras_of(9):
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= factor
        cameras.append(replace(camera, world_to_camera=pose))
    colmap_capture(tmp_path, cameras=cameras, points=factor * np.random.default_rng(1).normal(size=(12, 3)))
    told = [line for line in load_capture(tmp_path).warnings if "multiply" in line]
    assert ["by 10,000 say" in line for line in told] == [True] * (factor != 1)


def test_by_the_folder_of_the_model_and_with_photos_beside_it(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    assert len(load_capture(tmp_path / "sparse" / "0").photos) == 9
    (tmp_path / "images").rename(tmp_path / "input")
    assert len(load_capture(tmp_path).photos) == 9


def test_a_workspace_without_its_photos_has_those_out_of_their_lens(tmp_path, colmap_capture):
    """As COLMAP's automatic reconstruction leaves it; of two, that with more photos."""
    colmap_capture(tmp_path, photos=False)
    for number, count in enumerate((4, 9, 5)):
        colmap_capture(tmp_path / "dense" / str(number), cameras=ring(count))
    (tmp_path / "dense" / "notes").mkdir()
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 9 and capture.name == tmp_path.name
    shutil.rmtree(tmp_path / "sparse")
    assert len(load_capture(tmp_path).photos) == 9
    # With photos of its own it is a capture itself.
    shutil.rmtree(tmp_path / "dense" / "1")
    colmap_capture(tmp_path, cameras=ring(7))
    assert len(load_capture(tmp_path).photos) == 7


def test_missing_photos_are_named_and_left_out(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    (tmp_path / "images/p00.png").unlink()
    (tmp_path / "images/p04.png").unlink()
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 7
    assert capture.held_out[0].name == "p01.png"
    assert capture.warnings == (
        f"2 of 9 photos are not in {tmp_path / 'images'} and are left out: p00.png, p04.png",
    )


def test_several_cameras_and_subfolders(tmp_path, colmap_capture, cameras_of):
    cameras = [camera.resized(40 + 2 * i, 30 + i) for i, camera in enumerate(cameras_of(4))]
    colmap_capture(tmp_path, cameras=cameras, names=["b/1.png", "b/0.png", "a/1.png", "a/0.png"])
    capture = load_capture(tmp_path)
    assert [photo.name for photo in capture.photos] == ["a/0.png", "a/1.png", "b/0.png", "b/1.png"]
    assert [photo.camera.width for photo in capture.photos] == [46, 44, 42, 40]


def test_held_out_by_list(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    (tmp_path / "sparse/0/test.txt").write_text("p03.png\n\np05.png\n")
    assert [photo.name for photo in load_capture(tmp_path).held_out] == ["p03.png", "p05.png"]


def test_downscaling_keeps_the_rays(tmp_path, colmap_capture):
    cameras = colmap_capture(tmp_path)
    photo = load_capture(tmp_path, downscale=7).photos[2]
    assert (photo.camera.width, photo.camera.height) == (5, 4)
    assert photo.image().shape == (4, 5, 3)
    assert photo.camera.fx == pytest.approx(cameras[2].fx * 5 / 40)
    assert photo.camera.fy == pytest.approx(cameras[2].fy * 4 / 30)
    assert photo.camera.cy == pytest.approx(cameras[2].cy * 4 / 30)


def test_distortion_is_taken_out(tmp_path, colmap_capture):
    colmap_capture(tmp_path, model=4, distortion=(0.3, 0.0, 0.0, 0.0))
    photo = load_capture(tmp_path, lens="undistort").photos[0]
    mask = photo.mask()
    assert mask is not None
    # A pincushion: the corners of the pinhole picture are outside the photo.
    assert not mask[0, 0]
    assert mask[15, 20]
    assert 0.3 < mask.mean() < 0.95


def test_what_undistortion_loses_is_said(tmp_path, colmap_capture):
    colmap_capture(tmp_path, model=4, distortion=(-0.3, 0.0, 0.0, 0.0))
    (warning,) = load_capture(tmp_path, lens="undistort").warnings
    assert "of each OPENCV photo lies outside" in warning


def test_photos_stay_as_the_lens_took_them(tmp_path, colmap_capture, pixels_of):
    colmap_capture(tmp_path, model=4, distortion=(-0.3, 0.0, 0.0, 0.0))
    capture = load_capture(tmp_path, lens="through", downscale=2)
    assert capture.warnings == ()
    plain = capture.photos[0]
    assert plain.camera.lens == Lens(model="OPENCV", parameters=(-0.3, 0.0, 0.0, 0.0))
    assert plain.mask() is None
    whole = load_capture(tmp_path, lens="through").photos[0]
    np.testing.assert_array_equal(whole.image(), pixels_of(0))
    # The lens is the same at any size.
    point = np.array([0.3, -0.2, 1.5])
    np.testing.assert_allclose(plain.camera.image_points(point) * 2, whole.camera.image_points(point))


def test_what_a_fisheye_does_not_see_is_masked(tmp_path, colmap_capture):
    """Pixels farther from the middle than what is seen at 90 degrees."""
    cameras = [
        replace(look_at((3 * np.sin(a), 0, 3 * np.cos(a)), (0, 0, 0), width=40, height=30), fx=12.0, fy=12.0)
        for a in range(9)
    ]
    colmap_capture(tmp_path, cameras=cameras, model=5, distortion=(-0.1, 0.0, 0.0, 0.0))
    mask = load_capture(tmp_path, lens="through").photos[0].mask()
    x, y = np.meshgrid(np.arange(40) - 19.5, np.arange(30) - 14.5)
    edge = np.pi / 2 * (1 - 0.1 * (np.pi / 2) ** 2)
    np.testing.assert_array_equal(mask, np.hypot(x, y) / 12 < edge)


@pytest.mark.parametrize("name", ["p02.png", "p02.png.png", "p02.jpg"])
def test_masks(tmp_path, colmap_capture, png, name):
    colmap_capture(tmp_path)
    mask = np.full((30, 40), 255, np.uint8)
    mask[:10] = 0
    png(tmp_path / "masks" / name, mask)
    capture = load_capture(tmp_path, downscale=2)
    result = capture.photos[2].mask()
    assert result is not None
    np.testing.assert_array_equal(result, np.repeat(np.arange(15) >= 5, 20).reshape(15, 20))
    assert capture.photos[1].mask() is None


def test_mask_and_distortion_together(tmp_path, colmap_capture, png):
    colmap_capture(tmp_path, model=2, distortion=(0.2,))
    mask = np.full((30, 40), 255, np.uint8)
    mask[:, 20:] = 0
    png(tmp_path / "masks/p01.png", mask)
    capture = load_capture(tmp_path, lens="undistort")
    alone, masked = capture.photos[0].mask(), capture.photos[1].mask()
    assert alone is not None and masked is not None
    assert alone[15, 30] and not masked[:, 20:].any()
    np.testing.assert_array_equal(masked[:, :18], alone[:, :18])


def test_without_points_there_are_random_ones(tmp_path, colmap_capture):
    colmap_capture(tmp_path, points=np.empty((0, 3)))
    first, second = load_capture(tmp_path), load_capture(tmp_path)
    np.testing.assert_array_equal(first.points, second.points)
    assert "no points" in first.warnings[0] and first.guessed
    # Around what the cameras look at, and before all of them.
    assert np.linalg.norm(first.points.mean(axis=0)) < 0.1
    for photo in first.photos:
        camera = photo.camera
        assert ((first.points @ camera.R_camera_world.T + camera.t_camera_world)[:, 2] > 0.5).all()


def test_points_that_are_not_finite_are_left_out(tmp_path, colmap_capture):
    points = np.zeros((9, 3))
    points[2, 1], points[5, 0] = np.nan, np.inf
    colmap_capture(tmp_path, points=points)
    capture = load_capture(tmp_path)
    assert capture.points.shape == (7, 3)
    assert capture.warnings == ("2 of 9 points are not finite, or out of all bounds, and left out",)


def test_large_captures_are_read_again(tmp_path, colmap_capture, pixels_of, monkeypatch):
    monkeypatch.setattr("splatview.scene.captures.assemble.KEEP_BYTES", 3 * 30 * 40 * 3)
    colmap_capture(tmp_path)
    capture = load_capture(tmp_path)
    np.testing.assert_array_equal(capture.photos[7].image(), pixels_of(7))
    (tmp_path / "images/p07.png").unlink()
    (tmp_path / "images/p01.png").unlink()
    assert capture.photos[1].image().shape == (30, 40, 3)
    with pytest.raises(InputError, match=r"p07\.png"):
        capture.photos[7].image()


def test_progress_and_cancelling(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    shares: list[float] = []
    load_capture(tmp_path, progress=Progress(report=shares.append))
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0, 1)
    calls = iter([False, False, True])
    with pytest.raises(Cancelled):
        load_capture(tmp_path, progress=Progress(cancelled=lambda: next(calls)))


@pytest.mark.parametrize("text", [False, True])
def test_a_large_model_without_its_photos_is_refused_early(tmp_path, colmap_capture, monkeypatch, text):
    """Folders are listed once, not asked for each photo; points are not read; one may cancel on the way."""
    colmap_capture(tmp_path, photos=False, text=text)
    model, names = tmp_path / "sparse/0", [f"frames/{i % 3}/{i:05d}" for i in range(9000)]
    if text:
        (model / "images.txt").write_text(
            "".join(f"{i} 1 0 0 0 0 0 0 1 {n}\n\n" for i, n in enumerate(names))
        )
    else:
        rows = (
            struct.pack("<I7dI", i, 1, *[0.0] * 6, 1) + n.encode() + bytes(9) for i, n in enumerate(names)
        )
        (model / "images.bin").write_bytes(struct.pack("<Q", len(names)) + b"".join(rows))
    (model / f"points3D{'.txt' if text else '.bin'}").write_bytes(b"damaged")
    (tmp_path / "images/frames/0").mkdir(parents=True)
    (tmp_path / "images/frames/0/other.png").touch()
    asked: list[object] = []
    for name in ("stat", "scandir"):
        call = getattr(os, name)
        monkeypatch.setattr(os, name, lambda *a, call=call, **k: (asked.append(a), call(*a, **k))[1])
    shares: list[float] = []
    with pytest.raises(
        InputError, match=r"none of its 9,000 photos is in .*images \(the first is frames/0/00000"
    ):
        load_capture(tmp_path, progress=Progress(report=shares.append))
    assert len(asked) < 300
    assert len(shares) >= 5 and shares == sorted(shares)
    for calls in range(5):
        answers = iter([*[False] * calls, True])
        with pytest.raises(Cancelled):
            load_capture(tmp_path, progress=Progress(cancelled=lambda answers=answers: next(answers)))


def test_truncated_anywhere(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    path = tmp_path / "sparse/0/points3D.bin"
    whole = path.read_bytes()
    for size in range(0, len(whole), 13):
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match=r"points3D\.bin.*truncated"):
            load_capture(tmp_path)
    path.write_bytes(struct.pack("<Q", 2**60))
    with pytest.raises(InputError, match="truncated"):
        load_capture(tmp_path)
