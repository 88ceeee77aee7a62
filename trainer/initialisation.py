"""The splats that a run begins with, from a capture's points, and the tags of the scene that it leaves.

Dropped: splats in those parts of each photo that no point covers, at the depth of the points around. The
trees of `beach`, which have no points, are then met in the photos trained on (16.5 and 19.4 dB in one of
them), but held-out photos gain nothing by it (one split after a minute, as they are): `beach` 17.20 and 17.23
dB, `tree` 19.75 and 19.14, `kermit` 18.92 and 17.95, `toy` 17.78 and 18.06, `street` 14.47 and 14.63; only
guesses whose colours other photos have: `beach` 17.07, `kermit` 19.51. By stereo: 18.36 for `beach`, whose
trees are one even green by it; `castle` 17.95 and 18.02.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.edit.kernels.kdtree import nearest
from splatview.raster import Parameters
from splatview.scene import ImageModel, InputError
from splatview.scene.gaussians import NEAR_TAG
from splatview.scene.image_model import BLUR, NEAR
from splatview.scene.sh import SH_C0


def mean_square_distance(points: np.ndarray, *, neighbours: int = 3) -> np.ndarray:
    """(N,) float64: the mean squared distance of each of points (N, 3) to its nearest others.

    Points all finite. Where there are fewer others, the mean is over those; a lone point has 0.
    """
    neighbours = min(neighbours, len(points) - 1)
    if neighbours < 1:
        return np.zeros(len(points))
    _, distances = nearest(points, neighbours)
    return np.square(distances).mean(axis=1)


INITIAL_OPACITY = 0.1
"""Kerbl et al. 2023: faint enough that what is behind a splat is trained too."""

LEAST_SQUARE_DISTANCE = 1e-7
"""In units of the scene's extent squared: points that coincide get splats of some size all the same."""


def initial_parameters(
    points: np.ndarray,
    colours: np.ndarray,
    extent: float,
    *,
    opacity: float = INITIAL_OPACITY,
    scale: float = 1.0,
    limit: int | None = None,
    seed: int = 0,
) -> Parameters:
    """Round splats at points (N, 3), of colours (N, 3) uint8, degree 0, float32.

    Their standard deviation is `scale` times the root of the mean squared distance to the three nearest
    neighbours. Points that are not finite are left out, and of more than `limit` points a sample is used.

    Raises:
        InputError: no point is left.
    """
    usable = np.isfinite(points).all(axis=1)
    points, colours = points[usable], colours[usable]
    if len(points) == 0:
        raise InputError("the capture has no usable 3D points to begin with")
    if limit is not None and len(points) > limit:
        sample = np.sort(np.random.default_rng(seed).choice(len(points), limit, replace=False))
        points, colours = points[sample], colours[sample]
    squares = mean_square_distance(points)
    squares = np.clip(squares, LEAST_SQUARE_DISTANCE * extent**2, extent**2)
    log_scales = 0.5 * np.log(squares) + math.log(scale)
    count = len(points)
    quats = np.zeros((count, 4), np.float32)
    quats[:, 0] = 1
    return Parameters(
        means=np.ascontiguousarray(points, np.float32),
        quats=quats,
        log_scales=np.repeat(log_scales.astype(np.float32)[:, None], 3, axis=1),
        opacity_logits=np.full(count, math.log(opacity / (1 - opacity)), np.float32),
        sh=((colours.astype(np.float32) / 255 - 0.5) / SH_C0)[:, None, :].copy(),
    )


def comments_for(model: ImageModel) -> tuple[str, ...]:
    """The tags by which `scene.effects`, and other viewers, know it again; none for the usual model."""
    tags = () if model.near == NEAR else (f"{NEAR_TAG} {model.near:.6g}",)
    if not model.antialiased:
        return tags
    return ("antialiased 1" if model.blur == BLUR else "SplatRenderMode: mip", *tags)
