"""Arguments of the kernels: the arrays of a scene, checked once, and camera and image model as flat
numbers."""

from __future__ import annotations

import math
from typing import Any, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.effects.sh_bands import degree_in_use, own_degrees
from splatview.scene.gaussians import SH_COEFFICIENTS

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
    """The arrays of a scene."""
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
    """Dtype and shape of an array, the type of anything else: for error messages."""
    return f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__


def _checked(name: str, array: Any, shape: tuple[int, ...], dtypes: tuple[Any, ...]) -> np.ndarray:
    if not isinstance(array, np.ndarray) or array.shape != shape:
        raise ValueError(f"{name} must be an array of shape {shape}, got {describe(array)}")
    if array.dtype not in dtypes:
        expected = " or ".join(str(dtype) for dtype in dtypes)
        raise ValueError(f"{name} must be {expected}, got {array.dtype}")
    return np.require(array, requirements=("C", "ALIGNED"))


class NonzeroBands(NamedTuple):
    """The SH bands of a scene that are not all zero: the others need not be summed, which changes no bit of
    any picture.

    Reading only the beginning of a row costs nothing measurable, so no second layout is kept (projecting
    500,000 splats of degree 0: 8.6 ms, padded to degree 3: 8.7 ms, and 14.0 where zeros are summed).
    """

    in_use: int
    """Degree of the highest band that is not all zero."""
    own_degrees: np.ndarray | None
    """(N,) uint8: degree of each splat's highest band that is not all zero, where knowing it pays."""


_known: WeakKeyDictionary[Gaussians, NonzeroBands] = WeakKeyDictionary()


def nonzero_bands(gaussians: Gaussians) -> NonzeroBands:
    """The nonzero bands of a scene, found once, as its arrays never change."""
    if gaussians not in _known:
        _known[gaussians] = NonzeroBands(degree_in_use(gaussians.sh), own_degrees(gaussians.sh))
    return _known[gaussians]


TILE = 16
"""Side of a tile in pixels."""

HALF_LOG2_E = 0.5 * math.log2(math.e)
"""exp(-q/2) = 2^(-q·HALF_LOG2_E)."""

NO_SHARE = -1e30
"""A logarithm of 0 for kernels that take all numbers to be finite."""


class View(NamedTuple):
    """Camera and image model, see `scene.image_model`; float64, lengths in px or world units."""

    rotation: np.ndarray
    """(3, 3) float64, world axes to camera axes."""
    eye: np.ndarray
    """(3,) float64, world."""
    fx: float
    fy: float
    cx: float
    cy: float
    min_u: float
    """Lower clamp of t.x/t.z in the Jacobian; -inf: none."""
    max_u: float
    min_v: float
    max_v: float
    width: int
    height: int
    near: float
    blur: float
    antialiased: bool
    alpha_cut: float
    """Alpha below which a splat is not drawn, as in the model; may be 0."""
    log2_cut: float
    """log2 of the cut that the kernels use: never below the smallest normal power of two."""
    log2_share: float
    """log2 of the share of its opacity below which a splat's alpha is 0; NO_SHARE where there is none."""
    max_alpha: float
    tiles_x: int
    tiles_y: int


def make_view(camera: Camera, settings: RenderSettings, dtype: np.dtype) -> View:
    """`dtype` is that of the pictures; it decides what a cut of 0 means (the smallest normal number)."""
    model = settings.model
    min_u, min_v, max_u, max_v = camera.slope_limits(model.jacobian_margin)
    smallest = float(np.finfo(dtype).minexp)
    return View(
        rotation=np.ascontiguousarray(camera.R_camera_world),
        eye=np.ascontiguousarray(camera.eye),
        fx=float(camera.fx),
        fy=float(camera.fy),
        cx=float(camera.cx),
        cy=float(camera.cy),
        min_u=min_u,
        max_u=max_u,
        min_v=min_v,
        max_v=max_v,
        width=int(camera.width),
        height=int(camera.height),
        near=float(model.near),
        blur=float(model.blur),
        antialiased=bool(model.antialiased),
        alpha_cut=float(model.alpha_cut),
        log2_cut=max(math.log2(model.alpha_cut), smallest) if model.alpha_cut > 0 else smallest,
        log2_share=NO_SHARE if settings.sigma_cut is None else -HALF_LOG2_E * settings.sigma_cut**2,
        max_alpha=float(model.max_alpha),
        tiles_x=-(-camera.width // TILE),
        tiles_y=-(-camera.height // TILE),
    )
