"""Attributes in fewer bits: how each format stores them, and the values that a scene has after it.

    float32     as files have them
    float16     quaternions, log-scales, opacity and spherical harmonics in IEEE half precision
    8-bit-sh    the same, and the bands above the constant one as whole numbers from -127 to 127 times one
                half-precision step a splat

Means stay float32: half precision would move splats by pixels. What float16 cannot hold is its largest
number; NaN stays NaN, so that what is culled in one format is culled in all.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from splatview.scene.gaussians import Gaussians
from splatview.scene.projection import sigmoid

Attributes = Literal["float32", "float16", "8-bit-sh"]

FORMATS: tuple[Attributes, ...] = ("float32", "float16", "8-bit-sh")

LARGEST_HALF = 65504.0

LEVELS = 127
"""Levels of an 8-bit coefficient on each side of 0."""


def stored(gaussians: Gaussians, attributes: Attributes) -> Gaussians:
    """The scene with the values that `attributes` can hold; itself for float32."""
    if attributes == "float32":
        return gaussians
    return replace(
        gaussians,
        quats=stored_quats(gaussians.quats).astype(np.float32),
        log_scales=half(gaussians.log_scales).astype(np.float32),
        opacity_logits=logits(half(sigmoid(gaussians.opacity_logits))),
        sh=half(gaussians.sh).astype(np.float32) if attributes == "float16" else stored_sh(gaussians.sh),
    )


def half(values: np.ndarray) -> np.ndarray:
    """float32 -> float16, rounded to nearest; finite stays finite."""
    with np.errstate(invalid="ignore"):
        inside = np.where(np.isfinite(values), np.clip(values, -LARGEST_HALF, LARGEST_HALF), values)
    with np.errstate(invalid="ignore", over="ignore"):
        return inside.astype(np.float16)


def stored_quats(quats: np.ndarray) -> np.ndarray:
    """(N, 4) float32 -> float16, divided by the largest component: only the direction counts, and 1e-25 is
    a direction too. Zeros stay zeros."""
    largest = np.abs(quats).max(axis=1, keepdims=True, initial=0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return half(np.where(np.isfinite(largest) & (largest > 0), quats / largest, quats))


def logits(opacities: np.ndarray) -> np.ndarray:
    """The inverse of `sigmoid`, float32; ±inf for 1 and 0."""
    exact = opacities.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return (np.log(exact) - np.log1p(-exact)).astype(np.float32)


def sh_levels(sh: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bands above the constant one of sh (N, K, 3) float32: whole numbers (N, K - 1, 3) int8 and steps (N,)
    float16. A splat with a coefficient that is NaN has a step that is NaN."""
    rest = sh[:, 1:]
    with np.errstate(invalid="ignore"):
        largest = np.abs(rest).max(axis=(1, 2), initial=0.0)
        steps = half(largest / LEVELS)
        exact = steps.astype(np.float32)
        # The smallest half that is not 0 stands for smaller ones, or they would be lost altogether.
        steps = np.where((exact == 0) & (largest > 0), np.float16(2.0**-24), steps)
        exact = steps.astype(np.float32)[:, None, None]
        whole = np.rint(rest / np.where(exact > 0, exact, np.float32(1)))
    return np.clip(np.nan_to_num(whole, nan=0.0), -LEVELS, LEVELS).astype(np.int8), steps


def stored_sh(sh: np.ndarray) -> np.ndarray:
    """(N, K, 3) float32 as the 8-bit format holds them."""
    whole, steps = sh_levels(sh)
    rest = whole.astype(np.float32) * steps.astype(np.float32)[:, None, None]
    return np.concatenate([half(sh[:, :1]).astype(np.float32), rest], axis=1)
