"""How far a picture is from its photo, and which way is nearer: (1 - w)·L1 + w·(1 - SSIM), and opacity."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatview.measure.metrics import SSIM_K, SSIM_WINDOW, gaussian_window
from splatview.raster import Workspace, available_threads
from splatview.raster.compiling import TASKS_PER_THREAD, even_ranges, run
from splatview.trainer.loss_kernels import MAPS, gradient_rows, row_length, similarity_rows

SSIM_WEIGHT = 0.2
"""w (Kerbl et al. 2023, section 5.1).

Dropped, a minute at half the bench's size, a third held out: 0, `skull RGBA 100` 32.84 in place of 33.39
dB; an L1 that is square below 0.05, 33.36, and `banana` 28.80 and 28.39 in place of 28.76 and 28.87 (two
seeds); below 0.02, 33.41; with a square of ten times the weight added, 33.43. Twice the weight: `banana`
28.69 in place of 28.74, `miku` 30.37 and 30.34, `skull RGBA 100` 33.31 and 33.48.
"""

SMALLEST_TASK = 24
"""Rows that a task has at least: each begins by filtering 10 rows that its neighbour filters too."""


class PhotoLoss(NamedTuple):
    """The loss of one picture and its parts."""

    loss: float
    l1: float
    """Mean |difference| over pixels and colours."""
    ssim: float
    """Mean SSIM over the windows that lie inside the picture, as in `measure.metrics`."""
    d_image: np.ndarray
    """(H, W, 4), dL/d(picture) in its dtype, alpha's being 0 where no opacity is compared; lives in the
    workspace until the next loss."""


def photo_loss(
    image: np.ndarray,
    photo: np.ndarray,
    workspace: Workspace,
    *,
    mask: np.ndarray | None = None,
    alpha: np.ndarray | None = None,
    alpha_known: int = 255,
    ssim_weight: float = SSIM_WEIGHT,
    alpha_weight: float = 0.0,
    threads: int | None = None,
) -> PhotoLoss:
    """Compares a picture (H, W, 4), float32 or float64, to a photo (H, W, 3) uint8.

    mask (H, W) bool: pixels that are false count as equal, whatever they show. Values are not clipped,
    so that a picture too bright is pulled back. Equal for any number of threads (None: all cores).
    alpha (H, W) uint8: the photo's opacity; the mean difference of the picture's from it, `alpha_weight`
    times, is added to the loss, pixels whose opacity is above `alpha_known` counting as equal.

    Raises:
        ValueError: an array has the wrong shape or dtype, or SSIM is asked of pictures smaller than its
            window of 11x11.
    """
    height, width = image.shape[:2] if image.ndim == 3 else (0, 0)
    if image.shape != (height, width, 4) or image.dtype not in (np.float32, np.float64):
        raise ValueError(f"image must be float32 or float64 (H, W, 4), got {image.dtype} {image.shape}")
    if photo.shape != (height, width, 3) or photo.dtype != np.uint8:
        raise ValueError(f"photo must be uint8 {(height, width, 3)}, got {photo.dtype} {photo.shape}")
    if mask is None:
        mask = np.empty((0, 0), np.bool_)
    elif mask.shape != (height, width) or mask.dtype != np.bool_:
        raise ValueError(f"mask must be bool {(height, width)}, got {mask.dtype} {mask.shape}")
    if alpha is None or alpha_weight == 0:
        alpha = np.empty((0, 0), np.uint8)
    elif alpha.shape != (height, width) or alpha.dtype != np.uint8:
        raise ValueError(f"alpha must be uint8 {(height, width)}, got {alpha.dtype} {alpha.shape}")
    if not 0 <= alpha_weight < np.inf:
        raise ValueError(f"alpha_weight must be at least 0 and finite, got {alpha_weight}")
    if not 0 <= ssim_weight <= 1:
        raise ValueError(f"ssim_weight must be in [0, 1], got {ssim_weight}")
    if ssim_weight > 0 and not min(height, width) >= SSIM_WINDOW:
        raise ValueError(f"SSIM needs pictures of at least {SSIM_WINDOW}x{SSIM_WINDOW}, got {width}x{height}")
    threads = threads or available_threads()
    photo, mask, alpha = _read_only(np.ascontiguousarray(photo)), _read_only(mask), _read_only(alpha)
    number = image.dtype.type
    weights = gaussian_window().astype(number)
    rows, windows = height - SSIM_WINDOW + 1, width - SSIM_WINDOW + 1
    maps, ssim = np.empty((0, 0), number), 1.0
    if ssim_weight > 0:
        maps, ssim = _similarities(image, photo, mask, workspace, threads)
    d_image = workspace.take("d_image", image.shape, number)
    differences, alpha_differences = np.empty(height), np.zeros(height)
    l1_scale = number((1 - ssim_weight) / (3 * height * width))
    ssim_scale = number(-ssim_weight / (3 * rows * windows) if ssim_weight > 0 else 0)
    alpha_scale = number(alpha_weight / (height * width))
    run(
        gradient_rows,
        _tasks(height, threads),
        (
            *(image, photo, mask, alpha, alpha_known, weights, l1_scale, ssim_scale, alpha_scale),
            *(maps, d_image, differences, alpha_differences),
        ),
        threads,
    )
    l1 = float(differences.sum()) / (3 * height * width)
    by_alpha = alpha_weight * float(alpha_differences.sum()) / (height * width)
    return PhotoLoss((1 - ssim_weight) * l1 + ssim_weight * (1 - ssim) + by_alpha, l1, ssim, d_image)


def mean_ssim(
    picture: np.ndarray,
    photo: np.ndarray,
    workspace: Workspace,
    *,
    mask: np.ndarray | None = None,
    threads: int | None = None,
) -> float:
    """Mean SSIM of a picture (H, W, 3), clipped to 0..1, and a photo (H, W, 3) uint8, by the loss's kernel in
    float64 (in float32 a bright, flat photo is wrong by 2e-4): `measure.metrics.ssim`, which takes ten times
    as long. Pixels at which the mask (H, W) bool is false are grey in both."""
    image = workspace.take("compared", (*picture.shape[:2], 4), np.float64)
    np.clip(picture, 0, 1, out=image[..., :3])
    known = _read_only(np.empty((0, 0), np.bool_) if mask is None else mask)
    photo = _read_only(np.ascontiguousarray(photo))
    return _similarities(image, photo, known, workspace, threads or available_threads())[1]


def _similarities(
    image: np.ndarray, photo: np.ndarray, mask: np.ndarray, workspace: Workspace, threads: int
) -> tuple[np.ndarray, float]:
    """Derivatives of SSIM's windows, for `gradient_rows`, and its mean."""
    height, width = image.shape[:2]
    rows, windows = height - SSIM_WINDOW + 1, width - SSIM_WINDOW + 1
    maps = workspace.take("similarity_maps", (rows, MAPS * row_length(width)), image.dtype.type)
    similarities = np.empty(rows)
    c1, c2 = (k**2 for k in SSIM_K)
    weights = gaussian_window().astype(image.dtype)
    arguments = (image, photo, mask, weights, c1, c2, maps, similarities)
    run(similarity_rows, _tasks(rows, threads), arguments, threads)
    return maps, float(similarities.sum()) / (3 * rows * windows)


def _read_only(array: np.ndarray) -> np.ndarray:
    """A view that may not be written to: numba compiles a kernel anew for arrays that may."""
    view = array.view()
    view.flags.writeable = False
    return view


def _tasks(rows: int, threads: int) -> list[tuple[int, int]]:
    return even_ranges(rows, min(threads * TASKS_PER_THREAD, max(threads, rows // SMALLEST_TASK)))
