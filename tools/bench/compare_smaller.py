"""How true a scene stays when it is shown smaller: with and without antialiased opacity.

The reference is the picture at full size, by the model that the scene asks for, each `factor` x `factor`
block of pixels averaged: what a camera of fewer pixels would see. Compared with it are pictures drawn at the
small size. Without the effect the blur makes every splat at least about a pixel wide, at its full opacity: a
scene of small splats becomes thicker and brighter the smaller it is shown.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splatview.measure.metrics import psnr
from splatview.scene import Camera, Gaussians, RenderSettings

Draw = Callable[[Gaussians, Camera, RenderSettings], np.ndarray]
"""The picture (H, W, 4) of a renderer."""

KERNELS = (0.1, 0.3)
"""px²: that of Mip-Splatting, and the usual one."""


class Smaller(NamedTuple):
    """One kernel at one size."""

    factor: int
    kernel: float
    without: float
    """dB"""
    antialiased: float
    """dB"""


def averaged(image: np.ndarray, factor: int) -> np.ndarray:
    """(H, W, C) -> (H // factor, W // factor, C), by the mean of blocks; what is left over is cut off."""
    height, width = (size // factor for size in image.shape[:2])
    blocks = image[: height * factor, : width * factor].reshape(height, factor, width, factor, -1)
    return blocks.mean(axis=(1, 3))


def compare_smaller(
    draw: Draw, gaussians: Gaussians, camera: Camera, settings: RenderSettings, factors: tuple[int, ...]
) -> list[Smaller]:
    """`settings` say how the scene is shown at `camera`'s size, which the factors must divide."""
    full = draw(gaussians, camera, settings)
    found = []
    for factor in factors:
        truth = averaged(full, factor)
        small = camera.resized(camera.width // factor, camera.height // factor)
        for kernel in KERNELS:
            scores = []
            for antialiased in (False, True):
                model = replace(settings.model, antialiased=antialiased, blur=kernel)
                scores.append(psnr(draw(gaussians, small, replace(settings, model=model)), truth))
            found.append(Smaller(factor, kernel, *scores))
    return found
