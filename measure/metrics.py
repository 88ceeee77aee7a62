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


# ---- Maps of where two pictures differ: the signed difference, and how strongly an eye would notice it.
#
# The perceptual map follows the idea of FLIP (Andersson et al. 2020): what the eye cannot resolve is blurred
# away first, then colours are compared in a space that is uniform to the eye. Here, with pictures taken as
# sRGB and shown at `pixels_per_degree`:
#
#     1. linear light, then opponent channels: Y = luminance, R - Y, B - Y;
#     2. each blurred by a Gaussian: Y with sigma = LUMINANCE_BLUR degrees, the colours with CHROMA_BLUR;
#     3. back to linear RGB, clipped to what a screen can show, then CIELAB (white: D65);
#     4. d = |dL*| + sqrt(da*² + db*²), the HyAB distance, which holds for large differences too;
#     5. E = (d / D)^EXPONENT, D being the distance of pure blue and pure green: the farthest that a screen
# has.
#
# E is 0 where nothing is to be seen and 1 where nothing could differ more.


PIXELS_PER_DEGREE = 67.0
"""A 0.7 m wide 3840 px screen seen from 0.7 m, FLIP's own default."""

LUMINANCE_BLUR, CHROMA_BLUR = 0.0125, 0.035
"""Degrees: Gaussians whose passbands end about where the eye's do, some 30 and 11 cycles a degree."""

EXPONENT = 0.7
"""Spreads small differences over more of the scale, as FLIP does."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Of linear sRGB (ITU-R BT.709)."""

XYZ = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
"""Linear sRGB to CIE XYZ, white D65 (IEC 61966-2-1)."""


def signed_map(image: np.ndarray, truth: np.ndarray, *, gain: float = 1.0) -> np.ndarray:
    """Grey where two pictures (H, W, 3 or 4) agree, brighter by half of `gain` times the difference where
    `image` is: (H, W, 3) float64 in [0, 1].

    Raises:
        ValueError: the arrays are not pictures of one size.
    """
    x, y = _pair(image, truth)
    return np.clip(0.5 + 0.5 * gain * (x - y), 0, 1)


def perceptual_map(
    image: np.ndarray, truth: np.ndarray, *, pixels_per_degree: float = PIXELS_PER_DEGREE
) -> np.ndarray:
    """E of the module's formula for every pixel of two pictures (H, W, 3 or 4): (H, W) float64 in [0, 1].

    Raises:
        ValueError: the arrays are not pictures of one size.
    """
    x, y = (perceived(picture, pixels_per_degree) for picture in _pair(image, truth))
    return np.minimum(hyab(x, y) / FARTHEST, 1) ** EXPONENT


def perceived(rgb: np.ndarray, pixels_per_degree: float) -> np.ndarray:
    """CIELAB of what an eye resolves of sRGB (H, W, 3) in [0, 1]: steps 1 to 3."""
    light = linear(rgb)
    luminance = light @ LUMINANCE
    sharp = blurred(luminance, LUMINANCE_BLUR * pixels_per_degree)
    red, blue = (
        blurred(light[..., channel] - luminance, CHROMA_BLUR * pixels_per_degree) + sharp
        for channel in (0, 2)
    )
    green = (sharp - LUMINANCE[0] * red - LUMINANCE[2] * blue) / LUMINANCE[1]
    return lab(np.clip(np.stack([red, green, blue], axis=-1), 0, 1))


def linear(rgb: np.ndarray) -> np.ndarray:
    """sRGB in [0, 1] -> linear light."""
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def lab(light: np.ndarray) -> np.ndarray:
    """Linear sRGB (..., 3) -> CIELAB, L* from 0 to 100."""
    white = XYZ.sum(axis=1)
    ratio = light @ XYZ.T / white
    knee = 6 / 29
    f = np.where(ratio > knee**3, np.cbrt(ratio), ratio / (3 * knee**2) + 4 / 29)
    return np.stack(
        [116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1
    )


def hyab(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Distance of colours (..., 3) in CIELAB."""
    apart = x - y
    return np.abs(apart[..., 0]) + np.hypot(apart[..., 1], apart[..., 2])


FARTHEST = float(hyab(lab(np.array([0.0, 0, 1])), lab(np.array([0.0, 1, 0]))))


def blurred(values: np.ndarray, sigma: float) -> np.ndarray:
    """(H, W) under a Gaussian of `sigma` px; the border's pixels go on outwards."""
    reach = int(np.ceil(3 * sigma))
    if reach < 1:
        return values
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-(offsets**2) / (2 * sigma**2))
    weights /= weights.sum()
    for axis in (0, 1):
        edges = [(0, 0), (0, 0)]
        edges[axis] = (reach, reach)
        padded = np.pad(values, edges, mode="edge")
        length = values.shape[axis]
        values = sum(
            (
                weight * np.take(padded, range(start, start + length), axis=axis)
                for start, weight in enumerate(weights)
            ),
            np.zeros_like(values),
        )
    return values


def heat(values: np.ndarray) -> np.ndarray:
    """[0, 1] (H, W) -> colours (H, W, 3) from black over violet and orange to pale yellow; NaN is white."""
    place = np.clip(values, 0, 1)[..., None]
    colours = np.concatenate(
        [np.interp(place, HEAT_PLACES, [stop[channel] for stop in HEAT_COLOURS]) for channel in range(3)],
        axis=-1,
    )
    return np.where(np.isfinite(values)[..., None], colours, 1.0)


HEAT_PLACES = (0.0, 0.25, 0.5, 0.75, 1.0)
HEAT_COLOURS = ((0, 0, 0.02), (0.33, 0.06, 0.43), (0.73, 0.21, 0.33), (0.98, 0.55, 0.04), (0.99, 1.0, 0.64))
"""Ever brighter, so that it reads in print and to the colour-blind."""


def _pair(image: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y = shown(image), shown(truth)
    if x.shape != y.shape:
        raise ValueError(f"pictures differ in size: {x.shape[1]}x{x.shape[0]} and {y.shape[1]}x{y.shape[0]}")
    return x, y


# ---- Pictures drawn small and shown large.


def enlarged(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """`image` (h, w, C) float on (height, width, C) pixels of the same area, bilinear, same dtype.

    What a GPU's linear filter does: pixel centres at halves, the border's pixels continued outwards.
    """
    for axis, size in ((0, height), (1, width)):
        old = image.shape[axis]
        if old == size:
            continue
        place = np.clip((np.arange(size) + 0.5) * (old / size) - 0.5, 0, old - 1)
        before = np.floor(place).astype(np.intp)
        shape = [1, 1, 1]
        shape[axis] = size
        share = (place - before).astype(image.dtype).reshape(shape)
        left = np.take(image, before, axis=axis)
        right = np.take(image, np.minimum(before + 1, old - 1), axis=axis)
        image = left + (right - left) * share
    return image


def reduced_size(width: int, height: int, share: float) -> tuple[int, int]:
    """Pixels of a picture on `share` of the sides, at least 1x1."""
    return max(1, round(width * share)), max(1, round(height * share))
