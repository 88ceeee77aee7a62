"""Palettes: few values that stand for many, by weighted k-means.

All splats against all centroids is what makes an encoder slow: 95,000 splats of SH degree 3 and 16,384
centroids are 140 billion operations a pass. So the splats are first parted into groups, and each group gets
its share of the centroids and is clustered by itself, by mini-batch k-means (Sculley 2010); distances are
products of matrices, which BLAS does at the machine's speed.

What was tried besides (assets/benchmarks/palette.json, of 256 to 4,096 entries): Lloyd's iteration in more
groups gives 0.1 to 0.8 dB less, in 0.7 to 5.6 times the time (at 16,384 entries of skull.ply 0.2 dB more, in
about the same). Distances by a compiled kernel take 1.1 to 2.3 times as long. One group for all gives 0.2 to
0.9 dB more at 4,096 entries, in 3.5 times the time. Chosen on train-1000.ply, judged on the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splatview.scene.formats.packing import slices
from splatview.scene.progress import NO_PROGRESS, Progress

ROUNDS = 48
"""Passes over one set of numbers; more change the error by less than 1 %."""

GROUP = 1024
"""Centroids of a group, about."""

PASSES = 3
"""Over the rows of a group."""

BATCH = 1 << 12
"""Rows between two steps of the centroids."""

SAMPLE = 1 << 15
"""Rows that the groups are found on."""

SAMPLED = 1 << 19
"""Values that levels are found on, evenly taken of more: sums up to each of them need 40 bytes."""

TAIL = 0.005
"""Share of the values at each end that are all taken: sampled as well, they make the error 7 % larger (of 1.8
million that are distributed as Student's t of 3 degrees of freedom)."""

BLOCK = 1 << 20
"""Distances held at once."""


def levels(values: np.ndarray, weights: np.ndarray, count: int = 256) -> tuple[np.ndarray, np.ndarray]:
    """`count` levels, ascending float32, and the index uint8 of the nearest for each of `values` (N, ...)
    float32, finite, so that the weighted sum of squared errors is small: Lloyd's iteration on sorted values.

    `weights`: (N,), at least 0.
    """
    flat = values.reshape(-1)
    if not len(flat):
        return np.zeros(count, np.float32), np.zeros(values.shape, np.uint8)
    distinct = flat[:0]
    for part in slices(len(flat)):
        distinct = np.unique(np.concatenate([distinct, flat[part]]))
        if len(distinct) > count:
            break
    else:
        # Quantised before: not again.
        return np.pad(distinct, (0, count - len(distinct)), mode="edge"), _nearest_level(distinct, values)
    some, held = _sampled(values, weights)
    order = np.argsort(some)
    ordered = some[order].astype(np.float64)
    mass = np.concatenate([[0.0], np.cumsum(held[order] + 1e-12)])
    del some, order
    moment = np.concatenate([[0.0], np.cumsum(ordered * np.diff(mass))])
    # Half as quantiles, half evenly over the range: outliers get levels of their own.
    shares = np.linspace(0, 1, count // 2)
    quantiles = ordered[np.minimum(np.searchsorted(mass[1:], shares * mass[-1]), len(ordered) - 1)]
    even = np.linspace(float(flat.min()), float(flat.max()), count - count // 2)
    found = np.sort(np.concatenate([quantiles, even]))
    for _ in range(ROUNDS):
        edges = np.concatenate([[0], np.searchsorted(ordered, (found[1:] + found[:-1]) / 2), [len(ordered)]])
        held = mass[edges[1:]] - mass[edges[:-1]]
        means = (moment[edges[1:]] - moment[edges[:-1]]) / np.where(held > 0, held, 1)
        found = np.sort(np.where(held > 0, means, found))
    book = found.astype(np.float32)
    return book, _nearest_level(book, values)


def _sampled(values: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Some SAMPLED of the values, or all of fewer, and the weight of each: of every so many rows those within
    TAIL of either end, and all beyond, where each value matters."""
    flat, columns, step = values.reshape(-1), math.prod(values.shape[1:]), -(-values.size // SAMPLED)
    some, held = values[::step].reshape(-1), np.repeat(weights[::step], columns)
    if step == 1:
        return some, held
    low, high = np.quantile(some, [TAIL, 1 - TAIL])
    inside, beyond = (some >= low) & (some <= high), np.flatnonzero((flat < low) | (flat > high))
    found = np.concatenate([some[inside], flat[beyond]])
    return found, np.concatenate([step * held[inside], weights[beyond // columns]])


def _nearest_level(book: np.ndarray, values: np.ndarray) -> np.ndarray:
    # In float64: between neighbouring float32 there is no middle.
    flat, middles = values.reshape(-1), (book[1:].astype(np.float64) + book[:-1]) / 2
    indices = np.empty(len(flat), np.uint8)
    for part in slices(len(flat)):
        indices[part] = np.searchsorted(middles, flat[part])
    return indices.reshape(values.shape)


@dataclass(frozen=True)
class Rows:
    """Rows of D numbers, float32, of which a few at a time are put together: all are most of a scene."""

    values: np.ndarray
    """(M, ...), of D numbers each; may be a view."""
    order: np.ndarray
    """(N,) indices of the rows."""

    def __len__(self) -> int:
        return len(self.order)

    def __getitem__(self, part: slice | np.ndarray) -> np.ndarray:
        """(P, D) float32."""
        at = self.order[part]
        return np.ascontiguousarray(self.values[at], np.float32).reshape(len(at), -1)

    def take(self, indices: np.ndarray) -> Rows:
        return Rows(self.values, self.order[indices])


def vectors(
    rows: Rows, weights: np.ndarray, count: int, *, progress: Progress = NO_PROGRESS, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """At most `count` centroids (C, D) float32 of N rows, and the index (N,) of each row's own.

    Weighted by `weights` (N,) float64, at least 0. Where there are no more different rows than that, those
    are the centroids, and nothing is lost. Raises Cancelled.
    """
    rng = np.random.default_rng(seed)
    found = _distinct(rows, count)
    if found is not None:
        return found
    weights = weights + 1e-12 * max(float(weights.max(initial=0.0)), 1e-300)
    groups = max(1, count // GROUP)
    sample = rng.choice(len(rows), min(SAMPLE, len(rows)), replace=False)
    middles = _clustered(rows.take(sample), weights[sample], groups, rng)
    group_of, errors = nearest(rows, middles)
    shares = _shares(
        np.bincount(group_of, weights * np.maximum(errors, 0), groups),
        np.bincount(group_of, minlength=groups),
        count,
    )
    del errors
    # Made once: put together from parts it would be there twice, a tenth of a scene.
    centroids, labels = np.empty((count, middles.shape[1]), np.float32), np.empty(len(rows), np.int32)
    first = 0
    for group in range(groups):
        members = np.flatnonzero(group_of == group)
        if len(members):
            own = rows.take(members)
            mine = _clustered(own, weights[members], int(shares[group]), rng)
            labels[members] = first + nearest(own, mine)[0]
            centroids[first : first + len(mine)] = mine
            first += len(mine)
        progress.step((group + 1) / groups)
    return centroids[:first], labels


HASH_FACTOR = 0x9E3779B97F4A7C15
"""Odd, with about as many bits 0 as 1: 2^64 by the golden ratio."""


def _distinct(rows: Rows, most: int) -> tuple[np.ndarray, np.ndarray] | None:
    """The different rows, and for each row which it is; None where there are more than `most`."""
    # By hashes of 64 bits, not by the rows: sorting those takes three copies of them.
    hashes = np.zeros(len(rows), np.uint64)
    for part in slices(len(rows)):
        mixed = hashes[part]
        for column in rows[part].view(np.uint32).T:
            mixed ^= column
            mixed *= np.uint64(HASH_FACTOR)
            mixed ^= mixed >> np.uint64(29)
    ordered = np.sort(hashes)
    if np.count_nonzero(ordered[1:] != ordered[:-1]) >= most:
        return None
    del ordered
    _, first, labels = np.unique(hashes, return_index=True, return_inverse=True)
    distinct = rows[first]
    for part in slices(len(rows)):
        if not np.array_equal(distinct[labels[part]], rows[part]):
            return None  # two that only hash alike
    return distinct, labels


def _shares(errors: np.ndarray, sizes: np.ndarray, count: int) -> np.ndarray:
    """Centroids of each group: by the cube root of error and size, which evens out what is left, at least one
    and no more than members; together at most `count`, which is no less than the number of groups."""
    wish = np.cbrt(np.maximum(errors, 0)) * np.cbrt(sizes) ** 2 + 1e-300
    shares = np.minimum(np.maximum(np.floor(wish / wish.sum() * count), 1), np.maximum(sizes, 1))
    for group in np.argsort(-shares):  # one each may be more than there are
        shares[group] -= min(max(shares.sum() - count, 0), shares[group] - 1)
    for group in np.argsort(-wish):
        room = count - shares.sum()
        if room <= 0:
            break
        shares[group] += min(
            room, max(sizes[group] - shares[group], 0), np.ceil(wish[group] / wish.sum() * count)
        )
    return shares


def _clustered(rows: Rows, weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """At most `count` centroids by mini-batch k-means from random rows, the likelier the heavier: each moves
    to the mean of all rows that it was the nearest to when they were seen."""
    if len(rows) <= count:
        return rows[slice(None)]
    probabilities = weights / weights.sum()
    count = min(count, int(np.count_nonzero(probabilities)))
    centroids = rows[rng.choice(len(rows), count, replace=False, p=probabilities)]
    mass = np.zeros(count)
    for _ in range(PASSES):
        order = rng.permutation(len(rows))
        for start in range(0, len(order), BATCH):
            at = order[start : start + BATCH]
            part = rows[at]
            labels, _ = nearest(part, centroids)
            by_label = np.argsort(labels, kind="stable")
            moved, first = np.unique(labels[by_label], return_index=True)
            held = weights[at][by_label]
            new = np.add.reduceat(held, first)
            sums = np.add.reduceat(part[by_label] * held[:, None], first, axis=0)
            mass[moved] += new
            steps = (sums - new[:, None] * centroids[moved]) / mass[moved, None]
            centroids[moved] += steps.astype(np.float32)
    return centroids


def nearest(rows: np.ndarray | Rows, centroids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index (N,) int32 of the centroid nearest to each of rows (N, D), and the squared distance."""
    labels, errors = np.empty(len(rows), np.int32), np.empty(len(rows), np.float32)
    half_squares = 0.5 * np.einsum("cd,cd->c", centroids, centroids)
    step = max(1, BLOCK // len(centroids))
    for start in range(0, len(rows), step):
        part = rows[start : start + step]
        score = part @ centroids.T
        score -= half_squares
        best = score.argmax(axis=1)
        labels[start : start + step] = best
        errors[start : start + step] = (
            np.einsum("nd,nd->n", part, part) - 2 * score[np.arange(len(part)), best]
        )
    return labels, errors
