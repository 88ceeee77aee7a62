"""When transparency says that nothing is there, and when only that nobody has seen what is."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene import InputError
from splatview.scene.captures import load_capture

from .conftest import HEIGHT, WIDTH, picture

RIM = np.pad(np.full((HEIGHT - 6, WIDTH - 6), 255, np.uint8), 3)


@pytest.fixture
def capture_with(tmp_path, colmap_capture, png):
    """Nine photos, of these opacities (H, W) by number; opaque where there is none."""

    def make(alphas, **how):
        colmap_capture(tmp_path)
        for number, alpha in alphas.items():
            rgba = np.concatenate([picture(number), alpha[..., None]], axis=2)
            png(tmp_path / "images" / f"p{number:02d}.png", rgba)
        return load_capture(tmp_path, **how)

    return make


def blob(number):
    """Of an object from one side, as a silhouette."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.where((x - 12 - 2 * number) ** 2 + (y - 15) ** 2 < 80, 255, 0).astype(np.uint8)


def test_an_object_is_before_nothing(capture_with):
    capture = capture_with({i: blob(i) for i in range(9)})
    assert capture.background is not None and capture.statistics.transparent == 9
    assert not capture.warnings and capture.photos[0].pixels().alpha is not None


def test_an_object_that_looks_alike_from_all_sides_is_one(capture_with):
    capture = capture_with(dict.fromkeys(range(9), blob(4)))
    assert capture.background is not None and capture.statistics.transparent == 9


def test_close_views_of_an_object_may_show_nothing_else(capture_with):
    capture = capture_with({i: blob(i) for i in range(5)})
    assert capture.background is not None and capture.statistics.transparent == 5


def beside(number):
    """Of an object that fills a photo but for a corner, another one in every photo."""
    alpha = np.full((HEIGHT, WIDTH), 255, np.uint8)
    rows = slice(0, 3) if number % 2 else slice(HEIGHT - 3, HEIGHT)
    alpha[rows, 4 * number : 4 * number + 4] = 0
    return alpha


def test_photos_that_an_object_fills_are_before_nothing(capture_with):
    assert np.mean([beside(i) for i in range(9)]) > 0.97 * 255
    capture = capture_with({i: beside(i) for i in range(9)})
    assert capture.background is not None and capture.statistics.transparent == 9
    assert not capture.warnings


@pytest.mark.parametrize("downscale", [1, 2])
def test_a_rim_is_unknown(capture_with, downscale):
    capture = capture_with(dict.fromkeys(range(9), RIM), downscale=downscale)
    assert capture.background is None and capture.statistics.transparent == 0
    assert "9 photos are transparent, which does not count as empty, for all are so in the same place" in (
        "\n".join(capture.warnings)
    )
    pixels = capture.photos[2].pixels()
    assert pixels.alpha is None and pixels.mask is not None
    expected = RIM.reshape(HEIGHT // downscale, downscale, WIDTH // downscale, downscale).min(axis=(1, 3)) > 0
    np.testing.assert_array_equal(pixels.mask, expected)
    assert capture.statistics.hidden == pytest.approx(1 - expected.mean())


def test_a_few_transparent_photos_are_unknown_there(capture_with):
    capture = capture_with({3: blob(3), 5: np.zeros_like(RIM)})
    assert capture.background is None and len(capture.photos) == 8
    lines = "\n".join(capture.warnings)
    assert "2 photos are transparent, which does not count as empty, for most photos show something" in lines
    assert "1 of these show nothing and are left out: p05.png" in lines
    with_mask = [photo.name for photo in capture.photos if photo.mask() is not None]
    assert with_mask == ["p03.png"]


def test_all_but_opaque_photos_are_opaque(capture_with):
    """As some programs write them, for a rounding."""
    capture = capture_with(dict.fromkeys(range(9), np.full_like(RIM, 254)))
    assert capture.background is None and not capture.warnings
    assert all(photo.pixels().alpha is None and photo.mask() is None for photo in capture.photos)


def test_who_asks_for_cut_outs_has_them(capture_with):
    capture = capture_with(dict.fromkeys(range(9), RIM), masks="cut-out")
    assert capture.background is not None and capture.statistics.transparent == 9


def test_nothing_to_train_on_is_said(capture_with):
    with pytest.raises(InputError, match="nothing of the photos"):
        capture_with(dict.fromkeys(range(9), np.full_like(RIM, 200)))
