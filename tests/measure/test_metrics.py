"""The metrics against definitions written out pixel by pixel."""

from __future__ import annotations

import math

import numpy as np
import pytest

from splatview.measure.metrics import largest_error, psnr, ssim


@pytest.fixture
def pair(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Two related pictures with an alpha channel and values outside [0, 1]."""
    reference = rng.uniform(-0.2, 1.2, size=(19, 23, 4))
    return reference + rng.normal(scale=0.1, size=reference.shape), reference


def slow_ssim(x: np.ndarray, y: np.ndarray) -> float:
    """Wang et al. 2004, eq. 13, window by window, with a 2D window and central moments."""
    offsets = np.arange(-5, 6)
    window = np.exp(-(offsets[:, None] ** 2 + offsets[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()
    values = []
    for channel in range(3):
        for top in range(x.shape[0] - 10):
            for left in range(x.shape[1] - 10):
                a = np.clip(x[top : top + 11, left : left + 11, channel], 0, 1)
                b = np.clip(y[top : top + 11, left : left + 11, channel], 0, 1)
                mean_a, mean_b = (window * a).sum(), (window * b).sum()
                var_a, var_b = (window * (a - mean_a) ** 2).sum(), (window * (b - mean_b) ** 2).sum()
                cov = (window * (a - mean_a) * (b - mean_b)).sum()
                luminance = (2 * mean_a * mean_b + 1e-4) / (mean_a**2 + mean_b**2 + 1e-4)
                values.append(luminance * (2 * cov + 9e-4) / (var_a + var_b + 9e-4))
    return float(np.mean(values))


def test_ssim_is_the_definition(pair):
    image, reference = pair
    assert ssim(image, reference) == pytest.approx(slow_ssim(image, reference), abs=1e-12)
    assert ssim(reference, image) == pytest.approx(ssim(image, reference), abs=1e-12)


def test_ssim_of_equal_and_of_opposite_pictures(pair):
    _, reference = pair
    assert ssim(reference, reference) == pytest.approx(1, abs=1e-12)
    assert ssim(1 - reference, reference) < 0


def test_ssim_of_flat_pictures_is_the_luminance_term():
    black, grey = np.zeros((11, 11, 3)), np.full((11, 11, 3), 0.5)
    assert ssim(black, grey) == pytest.approx(1e-4 / (0.25 + 1e-4))


def test_psnr_is_the_definition(pair):
    image, reference = pair
    squares = [
        (min(max(a, 0), 1) - min(max(b, 0), 1)) ** 2
        for a, b in zip(image[..., :3].flat, reference[..., :3].flat, strict=True)
    ]
    assert psnr(image, reference) == pytest.approx(10 * math.log10(1 / np.mean(squares)))


def test_psnr_known_values():
    zero = np.zeros((2, 3, 3), dtype=np.float32)
    assert psnr(zero + np.float32(0.1), zero) == pytest.approx(20, abs=1e-5)
    assert psnr(zero, zero) == math.inf
    assert psnr(zero - 5, zero) == math.inf, "black is black"


def test_alpha_is_not_compared(pair):
    image, reference = pair
    other = image.copy()
    other[..., 3] = 7
    for metric in (psnr, ssim, largest_error):
        assert metric(other, reference) == metric(image, reference) == metric(image[..., :3], reference)


def test_largest_error_finds_the_one_wrong_value():
    reference = np.full((5, 7, 3), 0.25, dtype=np.float32)
    image = reference.copy()
    image[4, 6, 2] = 0.75
    assert largest_error(image, reference) == 0.5
    assert largest_error(reference, image) == 0.5


@pytest.mark.parametrize("metric", [psnr, ssim, largest_error])
def test_nan_passes_no_bound(metric, pair):
    image, reference = pair
    image[9, 9, 1] = np.nan
    assert math.isnan(metric(image, reference))


@pytest.mark.parametrize("metric", [psnr, ssim, largest_error])
def test_what_is_no_pair_of_pictures_is_refused(metric):
    picture = np.zeros((12, 13, 3))
    with pytest.raises(ValueError, match="13x12 and 12x12"):
        metric(picture, picture[:, 1:])
    with pytest.raises(ValueError, match=r"\(12, 13\)"):
        metric(picture[..., 0], picture[..., 0])
    with pytest.raises(ValueError, match="uint8"):
        metric(picture.astype(np.uint8), picture)
    with pytest.raises(ValueError, match="not empty"):
        metric(picture[:0], picture[:0])


def test_ssim_says_when_a_picture_is_too_small():
    with pytest.raises(ValueError, match="at least 11x11, got 10x30"):
        ssim(np.zeros((30, 10, 3)), np.zeros((30, 10, 3)))
