"""The nearest neighbours of every point: a k-d tree in one array, exact for any spread of the points.

Not scipy's cKDTree, which puts all points that coincide into one leaf: of 200,000 points, 20,000 of them in
one place, its search takes 3 to 6 times as long as this one and grows with the square of the heap; scenes
have such heaps. Without a heap it takes 1.5 to 2.3 times as long, and it cannot be cancelled.
"""

from __future__ import annotations

import numpy as np

from splatview.edit.kernels.compiling import in_pieces, inline, kernel
from splatview.scene.progress import NO_PROGRESS, Progress

LEAF = 8
"""Most points of a leaf, compared one by one."""

DEPTH = 64
"""Most nodes waiting: two per level, and halving 2³¹ points takes 31 levels."""

SEARCHES = 1 << 13
"""Points per piece of a search."""

BUILD_SHARE = 0.25
"""Share of the time that building the tree takes."""


def nearest(points: np.ndarray, k: int, progress: Progress = NO_PROGRESS) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M, k) int32 and distances (M, k) float64, ascending, of the k nearest others of `points`.

    `points` (M, 3) float64, all finite. Where there are fewer others, the last indices are -1 and their
    distances infinite. Raises Cancelled.
    """
    points = np.ascontiguousarray(points, np.float64)
    count = len(points)
    indices = np.full((count, k), -1, np.int32)
    distances = np.full((count, k), np.inf)
    if count < 2 or k < 1:
        return indices, distances
    order = np.arange(count, dtype=np.int32)
    axes = np.zeros(count, np.int8)
    progress.step(0.0)
    _build(points, order, axes)
    sorted_points = np.ascontiguousarray(points[order])

    def search(start: int, stop: int) -> None:
        _search(start, stop, sorted_points, order, axes, indices, distances)

    in_pieces(count, search, progress=progress.part(BUILD_SHARE, 1.0), piece=SEARCHES)
    return indices, distances


@inline
def select(points, order, start, stop, middle, axis):
    """Partly sorts order[start:stop] along an axis: points before `middle` are not greater (Hoare)."""
    low, high = start, stop - 1
    while low < high:
        pivot = points[order[(low + high) // 2], axis]
        i, j = low, high
        while i <= j:
            while points[order[i], axis] < pivot:
                i += 1
            while points[order[j], axis] > pivot:
                j -= 1
            if i <= j:
                order[i], order[j] = order[j], order[i]
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@kernel
def _build(points, order, axes):
    """Reorders `order` (M,) so that the middle of every run splits it; axes[middle] says along what."""
    starts, stops = np.empty(DEPTH, np.int64), np.empty(DEPTH, np.int64)
    starts[0], stops[0], waiting = 0, len(order), 1
    while waiting > 0:
        waiting -= 1
        start, stop = starts[waiting], stops[waiting]
        if stop - start <= LEAF:
            continue
        axis, widest = 0, -1.0
        for k in range(3):
            least, greatest = np.inf, -np.inf
            for i in range(start, stop):
                value = points[order[i], k]
                least, greatest = min(least, value), max(greatest, value)
            if greatest - least > widest:
                axis, widest = k, greatest - least
        middle = (start + stop) // 2
        select(points, order, start, stop, middle, axis)
        axes[middle] = axis
        starts[waiting], stops[waiting] = start, middle
        starts[waiting + 1], stops[waiting + 1] = middle + 1, stop
        waiting += 2


@inline
def consider(points, here, other, found, squares):
    """Enters place `other` into `found`, ascending by `squares`, if it belongs there."""
    if other == here:
        return
    dx = points[here, 0] - points[other, 0]
    dy = points[here, 1] - points[other, 1]
    dz = points[here, 2] - points[other, 2]
    square = dx * dx + dy * dy + dz * dz
    at = len(squares) - 1
    if not square < squares[at]:
        return
    while at > 0 and squares[at - 1] > square:
        squares[at], found[at] = squares[at - 1], found[at - 1]
        at -= 1
    squares[at], found[at] = square, other


@kernel
def _search(start, stop, points, order, axes, indices, distances):
    """The neighbours of the points at places start to stop of the tree; `points` are in its order."""
    k = indices.shape[1]
    squares, found = np.empty(k), np.empty(k, np.int64)
    starts, stops, gaps = np.empty(DEPTH, np.int64), np.empty(DEPTH, np.int64), np.empty(DEPTH)
    for here in range(start, stop):
        squares[:] = np.inf
        found[:] = -1
        starts[0], stops[0], gaps[0], waiting = 0, len(order), 0.0, 1
        while waiting > 0:
            waiting -= 1
            low, high = starts[waiting], stops[waiting]
            if not gaps[waiting] < squares[k - 1]:
                continue
            if high - low <= LEAF:
                for other in range(low, high):
                    consider(points, here, other, found, squares)
                continue
            middle = (low + high) // 2
            consider(points, here, middle, found, squares)
            beyond = points[here, axes[middle]] - points[middle, axes[middle]]
            left_first = beyond < 0
            # The nearer side is taken first, so it is put down last.
            starts[waiting] = middle + 1 if left_first else low
            stops[waiting] = high if left_first else middle
            gaps[waiting] = beyond * beyond
            waiting += 1
            starts[waiting] = low if left_first else middle + 1
            stops[waiting] = middle if left_first else high
            gaps[waiting] = 0.0
            waiting += 1
        own = order[here]
        for j in range(k):
            if found[j] >= 0:
                indices[own, j] = order[found[j]]
                distances[own, j] = np.sqrt(squares[j])
