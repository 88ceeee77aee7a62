"""Undistortion and averaging against what they are by definition."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import ExifTags, Image

from splatview.scene import Camera, Lens
from splatview.scene.captures.capture import PosedPhoto
from splatview.scene.captures.photos import read_pixels
from splatview.scene.captures.resample import area_averaged, undistorted, wholly_valid
from splatview.scene.lens import distort, undistort


def lens(width: int, height: int, k: float, model: str = "SIMPLE_RADIAL") -> Camera:
    return Camera(
        lens=Lens(model=model, parameters=(k,)),
        world_to_camera=np.eye(4),
        width=width,
        height=height,
        fx=0.9 * width,
        fy=0.9 * width,
        cx=width / 2 + 1,
        cy=height / 2 - 2,
    )


def by_area(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Exactly, with fractions for the parts of pixels."""

    def weights(size: int, count: int) -> np.ndarray:
        step = Fraction(size, count)
        return np.array(
            [
                [
                    float(max(Fraction(0), min(j + 1, (i + 1) * step) - max(j, i * step)) / step)
                    for j in range(size)
                ]
                for i in range(count)
            ]
        )

    return np.einsum(
        "ih,jw,hwc->ijc", weights(image.shape[0], height), weights(image.shape[1], width), image.astype(float)
    )


@settings(max_examples=60, deadline=None)
@given(
    width=st.integers(1, 23), height=st.integers(1, 23), divide=st.integers(1, 23), seed=st.integers(0, 2**31)
)
def test_averages_are_those_of_the_area(width, height, divide, seed):
    image = np.random.default_rng(seed).integers(0, 256, size=(height, width, 3), dtype=np.uint8)
    small = max(1, width // divide), max(1, height // divide)
    result = area_averaged(image, *small)
    assert result.shape == (small[1], small[0], 3)
    assert np.abs(result - by_area(image, *small)).max() <= 0.5 + 1e-3


@pytest.mark.parametrize("factor", [2, 3, 5, 16, 300])
def test_averages_by_whole_factors_are_exact(factor, rng):
    """Rounded to the nearest level, halves up, as they are by areas; 300 white rows are beyond 16 bits."""
    image = rng.integers(0, 256, size=(2 * factor, 3 * factor, 3), dtype=np.uint8)
    image[:factor, :factor] = 255
    sums = image.reshape(2, factor, 3, factor, 3).sum(axis=(1, 3), dtype=np.int64)
    expected = (2 * sums + factor**2) // (2 * factor**2)
    for channels in (1, 3):
        found = area_averaged(np.ascontiguousarray(image[..., :channels]), 3, 2)
        np.testing.assert_array_equal(found, expected[..., :channels])
        beyond = area_averaged(image[..., :channels], 3, 2, (3 * factor - 1e-9, 2 * factor - 1e-9))
        assert np.abs(found.astype(int) - beyond).max() <= 1


def test_a_pixel_counts_only_where_all_of_it_is_valid():
    mask = np.ones((8, 8), dtype=bool)
    mask[3, 5] = False
    small = wholly_valid(mask, 4, 4)
    assert not small[1, 2]
    assert small.sum() == 15
    assert wholly_valid(mask, 8, 8) is mask


@pytest.mark.parametrize(("model", "k"), [("SIMPLE_RADIAL", -0.2), ("SIMPLE_RADIAL", 0.2), ("FOV", 0.9)])
def test_undistorted_shows_what_a_pinhole_would(model, k):
    """A smooth picture of the rays themselves is taken through the lens and back."""
    width, height = 120, 90
    a_lens = lens(width, height, k, model)
    assert a_lens.lens is not None
    ys, xs = np.mgrid[:height, :width] + 0.5
    pinhole = np.stack([(xs - a_lens.cx) / a_lens.fx, (ys - a_lens.cy) / a_lens.fy], axis=-1)

    def scene(rays: np.ndarray) -> np.ndarray:
        return np.stack([128 + 90 * np.sin(4 * rays[..., 0]), 128 + 90 * np.cos(5 * rays[..., 1])], axis=-1)

    rays = undistort(pinhole, a_lens.lens)
    photo = np.nan_to_num(scene(rays), nan=0).round().astype(np.uint8)
    result, valid = undistorted(photo, a_lens)
    there = distort(pinhole, a_lens.lens) * (a_lens.fx, a_lens.fy) + (a_lens.cx, a_lens.cy)
    expected = ((there >= 0.5) & (there <= np.array([width, height]) - 0.5)).all(axis=-1)
    np.testing.assert_array_equal(valid, expected)
    assert valid.mean() > 0.7
    assert np.abs(result - scene(pinhole))[valid].max() < 1.5
    assert not result[~valid].any()


def test_nothing_is_shown_twice_beyond_the_fold():
    a_lens = lens(200, 100, -0.9)
    _, valid = undistorted(np.full((100, 200, 3), 200, np.uint8), a_lens)
    radius = np.hypot(*(np.mgrid[:100, :200][::-1] + 0.5 - np.array([101, 48])[:, None, None])) / a_lens.fx
    assert not valid[radius > np.sqrt(1 / 2.7) + 0.01].any()
    assert valid[radius < 0.4][::7].all()


@pytest.mark.parametrize("orientation", [1, 6])
@pytest.mark.parametrize(("width", "height"), [(808, 608), (805, 603)])
def test_large_jpegs_decoded_smaller_are_nearly_the_average_of_all(tmp_path, width, height, orientation):
    """Waves of 12 to 40 px, 57 and, across the blocks of the file, 43 dB; 29 where the last pixels, which
    reach beyond the photo, count as whole ones, and 30 where the decoder makes it smaller by 4."""
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    waves = [
        128 + 80 * np.sin(2 * np.pi * (x * a + y * b))
        for a, b in ((1 / 12, 0), (1 / 40, 1 / 23), (0, 1 / 16))
    ]
    image = Image.fromarray(np.stack(waves, axis=-1).astype(np.uint8))
    exif = Image.Exif()
    exif[ExifTags.Base.Orientation] = orientation
    path = tmp_path / "photo.jpg"
    image.save(path, quality=95, subsampling=0, exif=exif)
    camera = Camera(
        world_to_camera=np.eye(4), width=width, height=height, fx=700, fy=700, cx=width / 2, cy=height / 2
    )
    entry = PosedPhoto(name="photo.jpg", path=path, camera=camera)
    small = read_pixels(entry, 8, (0.0, 0.0, 0.0), "through").image
    whole = area_averaged(np.array(Image.open(path).convert("RGB")), width // 8, height // 8)
    assert small.shape == (height // 8, width // 8, 3)
    inner = (small.astype(float) - whole)[1:-1, 1:-1]
    assert psnr_of(inner) >= 42 and abs(inner.mean()) < 0.5


def psnr_of(difference: np.ndarray) -> float:
    """dB of a difference in levels of 255."""
    return float(10 * np.log10(255**2 / max(np.mean(difference**2), 1e-12)))
