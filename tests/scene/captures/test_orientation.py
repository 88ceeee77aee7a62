"""Photos lie as they are stored, for poses were found on that; EXIF counts where only the turned one fits."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from splatview.scene.captures import load_capture

UPRIGHT = {
    2: lambda stored: stored[:, ::-1],
    3: lambda stored: stored[::-1, ::-1],
    4: lambda stored: stored[::-1],
    5: lambda stored: stored.transpose(1, 0, 2),
    6: lambda stored: np.rot90(stored, -1),
    7: lambda stored: np.rot90(stored.transpose(1, 0, 2), 2),
    8: lambda stored: np.rot90(stored, 1),
}
"""By EXIF's number: what is shown of what is stored. 6: held so that the sensor's left side was on top."""


def save_with_orientation(path, pixels, orientation):
    image = Image.fromarray(pixels)
    exif = Image.Exif()
    exif[0x0112] = orientation
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save(path, exif=exif)


@pytest.fixture
def turned(tmp_path, colmap_capture, cameras_of, pixels_of):
    """`turned(suffix, orientation)`: a photo as read for a camera of 40x30, and as it is stored."""

    def make(suffix, orientation, size=(40, 30)):
        names = [f"p{i}.{suffix}" for i in range(3)]
        colmap_capture(tmp_path, cameras=cameras_of(3), names=names)
        stored = pixels_of(7, *size)
        save_with_orientation(tmp_path / "images" / names[1], stored, orientation)
        return load_capture(tmp_path).photos[1].image(), stored

    return make


@pytest.mark.parametrize("suffix", ["png", "tiff"])
@pytest.mark.parametrize("orientation", [0, 1, 2, 3, 4, 5, 6, 7, 8, 9])
def test_photos_are_taken_as_stored(turned, suffix, orientation):
    image, stored = turned(suffix, orientation)
    np.testing.assert_array_equal(image, stored)


@pytest.mark.parametrize("suffix", ["png", "tiff"])
@pytest.mark.parametrize("orientation", [5, 6, 7, 8])
def test_photos_are_turned_where_only_that_fits_their_camera(turned, suffix, orientation):
    image, stored = turned(suffix, orientation, size=(30, 40))
    np.testing.assert_array_equal(image, UPRIGHT[orientation](stored))


def test_our_table_is_exifs(tmp_path, pixels_of):
    """Pillow's own reading agrees with the table that the tests compare with."""
    from PIL import ImageOps

    for orientation, upright in UPRIGHT.items():
        path = tmp_path / f"{orientation}.png"
        save_with_orientation(path, pixels_of(1, 5, 4), orientation)
        with Image.open(path) as image:
            shown = np.asarray(ImageOps.exif_transpose(image))
        np.testing.assert_array_equal(shown, upright(pixels_of(1, 5, 4)))


def test_jpegs_too(turned):
    image, stored = turned("jpg", 6)
    assert image.shape == (30, 40, 3)
    # Noise of every pixel is what JPEG keeps worst; turned by 180° nothing would remain of it.
    assert np.corrcoef(image.ravel(), stored.ravel())[0, 1] > 0.5


@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_sizes_that_the_capture_does_not_give_are_the_stored_ones(
    tmp_path, cameras_of, to_opengl, transforms, pixels_of, suffix
):
    frames = []
    for i, camera in enumerate(cameras_of(3)):
        save_with_orientation(tmp_path / f"{i}.{suffix}", pixels_of(i), 6)
        frames.append({"file_path": f"{i}.{suffix}", "transform_matrix": to_opengl(camera)})
    transforms(tmp_path / "transforms.json", frames, camera_angle_x=0.8)
    photo = load_capture(tmp_path).photos[1]
    assert (photo.camera.width, photo.camera.height) == (40, 30)
    np.testing.assert_array_equal(photo.image(), pixels_of(1))


@pytest.mark.filterwarnings("ignore:Corrupt EXIF")
def test_damaged_exif_leaves_the_photo(tmp_path, colmap_capture, cameras_of, pixels_of):
    names = [f"p{i}.jpg" for i in range(3)]
    colmap_capture(tmp_path, cameras=cameras_of(3), names=names)
    path = tmp_path / "images/p1.jpg"
    Image.fromarray(pixels_of(1)).save(path, exif=b"Exif\0\0MM\0*\0\0\0\x08\xff\xff\x01\x12")
    assert load_capture(tmp_path).photos[1].image().shape == (30, 40, 3)


def test_masks_lie_like_their_photos(tmp_path, colmap_capture, cameras_of):
    colmap_capture(tmp_path, cameras=cameras_of(3))
    mask = np.zeros((30, 40, 3), np.uint8)
    mask[:10] = 255
    save_with_orientation(tmp_path / "masks/p01.png", mask, 3)
    read = load_capture(tmp_path).photos[1].mask()
    assert read is not None
    np.testing.assert_array_equal(read, mask[..., 0] > 0)
