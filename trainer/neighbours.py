"""Distances to the nearest neighbours of every point: a k-d tree in one array, exact for any spread."""

from __future__ import annotations

import numpy as np

from ..raster import available_threads
from ..raster.compiling import inline, kernel
from ..raster.pool import SPLATS_PER_TASK, TASKS_PER_THREAD, even_ranges, run

LEAF = 8
"""Points that are compared one by one rather than split further."""

DEPTH = 64
"""Nodes that wait at once: two a level, and halving 2³¹ points takes 31 levels."""


def mean_square_distance(
    points: np.ndarray, *, neighbours: int = 3, threads: int | None = None
) -> np.ndarray:
    """(N,) float64: the mean squared distance of each of points (N, 3) to its nearest others.

    Points all finite. Where there are fewer others, the mean is over those; a lone point has 0.
    """
    points = np.ascontiguousarray(points, np.float64)
    count, threads = len(points), threads or available_threads()
    neighbours = min(neighbours, count - 1)
    result = np.zeros(count)
    if neighbours < 1:
        return result
    order = np.arange(count, dtype=np.int32)
    axes = np.zeros(count, np.int8)
    build_tree(points, order, axes)
    tasks = even_ranges(count, threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
    run(search, tasks, (points, order, axes, neighbours, result), threads)
    return result


@inline
def select(points, order, start, stop, middle, axis):
    """Partly sorts order[start:stop] along an axis: what is before `middle` is not greater (Hoare)."""
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
def build_tree(points, order, axes):
    """Reorders `order` (N,) so that the middle of every run splits it; axes[middle] says along what."""
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
def consider(points, here, other, nearest):
    """Enters a point's squared distance into `nearest`, ascending, if it belongs there."""
    dx = points[here, 0] - points[other, 0]
    dy = points[here, 1] - points[other, 1]
    dz = points[here, 2] - points[other, 2]
    square = dx * dx + dy * dy + dz * dz
    at = len(nearest) - 1
    if other == here or not square < nearest[at]:
        return
    while at > 0 and nearest[at - 1] > square:
        nearest[at] = nearest[at - 1]
        at -= 1
    nearest[at] = square


@kernel
def search(start, stop, points, order, axes, neighbours, result):
    """Mean squared distances of the points at order[start:stop] to their nearest `neighbours`."""
    nearest = np.empty(neighbours)
    starts, stops, gaps = np.empty(DEPTH, np.int64), np.empty(DEPTH, np.int64), np.empty(DEPTH)
    for number in range(start, stop):
        here = order[number]
        nearest[:] = np.inf
        starts[0], stops[0], gaps[0], waiting = 0, len(order), 0.0, 1
        while waiting > 0:
            waiting -= 1
            low, high = starts[waiting], stops[waiting]
            if not gaps[waiting] < nearest[neighbours - 1]:
                continue
            if high - low <= LEAF:
                for i in range(low, high):
                    consider(points, here, order[i], nearest)
                continue
            middle = (low + high) // 2
            split = order[middle]
            consider(points, here, split, nearest)
            beyond = points[here, axes[middle]] - points[split, axes[middle]]
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
        result[here] = nearest.mean()
