"""The arrays of a scene as the kernels take them, checked once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..scene import Gaussians, RenderSettings
from ..scene.gaussians import SH_COEFFICIENTS

MAX_SPLATS = 2**31 - 1
"""Splats are numbered with 32 bits."""


class Parameters(NamedTuple):
    """C-contiguous; means float32 or float64, the others all float32 or all float64. See `Gaussians`."""

    means: np.ndarray
    """(N, 3)"""
    quats: np.ndarray
    """(N, 4)"""
    log_scales: np.ndarray
    """(N, 3)"""
    opacity_logits: np.ndarray
    """(N,)"""
    sh: np.ndarray
    """(N, K, 3)"""


def check_parameters(means: Any, quats: Any, log_scales: Any, opacity_logits: Any, sh: Any) -> Parameters:
    """Checks shapes and dtypes; copies what is not contiguous. Values may be anything: kernels cull.

    Raises:
        ValueError: an argument is no array, or of the wrong shape or dtype; the message names it.
    """
    if not isinstance(means, np.ndarray) or means.ndim != 2:
        raise ValueError(f"means must be an array of shape (N, 3), got {describe(means)}")
    n = len(means)
    if n > MAX_SPLATS:
        raise ValueError(f"means must have at most {MAX_SPLATS} rows, got {n}")
    if not isinstance(sh, np.ndarray) or sh.ndim != 3 or sh.shape[1] not in SH_COEFFICIENTS:
        raise ValueError(
            f"sh must be an array of shape (N, K, 3), K in {SH_COEFFICIENTS}, got {describe(sh)}"
        )
    single = (np.dtype(np.float32), np.dtype(np.float64))
    return Parameters(
        means=_checked("means", means, (n, 3), single),
        quats=_checked("quats", quats, (n, 4), single),
        log_scales=_checked("log_scales", log_scales, (n, 3), (getattr(quats, "dtype", None),)),
        opacity_logits=_checked("opacity_logits", opacity_logits, (n,), (quats.dtype,)),
        sh=_checked("sh", sh, (n, sh.shape[1], 3), (quats.dtype,)),
    )


def parameters_of(gaussians: Gaussians) -> Parameters:
    """The arrays of a scene, which has checked them itself."""
    g = gaussians
    return check_parameters(g.means, g.quats, g.log_scales, g.opacity_logits, g.sh)


def used_degree(splats: Parameters, settings: RenderSettings) -> int:
    """The SH degree that is evaluated.

    Raises:
        ValueError: that of the settings is negative.
    """
    if settings.sh_degree is not None and not settings.sh_degree >= 0:
        raise ValueError(f"sh_degree must be at least 0, got {settings.sh_degree}")
    stored = SH_COEFFICIENTS.index(splats.sh.shape[1])
    return stored if settings.sh_degree is None else min(stored, settings.sh_degree)


def describe(value: Any) -> str:
    """What was given instead, for an error message."""
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__


def _checked(name: str, array: Any, shape: tuple[int, ...], dtypes: tuple[Any, ...]) -> np.ndarray:
    if not isinstance(array, np.ndarray) or array.shape != shape:
        raise ValueError(f"{name} must be an array of shape {shape}, got {describe(array)}")
    if array.dtype not in dtypes:
        wanted = " or ".join(str(dtype) for dtype in dtypes)
        raise ValueError(f"{name} must be {wanted}, got {array.dtype}")
    return np.require(array, requirements=("C", "ALIGNED"))
