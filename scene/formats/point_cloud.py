"""A plain point cloud as round splats, so that it can be looked at."""

from __future__ import annotations

import numpy as np
from plyfile import PlyElement

from splatview.scene.errors import InputError
from splatview.scene.formats.ply_body import PlyBody, Target
from splatview.scene.formats.ply_header import scalar_types
from splatview.scene.gaussians import Gaussians
from splatview.scene.sh import rgb_to_sh

COLOURS = (("red", "green", "blue"), ("r", "g", "b"), ("diffuse_red", "diffuse_green", "diffuse_blue"))

GREY = 0.5
"""Colour of points that have none."""

OPACITY_LOGIT = 4.6
"""An opacity of 0.99: a point hides what is behind it."""

SIGMA_OF_SPACING = 0.5
"""Standard deviation of a splat in distances to its neighbours: neighbours then just close the gap."""

CLAMP = 4.0
"""A splat is at most this much larger or smaller than the median: lone points do not become balls."""


def read_point_cloud(body: PlyBody, vertex: PlyElement) -> Gaussians:
    """Round splats at the points, coloured as they are, sized by `spacing`. Raises as `PlyBody.read_rows`."""
    types = scalar_types(vertex)
    missing = [name for name in "xyz" if name not in types]
    if missing:
        raise InputError(
            f"{body.path}: the points have no {', '.join(missing)}; it is neither splats nor a point cloud"
        )
    body.check_size(vertex)
    n = vertex.count
    exact_in_float32 = all(np.can_cast(types[name], np.float32) for name in "xyz")
    means = np.empty((n, 3), dtype=np.float32 if exact_in_float32 else np.float64)
    colour_names = next((names for names in COLOURS if all(name in types for name in names)), ())
    colours = np.empty((n, 3), dtype=np.float32)
    used = {"x", "y", "z", *colour_names}
    extras = {name: np.empty(n, dtype) for name, dtype in types.items() if name not in used}
    targets = [Target(names="xyz", array=means)]
    if colour_names:
        targets.append(Target(names=colour_names, array=colours))
    targets += [Target(names=[name], array=values) for name, values in extras.items()]
    body.read_rows(vertex, targets)

    if colour_names:
        colours /= _white(colours, types[colour_names[0]])
    else:
        colours[:] = GREY
    sigma = SIGMA_OF_SPACING * spacing(means)
    quats = np.zeros((n, 4), dtype=np.float32)
    quats[:, 0] = 1
    look = "coloured" if colour_names else "grey, as it has no colours"
    return Gaussians(
        means=means,
        quats=quats,
        log_scales=np.repeat(np.log(sigma).astype(np.float32)[:, None], 3, axis=1),
        opacity_logits=np.full(n, OPACITY_LOGIT, dtype=np.float32),
        sh=rgb_to_sh(colours).astype(np.float32)[:, None],
        comments=(
            *body.header.comments,
            f"splatview: made from a point cloud of {n} points ({look}): round splats, sigma = "
            f"{SIGMA_OF_SPACING:g} x distance to near points",
        ),
        extras=extras,
    )


def _white(colours: np.ndarray, dtype: np.dtype) -> float:
    """What means full intensity: of integers their largest, of floats 1, or 255 where any exceeds 1."""
    if dtype.kind in "iu":
        return float(np.iinfo(dtype).max)
    with np.errstate(invalid="ignore"):
        return 255.0 if (colours > 1).any() else 1.0


def spacing(means: np.ndarray) -> np.ndarray:
    """Distance of each point to a near one, (N, 3) float -> (N,) float64, all positive and finite.

    Points are sorted along a Morton curve; the nearest of the two before and the two behind on it is nearly
    always a neighbour, at the price of one sort and no tree. Clamped to CLAMP times the median.
    """
    # Points near the largest numbers are infinitely far from others, which is the clamp's business.
    with np.errstate(over="ignore", invalid="ignore"):
        finite = np.isfinite(means).all(axis=1)
        points = means[finite].astype(np.float64)
        near = np.full(len(points), np.inf)
        if len(points) > 1:
            order = np.argsort(morton_codes(points))
            along = points[order]
            nearest = np.full(len(points), np.inf)
            for step in (1, 2):
                distances = np.linalg.norm(along[step:] - along[:-step], axis=1)
                # Copies of a point say nothing about the distance to its neighbours.
                distances[distances == 0] = np.inf
                np.minimum(nearest[step:], distances, out=nearest[step:])
                np.minimum(nearest[:-step], distances, out=nearest[:-step])
            near[order] = nearest
        known = near[np.isfinite(near)]
        median = float(np.median(known)) if len(known) else 0.01
        result = np.full(len(means), median)
        result[finite] = np.clip(near, median / CLAMP, median * CLAMP)
        return result


def morton_codes(points: np.ndarray) -> np.ndarray:
    """(N, 3) finite float64 -> (N,) uint64: cells of a cube, 2²¹ to a side, with the bits interleaved."""
    low = points.min(axis=0)
    side = (points.max(axis=0) - low).max()
    cells = ((points - low) * ((2**21 - 1) / side if side > 0 else 0.0)).astype(np.uint64)
    for shift, mask in (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    ):
        cells = (cells | (cells << np.uint64(shift))) & np.uint64(mask)
    return cells[:, 0] | (cells[:, 1] << np.uint64(1)) | (cells[:, 2] << np.uint64(2))
