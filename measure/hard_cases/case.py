"""What a hard case is, and the small tools that cases are built with."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, concatenate
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.sh import SH_C0

WIDTH, HEIGHT = 40, 30
"""px of most pictures: several tiles of 16, the last ones cut short."""

PLAIN = RenderSettings(background=(0.1, 0.2, 0.3))
ANTIALIASED = RenderSettings(background=(0.1, 0.2, 0.3), model=ImageModel(antialiased=True))

BOTH: Mapping[str, RenderSettings] = MappingProxyType({"plain": PLAIN, "antialiased": ANTIALIASED})
ONLY_PLAIN: Mapping[str, RenderSettings] = MappingProxyType({"plain": PLAIN})


@dataclass(frozen=True, kw_only=True)
class Same:
    """Another scene, with cameras one by one, whose pictures must be the same."""

    build: Callable[[], Gaussians]
    cameras: tuple[Camera, ...]
    psnr: float
    """dB, at least."""


FADED_FLOAT16 = 255 / 4096
"""Largest error of a float16 target under thousands of faint layers. What adds less than half a digit, 2^-12,
to a sum near 1 is lost: with the faintest alpha, 1/255, all that comes behind a transmittance of 255·2^-12.
(An H200 gave 0.049.)"""


@dataclass(frozen=True, eq=False)
class HardCase:
    """One scene that breaks renderers, and what must happen. Indices are of splats of the scene."""

    name: str
    what: str
    """One sentence: what is hard about it."""
    build: Callable[[], Gaussians]
    _: KW_ONLY
    theme: str
    cameras: tuple[Camera, ...]
    settings: Mapping[str, RenderSettings] = field(default_factory=lambda: BOTH)
    """By name; every one is drawn. Their `blend` does not matter: the renderer's own counts."""
    culled: tuple[int, ...] = ()
    """These must not show: without them every picture is the same."""
    visible: tuple[int, ...] = ()
    """Each of these must show: without it one of the pictures differs by at least `visible_by`."""
    visible_by: float = 0.05
    """Smallest difference, somewhere, by a splat that must show; 0 to 1 is black to white."""
    bound: float = 2e-3
    """Largest error of float32 against the float64 reference (see `run.error_of`)."""
    bound_float16: float = 4 / 255
    """Largest error of a renderer that blends in float16."""
    most_excluded: int = 0
    """Pixels of one picture that may be beyond the bound because an alpha sits on a cut or depths tie, as
    `run.unexplained_pixels` finds them."""
    same: Same | None = None
    trains: bool = True
    """Whether the scene is also trained on."""


def splats(
    means: ArrayLike,
    *,
    scale: ArrayLike = 0.2,
    log_scales: ArrayLike | None = None,
    quats: ArrayLike = (1.0, 0.0, 0.0, 0.0),
    logits: ArrayLike = 3.0,
    rgb: ArrayLike = (0.9, 0.5, 0.2),
    degree: int = 0,
    dtype: type[np.floating] = np.float32,
) -> Gaussians:
    """Splats at `means` (N, 3); everything else is repeated where it is given once.

    `scale`: standard deviations, one number or three; `log_scales` instead of them, (3,) or (N, 3).
    `rgb` (3,) or (N, 3): the constant band; the others are 0. `dtype` is that of the means.
    """
    positions = np.array(means, dtype=dtype).reshape(-1, 3)
    n = len(positions)
    with np.errstate(divide="ignore"):
        logarithms = np.log(np.asarray(scale, np.float64)) if log_scales is None else np.asarray(log_scales)
    if logarithms.ndim == 1 and log_scales is None and len(logarithms) == n != 3:
        logarithms = logarithms[:, None]
    sh = np.zeros((n, SH_COEFFICIENTS[degree], 3), np.float32)
    sh[:, 0] = (np.asarray(rgb, np.float64) - 0.5) / SH_C0
    return Gaussians(
        means=positions,
        quats=np.broadcast_to(np.asarray(quats, np.float32), (n, 4)).copy(),
        log_scales=np.broadcast_to(logarithms.astype(np.float32), (n, 3)).copy(),
        opacity_logits=np.broadcast_to(np.asarray(logits, np.float32), (n,)).copy(),
        sh=sh,
    )


def camera(
    width: int = WIDTH,
    height: int = HEIGHT,
    *,
    focal: float = 30.0,
    eye: ArrayLike = (0.0, 0.0, 0.0),
    turn: float = 0.0,
    cx: float | None = None,
    cy: float | None = None,
    aspect: float = 1.0,
) -> Camera:
    """An eye that looks along +z, turned to the right by `turn` degrees; y is down. `aspect` is fy / fx."""
    angle = math.radians(turn)
    matrix = np.eye(4)
    matrix[0, 0] = matrix[2, 2] = math.cos(angle)
    matrix[0, 2], matrix[2, 0] = -math.sin(angle), math.sin(angle)
    matrix[:3, 3] = -matrix[:3, :3] @ np.asarray(eye, np.float64)
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=focal * aspect,
        cx=width / 2 if cx is None else cx,
        cy=height / 2 if cy is None else cy,
        world_to_camera=matrix,
    )


FRONT = camera()
TURNED = camera(eye=(0.7, -0.2, 0.1), turn=-9.0)
"""The same things from beside, so that no axis of the world is one of the camera's."""


def neighbours(degree: int = 0, *, count: int = 12, seed: int = 1) -> Gaussians:
    """Ordinary splats about (0, 0, 3), as what is hard must not spoil them."""
    rng = np.random.default_rng(seed)
    ordinary = splats(
        rng.uniform((-1.2, -0.9, 2.6), (1.2, 0.9, 3.6), (count, 3)),
        log_scales=rng.normal(-1.6, 0.4, (count, 3)),
        quats=rng.normal(size=(count, 4)),
        logits=rng.normal(1.0, 1.0, count),
        rgb=rng.uniform(0.1, 1.0, (count, 3)),
        degree=degree,
    )
    ordinary.sh[:, 1:] = rng.normal(scale=0.15, size=ordinary.sh[:, 1:].shape)
    return ordinary


def among_neighbours(*special: Gaussians, degree: int = 0) -> Gaussians:
    """The special splats first, so that their indices begin at 0, then ordinary ones."""
    return concatenate([*special, neighbours(degree)])


def about_axis(axis: Sequence[float], degrees: float) -> np.ndarray:
    """(4,) unit quaternion wxyz."""
    unit = np.asarray(axis, np.float64) / np.linalg.norm(axis)
    half = math.radians(degrees) / 2
    return np.array([math.cos(half), *(math.sin(half) * unit)])
