"""Fewer splats that look alike from afar: neighbours smaller than a cell of a grid become one.

Moments are kept (as in Zwicker et al. 2001, and in hierarchies of Gaussians since): a merged splat has
the mean, the covariance and the colour of its members, each weighted with the light that it takes, which
is its opacity times its area. Splats larger than a cell stay as they are, and so do lone and invalid ones.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from splatview.scene.gaussians import ARRAYS, Gaussians
from splatview.scene.projection import covariances_3d, sigmoid

MEMBER_SIZE = 1.5
"""A splat is merged when its largest standard deviation is below so many cells."""

GROWTH = 1.5
"""Factor of the cell's side from one level to the next."""

FIRST_CELL = 1.4
"""The first level's cell, in units of the median of the splats' largest standard deviation."""

LEAST_GAIN = 0.85
"""A level that keeps more of the splats than this is passed over: a larger cell follows at once."""

FULL_OPACITY = 0.99
"""The most that a merged splat has; what renderers allow."""

MEMBERS_AT_ONCE = 1 << 13
"""Some 3 MiB of numbers in between."""

MIXED_CELLS = 2
"""Cells along the side of a cube that is merged or not as a whole, see `chances`."""

_CELL_BITS = 20
_TINY = 1e-12


def levels_and_cells(gaussians: Gaussians, *, levels: int = 4) -> Iterator[tuple[Gaussians, float]]:
    """Up to `levels` scenes of ever fewer splats, each made from the one before when it is asked for, and the
    side of the cells in which that one was merged."""
    sizes = gaussians.log_scales.max(axis=1) if len(gaussians) else np.empty(0)
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes):
        return
    cell = FIRST_CELL * math.exp(float(np.median(sizes)))
    for _ in range(2 * levels):
        fewer, side = merge_in_cells(gaussians, cell), cell
        cell *= GROWTH
        if len(fewer) <= LEAST_GAIN * len(gaussians):
            gaussians, levels = fewer, levels - 1
            yield gaussians, side
            if levels == 0:
                return
        del fewer  # the next one is made without it


def merge_in_cells(gaussians: Gaussians, cell: float) -> Gaussians:
    """Merges the splats that share a cube of a grid with side `cell`, in world units; merged ones come first.

    Comments are kept, extras are not.
    """
    members, starts = _groups(gaussians, cell)
    alone = np.ones(len(gaussians), bool)
    alone[members] = False
    rest = np.flatnonzero(alone)
    arrays = {}
    for name in ARRAYS:
        values = getattr(gaussians, name)
        arrays[name] = np.empty((len(starts) + len(rest), *values.shape[1:]), values.dtype)
        # With mode="clip" numpy writes to `out` itself, not to a copy first.
        np.take(values, rest, axis=0, out=arrays[name][len(starts) :], mode="clip")
    for begin, stop, first, end in _batches(starts, len(members)):
        merged = _merged(gaussians, members[first:end], starts[begin:stop] - first)
        for name, values in arrays.items():
            values[begin:stop] = getattr(merged, name)
    return replace(gaussians, **arrays, extras={})


def chances(finer: Gaussians, cell: float, gaussians: Gaussians) -> np.ndarray:
    """Numbers (N,) float32 in [0, 1) of splats of `gaussians`, which is `finer` or what it was merged to in
    cells of side `cell`: the same for all that lie in one cube of MIXED_CELLS³ cells, chosen by chance.

    So what is below a number of one, and not below it of the other, is a scene between the two, without a
    hole and with nothing twice: a cube has whole cells.
    """
    side = MIXED_CELLS * cell
    with np.errstate(invalid="ignore", over="ignore"):
        cubes = np.floor((gaussians.means - _middle(finer.means)) / side)
        cubes = np.nan_to_num(cubes, nan=0.0, posinf=0.0, neginf=0.0).astype(np.int64).astype(np.uint64)
        # Odd multipliers and shifts that spread low bits (as in splitmix64).
        mixed = cubes[:, 0] * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= cubes[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F) ^ cubes[:, 2] * np.uint64(0x165667B19E3779F9)
        mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        mixed ^= mixed >> np.uint64(31)
    return ((mixed >> np.uint64(41)).astype(np.float32) / np.float32(1 << 23)).clip(0, np.float32(1 - 1e-7))


