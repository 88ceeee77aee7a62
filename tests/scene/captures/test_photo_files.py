"""Folders of photos, copies in another size, photos without a pose, and several models of one capture."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from splatview.scene import InputError
from splatview.scene.captures import load_capture
from splatview.scene.captures.photos import are_copies


@pytest.mark.parametrize(
    ("photo", "posed"),
    [
        ((480, 270), (1920, 1080)),
        ((1920, 1080), (480, 270)),
        ((639, 425), (1278, 851)),
        ((640, 426), (1278, 851)),
        ((1237, 822), (4946, 3286)),
        ((1429, 673), (1542, 727)),
        ((13, 9), (100, 75)),  # 12.5 and 9.375 px, up and down
    ],
)
def test_copies(photo, posed):
    assert are_copies(photo, posed)
    assert are_copies(posed, photo)


@pytest.mark.parametrize(
    ("photo", "posed"),
    [
        ((1440, 1080), (1920, 1080)),  # cut off aside
        ((480, 300), (1920, 1080)),
        ((1920, 1080), (1915, 1077)),  # with its lens and without
        ((1920, 1080), (1741, 961)),
        ((1, 1), (1920, 1080)),
        ((1080, 1920), (480, 270)),
    ],
)
def test_no_copies(photo, posed):
    assert not are_copies(photo, posed)
    assert not are_copies(posed, photo)


def shrink(folder: Path, factor: float) -> None:
    for path in folder.iterdir():
        with Image.open(path) as image:
            smaller = image.resize((round(image.width * factor), round(image.height * factor)))
        smaller.save(path)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_cameras_fit_copies_in_another_size(tmp_path, colmap_capture, factor):
    """The lens stays as it is: it bends directions, not pixels."""
    cameras = colmap_capture(tmp_path, model=4, distortion=(0.3, 0.0, 0.0, 0.0))
    shrink(tmp_path / "images", factor)
    capture = load_capture(tmp_path)
    (warning,) = capture.warnings
    size = f"{round(40 * factor)}x{round(30 * factor)}"
    assert (
        f"9 photos are copies in another size of those that poses were found with (p00.png has {size}"
        in warning
    )
    for photo, camera in zip(capture.photos, cameras, strict=True):
        assert photo.image().shape == (30 * factor, 40 * factor, 3)
        assert photo.camera.fx == pytest.approx(factor * camera.fx)
        assert photo.camera.cy == pytest.approx(factor * camera.cy)
        assert photo.camera.lens is not None
        assert photo.camera.lens.parameters[0] == 0.3


def test_photos_that_are_no_copies_are_refused(tmp_path, colmap_capture, png, pixels_of):
    colmap_capture(tmp_path)
    png(tmp_path / "images" / "p04.png", pixels_of(4, 20, 20))
    with pytest.raises(InputError, match=r"p04.png: is 20x20 pixels, but its camera says 40x30"):
        load_capture(tmp_path)


@pytest.mark.parametrize("folder", ["images_2", "images_10"])
@pytest.mark.parametrize("from_transforms", [False, True])
def test_folders_of_smaller_copies(tmp_path, colmap_capture, to_opengl, from_transforms, folder):
    """Where the large photos have been left behind."""
    cameras = colmap_capture(tmp_path)
    if from_transforms:
        shutil.rmtree(tmp_path / "sparse")
        frames = [
            {"file_path": f"images/p{i:02}.png", "transform_matrix": to_opengl(camera)}
            for i, camera in enumerate(cameras)
        ]
        content = {"w": 40, "h": 30, "fl_x": cameras[0].fx, "frames": frames}
        (tmp_path / "transforms.json").write_text(json.dumps(content))
    shrink(tmp_path / "images", 0.5)
    (tmp_path / "images").rename(tmp_path / folder)
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 9
    assert {(photo.camera.width, photo.camera.height) for photo in capture.photos} == {(20, 15)}


@pytest.mark.parametrize("use", ["ignore", "cut-out"])
def test_masks_of_another_size_than_the_photos(tmp_path, colmap_capture, png, use):
    """Smaller and larger ones, black in their left halves."""
    colmap_capture(tmp_path)
    for i in range(9):
        width, height = (20, 15) if i % 2 else (80, 60)
        mask = np.where(np.arange(width) < width // 2, 0, 255).astype(np.uint8)
        png(tmp_path / "masks" / f"p{i:02}.png", np.broadcast_to(mask, (height, width)).copy())
    for photo in load_capture(tmp_path, masks=use).photos:
        pixels = photo.pixels()
        shown = pixels.mask if use == "ignore" else pixels.alpha
        assert shown is not None
        np.testing.assert_array_equal(shown.astype(bool), np.broadcast_to(np.arange(40) >= 20, (30, 40)))


def test_photos_without_a_pose_are_told(tmp_path, colmap_capture, png, pixels_of):
    colmap_capture(tmp_path)
    png(tmp_path / "images" / "q.png", pixels_of(1))
    png(tmp_path / "images" / "a.png", pixels_of(1))
    (tmp_path / "images" / "notes.txt").write_text("")
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 9
    assert capture.warnings == ("2 of 11 photos have no pose and are not used: a.png, q.png",)


def test_what_lies_in_the_capture_s_own_folder_need_not_be_photos(tmp_path, colmap_capture, png, pixels_of):
    colmap_capture(tmp_path)
    for path in list((tmp_path / "images").iterdir()):
        path.rename(tmp_path / path.name)
    png(tmp_path / "preview.png", pixels_of(1))
    assert load_capture(tmp_path).warnings == ()


def test_the_largest_model_is_trained_on(tmp_path, colmap_capture, cameras_of):
    """Reconstructions that fall apart leave several; that of most photos is not always the first."""
    names = [f"p{i:02}.png" for i in range(9)]
    colmap_capture(tmp_path / "small", cameras=cameras_of(3), names=names[:3], photos=False)
    colmap_capture(tmp_path, text=True)
    sparse = tmp_path / "sparse"
    (sparse / "0").rename(sparse / "2")
    (tmp_path / "small/sparse/0").rename(sparse / "0")
    (sparse / "10").mkdir()
    (sparse / "10" / "images.bin").write_bytes(b"\xff" * 100)
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 9
    (warning,) = capture.warnings
    assert warning == (
        f"{sparse / '2'} is trained on, with poses of 9 photos; there are others, which train when they are "
        f"named: {sparse / '0'} (3)"
    )
    capture = load_capture(sparse / "0")
    assert [photo.name for photo in capture.photos] == names[:3]
    assert capture.warnings == (
        "6 of 9 photos have no pose and are not used: p03.png, p04.png, p05.png, p06.png, p07.png, ...",
    )


def test_a_model_without_the_first_number(tmp_path, colmap_capture):
    colmap_capture(tmp_path)
    (tmp_path / "sparse/0").rename(tmp_path / "sparse/1")
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 9
    assert capture.warnings == ()


def test_a_larger_model_of_photos_as_they_were_taken(tmp_path, colmap_capture, cameras_of):
    """The 3DGS trainer takes the lens out of the photos of the first model, however few these are."""
    names = [f"p{i:02}.png" for i in range(9)]
    colmap_capture(tmp_path, cameras=cameras_of(3), names=names[:3])
    colmap_capture(tmp_path / "distorted", cameras=cameras_of(3), names=names[:3], photos=False)
    colmap_capture(tmp_path / "more", model=4, distortion=(0.1, 0.0, 0.0, 0.0))
    larger = tmp_path / "distorted/sparse/1"
    (tmp_path / "more/sparse/0").rename(larger)
    capture = load_capture(tmp_path)
    assert len(capture.photos) == 3
    (warning,) = capture.warnings
    assert warning.endswith(f"there are others, which train when they are named: {larger} (9)")
    (tmp_path / "images").rename(tmp_path / "undistorted")
    (tmp_path / "more/images").rename(tmp_path / "input")
    assert len(load_capture(larger).photos) == 9


@pytest.mark.parametrize("named", ["", "sparse/0"])
def test_photos_in_a_folder_of_another_name_are_told(tmp_path, colmap_capture, named):
    colmap_capture(tmp_path)
    (tmp_path / "images").rename(tmp_path / "my photos")
    with pytest.raises(InputError) as caught:
        load_capture(tmp_path / named)
    assert f"{tmp_path / 'my photos'} has one of that name: rename it to images" in str(caught.value)
