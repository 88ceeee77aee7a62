"""Depth of field by a thin lens: the mean of what pinholes all over its opening see.

All pinholes share one plane of focus: where the eye moves by a in the plane of the lens, the principal
point moves by f·a/focus, so a point at the focus distance stays on its pixel. A point at depth z then
moves over a disc of diameter f·|1/focus - 1/z| times that of the opening. The mean becomes exact as the
number of pinholes grows, for any renderer, and where the opening is 0 it is the picture of one pinhole.

Pinholes lie by the R2 sequence (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences"),
mapped to a disc so that areas stay equal (Shirley and Chiu 1997). It can be cut off anywhere: every
beginning of it covers the disc evenly. Its first point is the centre. Of a skull of 95,000 splats, blurred
by up to 34 px, 16 points give 41 dB and a largest error of 35 grey levels, 64 give 53 dB and 9, 256 give
67 dB and 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.errors import InputError

PLASTIC = 1.32471795724474602596
"""The real root of x³ = x + 1."""


@dataclass(frozen=True, kw_only=True)
class Aperture:
    """A thin lens.

    Raises:
        ValueError: a length is not positive and finite.
    """

    diameter: float
    """Diameter of the opening, world units."""
    focus: float
    """Depth t.z of the plane that is sharp, world units."""

    def __post_init__(self) -> None:
        for name in ("diameter", "focus"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be positive and finite, got {getattr(self, name)}")


def check_camera(camera: Camera) -> None:
    """Raises InputError where the camera is no pinhole: shifting its picture would bend it."""
    if camera.lens is not None:
        raise InputError("depth of field needs a pinhole camera, and this one's lens distorts; leave one out")
    if camera.orthographic:
        raise InputError("depth of field needs a pinhole camera, and this one is orthographic; leave one out")


def disc_point(index: int) -> tuple[float, float]:
    """Point `index` (from 0) of the sequence in the unit disc."""
    x, y = (2 * math.modf(0.5 + index / PLASTIC**power)[0] - 1 for power in (1, 2))
    if x == y == 0:
        return 0.0, 0.0
    if abs(x) >= abs(y):
        radius, angle = x, math.pi / 4 * (y / x)
    else:
        radius, angle = y, math.pi / 2 - math.pi / 4 * (x / y)
    return radius * math.cos(angle), radius * math.sin(angle)


def camera_at(camera: Camera, aperture: Aperture, index: int) -> Camera:
    """The pinhole at point `index` of the opening; `camera`'s eye is its centre."""
    x, y = (aperture.diameter / 2 * part for part in disc_point(index))
    matrix = camera.world_to_camera.copy()
    matrix[:2, 3] -= x, y
    return replace(
        camera,
        world_to_camera=matrix,
        cx=camera.cx + camera.fx * x / aperture.focus,
        cy=camera.cy + camera.fy * y / aperture.focus,
    )


def mean_picture(
    draw: Callable[[Camera], np.ndarray], camera: Camera, aperture: Aperture, samples: int
) -> np.ndarray:
    """The picture through the lens, of the shape and dtype that `draw` gives for a camera.

    Raises:
        InputError: the camera is no pinhole.
    """
    check_camera(camera)
    first = draw(camera_at(camera, aperture, 0))
    total = first.astype(np.float64)
    for index in range(1, samples):
        total += draw(camera_at(camera, aperture, index))
    return (total / samples).astype(first.dtype)
