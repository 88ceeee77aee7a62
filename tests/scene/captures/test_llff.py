"""Captures by poses_bounds.npy, written by a writer of the test's own."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.scene import Camera, InputError
from splatview.scene.captures import load_capture


def rows_of(cameras: list[Camera], larger: float = 1.0) -> np.ndarray:
    """(N, 17): cameras as LLFF stores them, of photos that are so many times larger."""
    rows = []
    for camera in cameras:
        right, down, forward = camera.R_camera_world
        size = np.array([camera.height, camera.width, camera.fx]) * larger
        rows.append(np.r_[np.stack([down, right, -forward, camera.eye, size], axis=1).ravel(), 1.0, 9.0])
    return np.array(rows)


@pytest.fixture
def cameras(cameras_of):
    return cameras_of(9)


def photos(folder: Path, png, pixels_of, count: int = 9, size: tuple[int, int] = (40, 30)) -> None:
    for i in range(count):
        png(folder / f"{i:02}.png", pixels_of(i, *size))


@pytest.fixture
def capture_of(tmp_path, cameras, png, pixels_of):
    photos(tmp_path / "images", png, pixels_of)
    np.save(tmp_path / "poses_bounds.npy", rows_of(cameras))
    return tmp_path


@pytest.mark.parametrize("by", ["", "poses_bounds.npy"])
def test_poses(capture_of, cameras, pixels_of, by):
    capture = load_capture(capture_of / by)
    assert [photo.name for photo in capture.held_out] == ["00.png", "08.png"]
    assert capture.guessed
    for i, (photo, camera) in enumerate(zip(capture.photos, cameras, strict=True)):
        np.testing.assert_allclose(photo.camera.world_to_camera, camera.world_to_camera, atol=1e-12)
        assert (photo.camera.fx, photo.camera.fy) == pytest.approx((camera.fx, camera.fx))
        assert (photo.camera.cx, photo.camera.cy) == (20, 15)
        np.testing.assert_array_equal(photo.image(), pixels_of(i))


def test_smaller_copies(tmp_path, cameras, png, pixels_of):
    """Of several folders the one with the largest photos, at the scale that their size tells."""
    photos(tmp_path / "images_8", png, pixels_of, size=(20, 15))
    photos(tmp_path / "images_4", png, pixels_of)
    np.save(tmp_path / "poses_bounds.npy", rows_of(cameras, larger=4))
    capture = load_capture(tmp_path)
    assert (capture.photos[0].camera.width, capture.photos[0].camera.height) == (40, 30)
    assert capture.photos[0].camera.fx == pytest.approx(cameras[0].fx)


def test_a_folder_with_as_many_photos_as_poses_wins(capture_of, png, pixels_of):
    (capture_of / "images" / "08.png").unlink()
    photos(capture_of / "images_2", png, pixels_of, size=(20, 15))
    assert load_capture(capture_of).photos[0].camera.width == 20


def test_masks_and_points(capture_of, png):
    """Points of a model without its poses, which is how LLFF's scripts are often given away."""
    for i in range(9):
        png(capture_of / "masks" / f"{i:02}.png", np.full((30, 40), 255 if i else 0, np.uint8))
    model = capture_of / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 PINHOLE 40 30 36 36 20 15\n")
    (model / "points3D.txt").write_text("".join(f"{i} {i} 2 3 10 20 {i} 0.5\n" for i in range(5)))
    capture = load_capture(capture_of)
    assert len(capture.photos) == 8 and "masks hide all" in capture.warnings[0]
    assert not capture.guessed
    np.testing.assert_array_equal(capture.points, [(i, 2, 3) for i in range(5)])


def test_a_whole_colmap_model_is_read_first(tmp_path, colmap_capture, cameras):
    colmap_capture(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", rows_of(cameras)[:4])
    assert len(load_capture(tmp_path).photos) == 9


def test_photos_on_their_side(tmp_path, cameras, pixels_of):
    """Posed the way up that EXIF says."""
    (tmp_path / "images").mkdir()
    for i in range(9):
        exif = Image.Exif()
        exif[0x0112] = 6
        Image.fromarray(pixels_of(i, 30, 40)).save(tmp_path / f"images/{i}.jpg", exif=exif)
    np.save(tmp_path / "poses_bounds.npy", rows_of(cameras))
    assert load_capture(tmp_path).photos[0].image().shape == (30, 40, 3)


def wrong(rows: np.ndarray, place: tuple[int, int], value: float) -> np.ndarray:
    rows = rows.copy()
    rows[place] = value
    return rows


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: rows[:8], "has 8 poses for 9 photos"),
        (lambda rows: rows[:, :15], r"N x 17 numbers, not float64 of shape \(9, 15\)"),
        (lambda rows: rows.astype(complex), "N x 17 numbers"),
        (lambda rows: rows[0], "N x 17 numbers"),
        (lambda rows: wrong(rows, (3, 3), np.nan), r"row 3 \(03.png\): its numbers must be finite"),
        (lambda rows: wrong(rows, (0, 14), -5.0), "more than 0"),
        (lambda rows: wrong(rows, (0, 4), 60.0), "no smaller copy of the 40x60 px"),
        (lambda rows: wrong(rows, (2, 0), 9.0), "row 2"),
        (lambda rows: rows[:0], "names no photos"),
    ],
)
def test_one_line_for_what_does_not_fit(capture_of, cameras, change, said):
    np.save(capture_of / "poses_bounds.npy", change(rows_of(cameras)))
    with pytest.raises(InputError, match=said):
        load_capture(capture_of)


def array_bytes() -> bytes:
    file = io.BytesIO()
    np.save(file, np.zeros((1 << 10, 17)))
    return file.getvalue()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x93NUMPY",
        array_bytes()[:400],
        array_bytes().replace(b"1024", b"9999"),
        b"PK\x03\x04" + bytes(99),
    ],
)
def test_damaged_file(capture_of, data):
    (capture_of / "poses_bounds.npy").write_bytes(data)
    with pytest.raises(InputError, match=r"poses_bounds\.npy"):
        load_capture(capture_of)


def test_objects_are_not_unpickled(capture_of):
    np.save(capture_of / "poses_bounds.npy", np.array([{}], dtype=object), allow_pickle=True)
    with pytest.raises(InputError, match="no array of numpy"):
        load_capture(capture_of)


def test_no_photos(capture_of):
    shutil.rmtree(capture_of / "images")
    with pytest.raises(InputError, match="none of its 9 photos"):
        load_capture(capture_of)
