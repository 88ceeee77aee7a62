"""How far one picture is from another: PSNR, SSIM, largest error.

All three look at what is shown: RGB clipped to [0, 1]; a fourth channel is not read. A NaN in either
picture makes the result NaN, so that no bound (`error <= x`, `psnr >= y`) passes by accident.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

SSIM_WINDOW = 11
"""Side of the Gaussian window in px (Wang et al. 2004)."""

SSIM_SIGMA = 1.5
"""Its standard deviation in px (ibid.)."""

SSIM_K = (0.01, 0.03)
"""K1, K2: C = (K · data range)² keeps the ratios finite where a patch is flat (ibid.)."""


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    """Peak signal to noise ratio in dB of two pictures (H, W, 3 or 4), float; inf where they are equal.

    10·log10(1 / mean squared error) over all pixels and RGB, data range 1. Of several pictures, average
    the values of the pictures.

    Raises:
        ValueError: the arrays are not pictures of one size.
    """
    x, y = shown(image), shown(reference)
    _check_same_size(x, y)
    error = float(np.mean((x - y) ** 2))
    return math.inf if error == 0 else -10 * math.log10(error)


def ssim(image: np.ndarray, reference: np.ndarray) -> float:
    """Mean structural similarity of two pictures (H, W, 3 or 4), float, each side at least 11 px.

    Gaussian 11x11 window, sigma 1.5, K = (0.01, 0.03), data range 1, only where the window lies inside
    the picture; mean over pixels and RGB (Wang et al. 2004, eq. 13).

    Raises:
        ValueError: the arrays are not pictures of one size, or smaller than the window.
    """
    x, y = shown(image), shown(reference)
    _check_same_size(x, y)
    if min(x.shape[:2]) < SSIM_WINDOW:
        raise ValueError(
            f"SSIM needs pictures of at least {SSIM_WINDOW}x{SSIM_WINDOW}, got {x.shape[1]}x{x.shape[0]}"
        )
    c1, c2 = (k**2 for k in SSIM_K)
    mean_x, mean_y = window_mean(x), window_mean(y)
    variance_x = window_mean(x * x) - mean_x**2
    variance_y = window_mean(y * y) - mean_y**2
    covariance = window_mean(x * y) - mean_x * mean_y
    similarity = ((2 * mean_x * mean_y + c1) * (2 * covariance + c2)) / (
        (mean_x**2 + mean_y**2 + c1) * (variance_x + variance_y + c2)
    )
    return float(similarity.mean())


def largest_error(image: np.ndarray, reference: np.ndarray) -> float:
    """The largest |difference| of any pixel and colour of two pictures (H, W, 3 or 4), float.

    Raises:
        ValueError: the arrays are not pictures of one size.
    """
    x, y = shown(image), shown(reference)
    _check_same_size(x, y)
    return float(np.abs(x - y).max())


def shown(image: np.ndarray) -> np.ndarray:
    """What the eye gets of a picture (H, W, 3 or 4): RGB clipped to [0, 1], float64 (H, W, 3).

    Raises:
        ValueError: another shape, an empty picture, or integers (whose range nobody could guess).
    """
    if image.ndim != 3 or image.shape[2] not in (3, 4) or image.size == 0:
        raise ValueError(f"a picture must be (height, width, 3 or 4) and not empty, got {image.shape}")
    if not np.issubdtype(image.dtype, np.floating):
        raise ValueError(f"a picture must hold floats in [0, 1], got {image.dtype}")
    return np.clip(image[..., :3].astype(np.float64), 0, 1)


def gaussian_window() -> np.ndarray:
    """The window's profile (11,), sum 1; the 11x11 window is its outer product."""
    offsets = np.arange(SSIM_WINDOW) - SSIM_WINDOW // 2
    weights = np.exp(-(offsets**2) / (2 * SSIM_SIGMA**2))
    return weights / weights.sum()


def window_mean(values: np.ndarray) -> np.ndarray:
    """Gaussian-weighted means (H, W, C) -> (H - 10, W - 10, C): along columns, then along rows."""
    weights = gaussian_window()
    columns = sliding_window_view(values, SSIM_WINDOW, axis=0) @ weights
    return sliding_window_view(columns, SSIM_WINDOW, axis=1) @ weights


def _check_same_size(x: np.ndarray, y: np.ndarray) -> None:
    if x.shape != y.shape:
        raise ValueError(f"pictures differ in size: {x.shape[1]}x{x.shape[0]} and {y.shape[1]}x{y.shape[0]}")