def _groups(gaussians: Gaussians, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """(M,) splats to be merged, cell by cell, and (G,) where each cell's begin; at least two in each."""
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        small = gaussians.log_scales.max(axis=1) < math.log(MEMBER_SIZE * cell)
        sound = np.isfinite(gaussians.sh.sum(axis=(1, 2))) & np.isfinite(gaussians.opacity_logits)
        sound &= np.isfinite(gaussians.log_scales).all(axis=1)
        norms = np.abs(gaussians.quats).max(axis=1)
        sound &= (norms > _TINY) & (norms < 1 / _TINY)
        places = (gaussians.means - _middle(gaussians.means)) / cell
        sound &= (np.abs(places) < 2.0 ** (_CELL_BITS - 1)).all(axis=1)
    members = np.nonzero(small & sound)[0]
    cells = np.floor(places[members]).astype(np.int64) + (1 << (_CELL_BITS - 1))
    keys = (cells[:, 0] << 2 * _CELL_BITS) | (cells[:, 1] << _CELL_BITS) | cells[:, 2]
    order = np.argsort(keys, kind="stable")
    members, keys = members[order], keys[order]
    begins = np.ones(len(keys), bool)
    begins[1:] = keys[1:] != keys[:-1]
    starts = np.nonzero(begins)[0]
    counts = np.diff(starts, append=len(keys))
    shared = counts > 1
    members = members[np.repeat(shared, counts)]
    return members, np.cumsum(counts[shared]) - counts[shared]


def _middle(means: np.ndarray) -> np.ndarray:
    sound = means[np.isfinite(means).all(axis=1)]
    return np.median(sound, axis=0) if len(sound) else np.zeros(3)


def _batches(starts: np.ndarray, members: int) -> Iterator[tuple[int, int, int, int]]:
    """Runs of groups, (begin, stop), with their members (first, end), of bounded size."""
    begin = 0
    while begin < len(starts):
        first = int(starts[begin])
        stop = int(np.searchsorted(starts, first + MEMBERS_AT_ONCE, side="right"))
        stop = max(stop, begin + 1)
        end = int(starts[stop]) if stop < len(starts) else members
        yield begin, stop, first, end
        begin = stop


def _merged(gaussians: Gaussians, members: np.ndarray, starts: np.ndarray) -> Gaussians:
    """One splat for each group of `members` (M,), the groups beginning at `starts` (G,)."""

    def total(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values, starts, axis=0)

    counts = np.diff(starts, append=len(members))
    log_scales = gaussians.log_scales[members].astype(np.float64)
    # Half a splat's surface is about the product of its two larger axes.
    area = np.exp(log_scales.sum(axis=1) - log_scales.min(axis=1))
    light = sigmoid(gaussians.opacity_logits[members].astype(np.float64)) * area + _TINY * _TINY
    sums = total(light)
    share = light / np.repeat(sums, counts)
    means = gaussians.means[members].astype(np.float64)
    origin = means[starts]
    offsets = means - np.repeat(origin, counts, axis=0)
    centre = total(share[:, None] * offsets)
    offsets -= np.repeat(centre, counts, axis=0)
    spread = covariances_3d(gaussians.quats[members].astype(np.float64), log_scales)
    spread += offsets[:, :, None] * offsets[:, None, :]
    variances, axes = np.linalg.eigh(total(share[:, None, None] * spread))
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    scales = np.sqrt(np.maximum(variances, _TINY * np.maximum(variances[:, 2:], _TINY)))
    # So many layers lie over one another where the members' light meets the merged splat's area. ...
    layers = sums / (scales[:, 1] * scales[:, 2])
    # ... From two on it is opaque, and half transparent only where 1 - exp(-layers·g) is: further out.
    spread_out = np.sqrt(np.maximum(np.log(2 * np.maximum(layers, 1)) / math.log(2), 1))
    opacity = np.clip(layers, _TINY, FULL_OPACITY)
    sh = gaussians.sh[members].reshape(len(members), -1)
    return Gaussians(
        means=(origin + centre).astype(gaussians.means.dtype),
        quats=quaternions(axes).astype(np.float32),
        log_scales=np.log(scales * spread_out[:, None]).astype(np.float32),
        opacity_logits=np.log(opacity / (1 - opacity)).astype(np.float32),
        sh=total(share[:, None].astype(np.float32) * sh).reshape(len(starts), -1, 3),
    )


def quaternions(R: np.ndarray) -> np.ndarray:
    """(N, 3, 3) rotations -> (N, 4) wxyz unit quaternions, from the largest component (Shepperd 1978)."""
    xx, yy, zz = R[:, 0, 0], R[:, 1, 1], R[:, 2, 2]
    x, y, z = R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]
    xy, xz, yz = R[:, 0, 1] + R[:, 1, 0], R[:, 0, 2] + R[:, 2, 0], R[:, 1, 2] + R[:, 2, 1]
    # The four rows of 4·q·qᵀ, of which the longest is exact.
    rows = np.stack(
        [
            np.stack([1 + xx + yy + zz, x, y, z], axis=1),
            np.stack([x, 1 + xx - yy - zz, xy, xz], axis=1),
            np.stack([y, xy, 1 - xx + yy - zz, yz], axis=1),
            np.stack([z, xz, yz, 1 - xx - yy + zz], axis=1),
        ],
        axis=1,
    )
    longest = rows[np.arange(len(R)), np.argmax(np.einsum("nii->ni", rows), axis=1)]
    return longest / np.linalg.norm(longest, axis=1, keepdims=True)
