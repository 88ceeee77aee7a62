"""Neighbourhoods and clusters of points, by a grid so fine that all points of one cell are near each other.

A cell's diagonal is the distance asked for, so within a cell nothing has to be compared, however many
points lie there; between two cells one pair that is close enough settles it (Gunawan 2013). Cells are
sorted by x, y, z: the five neighbours along z of a cell lie in a row, and rows are found by walking along.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatview.edit.kernels.compiling import inline, kernel
from splatview.scene.progress import NO_PROGRESS, Progress

SHRUNK = 0.999999
"""A cell's diagonal relative to the distance: a little less, so that rounding never joins points further
apart."""

NEAR_CELLS = 2
"""Cells along an axis to the furthest neighbours: ceil(sqrt 3)."""

FURTHEST_CELL = 2.0**50
"""Greatest cell coordinate: beyond it coordinates have no digits left for a distance, and points no
neighbours."""

CELLS_AT_ONCE = 1 << 15


class Cells(NamedTuple):
    """The cells that hold points, ascending."""

    corners: np.ndarray
    """(C, 3) int64, cell coordinates; gaps are narrowed, which changes no neighbourhood."""
    offsets: np.ndarray
    """(C + 1,) int64: where each cell's points begin in `order`."""
    order: np.ndarray
    """(P,) int64, indices of points; those without a place in the grid are left out."""
    points: np.ndarray
    """(P, 3) float64 in that order."""


def make_cells(points: np.ndarray, distance: float) -> Cells:
    """The cells of `points` (M, 3) float64 for `distance` > 0, world units."""
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = np.floor(points * (np.sqrt(3) / (distance * SHRUNK)))
        usable = np.flatnonzero((np.abs(scaled) < FURTHEST_CELL).all(axis=1))
    corners = scaled[usable].astype(np.int64)
    for axis in range(3):
        corners[:, axis] = _narrowed(corners[:, axis])
    order = _sorted(corners)
    corners = corners[order]
    new = np.ones(len(order), bool)
    new[1:] = (corners[1:] != corners[:-1]).any(axis=1)
    starts = np.flatnonzero(new)
    offsets = np.append(starts, len(order))
    order = usable[order]
    return Cells(np.ascontiguousarray(corners[starts]), offsets, order, np.ascontiguousarray(points[order]))


def _narrowed(coordinates: np.ndarray) -> np.ndarray:
    """The same order and the same differences up to NEAR_CELLS, with larger ones made NEAR_CELLS + 1."""
    if not len(coordinates):
        return coordinates
    low, high = int(coordinates.min()), int(coordinates.max())
    if high - low <= 1 << 20:
        return coordinates - low
    values, inverse = np.unique(coordinates, return_inverse=True)
    steps = np.minimum(np.diff(values, prepend=values[0]), NEAR_CELLS + 1)
    return np.cumsum(steps)[inverse]


def _sorted(corners: np.ndarray) -> np.ndarray:
    """Indices that sort `corners` (P, 3), each at least 0, by x, y, z."""
    if not len(corners):
        return np.empty(0, np.int64)
    ranges = corners.max(axis=0) + 1
    if float(ranges[0]) * float(ranges[1]) * float(ranges[2]) < 2.0**62:
        return np.argsort((corners[:, 0] * ranges[1] + corners[:, 1]) * ranges[2] + corners[:, 2])
    return np.lexsort((corners[:, 2], corners[:, 1], corners[:, 0]))


def components(points: np.ndarray, distance: float, progress: Progress = NO_PROGRESS) -> np.ndarray:
    """Cluster labels of `points` (M, 3) float64: (M,) int32, 0 upwards.

    Two points are in one cluster where steps of at most `distance` > 0 lead from one to the other.
    Points that are not finite are alone. Raises Cancelled.
    """
    cells = make_cells(points, distance)
    parents = np.arange(len(cells.corners), dtype=np.int64)
    for start in range(0, len(parents), CELLS_AT_ONCE):
        progress.step(start / len(parents))
        _join(start, min(start + CELLS_AT_ONCE, len(parents)), cells, distance * distance, parents)
    progress.step(1.0)
    roots = _roots(parents)
    _, of_cell = np.unique(roots, return_inverse=True)
    labels = np.full(len(points), -1, np.int32)
    labels[cells.order] = np.repeat(of_cell, np.diff(cells.offsets))
    alone = np.flatnonzero(labels < 0)
    labels[alone] = np.arange(len(alone), dtype=np.int32) + (int(of_cell.max()) + 1 if len(of_cell) else 0)
    return labels


def within(
    points: np.ndarray, sources: np.ndarray, distance: float, progress: Progress = NO_PROGRESS
) -> np.ndarray:
    """Whether each of `points` (M, 3) float64 is at most `distance` from one of those in `sources` (M,) bool,
    these included: (M,) bool. Raises Cancelled."""
    cells = make_cells(points, distance)
    is_source = np.ascontiguousarray(sources[cells.order])
    near = is_source.copy()
    for start in range(0, len(cells.corners), CELLS_AT_ONCE):
        progress.step(start / len(cells.corners))
        stop = min(start + CELLS_AT_ONCE, len(cells.corners))
        _spread(start, stop, cells, distance * distance, is_source, near)
    progress.step(1.0)
    result = sources.copy()
    result[cells.order] |= near
    return result


@inline
def before(corners, at, x, y, z):
    """Whether a cell is before (x, y, z)."""
    cx, cy, cz = corners[at, 0], corners[at, 1], corners[at, 2]
    return cx < x or (cx == x and (cy < y or (cy == y and cz < z)))


@inline
def lower_bound(corners, x, y, z):
    """The first cell that is not before (x, y, z)."""
    low, high = 0, len(corners)
    while low < high:
        middle = (low + high) // 2
        if before(corners, middle, x, y, z):
            low = middle + 1
        else:
            high = middle
    return low


@inline
def advance(corners, at, x, y, z):
    """As `lower_bound`, walking on from `at`, which is not behind it."""
    while at < len(corners) and before(corners, at, x, y, z):
        at += 1
    return at


@inline
def root(parents, i):
    """The root of a disjoint set's tree; halves the path to it."""
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@inline
def gap(corners, a, b):
    """Squared least distance between two cells, in sides of a cell."""
    total = 0
    for axis in range(3):
        apart = max(abs(corners[a, axis] - corners[b, axis]) - 1, 0)
        total += apart * apart
    return total


@inline
def touching(cells, a, b, square):
    """Whether some point of cell a is within sqrt(square) of one of cell b."""
    points = cells.points
    for i in range(cells.offsets[a], cells.offsets[a + 1]):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        for j in range(cells.offsets[b], cells.offsets[b + 1]):
            dx, dy, dz = points[j, 0] - x, points[j, 1] - y, points[j, 2] - z
            if dx * dx + dy * dy + dz * dz <= square:
                return True
    return False


@kernel
def _join(start, stop, cells, square, parents):
    """Joins the cells start to stop with those after them that they touch."""
    corners = cells.corners
    for dx in range(NEAR_CELLS + 1):
        for dy in range(-NEAR_CELLS if dx > 0 else 0, NEAR_CELLS + 1):
            first_dz = 1 if dx == 0 and dy == 0 else -NEAR_CELLS
            at = lower_bound(
                corners, corners[start, 0] + dx, corners[start, 1] + dy, corners[start, 2] + first_dz
            )
            for a in range(start, stop):
                x, y, z = corners[a, 0] + dx, corners[a, 1] + dy, corners[a, 2]
                at = advance(corners, at, x, y, z + first_dz)
                b = at
                while b < len(corners) and corners[b, 0] == x and corners[b, 1] == y:
                    if corners[b, 2] > z + NEAR_CELLS:
                        break
                    if gap(corners, a, b) < 3:
                        root_a, root_b = root(parents, a), root(parents, b)
                        if root_a != root_b and touching(cells, a, b, square):
                            parents[max(root_a, root_b)] = min(root_a, root_b)
                    b += 1


@kernel
def _roots(parents):
    roots = np.empty_like(parents)
    for cell in range(len(parents)):
        roots[cell] = root(parents, cell)
    return roots


@kernel
def _spread(start, stop, cells, square, is_source, near):
    """Sets `near` (P,) for points of the cells start to stop that are near a source."""
    corners, offsets, points = cells.corners, cells.offsets, cells.points
    for dx in range(-NEAR_CELLS, NEAR_CELLS + 1):
        for dy in range(-NEAR_CELLS, NEAR_CELLS + 1):
            at = lower_bound(
                corners, corners[start, 0] + dx, corners[start, 1] + dy, corners[start, 2] - NEAR_CELLS
            )
            for a in range(start, stop):
                x, y, z = corners[a, 0] + dx, corners[a, 1] + dy, corners[a, 2]
                at = advance(corners, at, x, y, z - NEAR_CELLS)
                b = at
                while b < len(corners) and corners[b, 0] == x and corners[b, 1] == y:
                    if corners[b, 2] > z + NEAR_CELLS:
                        break
                    if gap(corners, a, b) < 3:
                        for j in range(offsets[b], offsets[b + 1]):
                            if not is_source[j]:
                                continue
                            for i in range(offsets[a], offsets[a + 1]):
                                if not near[i]:
                                    ox = points[i, 0] - points[j, 0]
                                    oy = points[i, 1] - points[j, 1]
                                    oz = points[i, 2] - points[j, 2]
                                    near[i] = a == b or ox * ox + oy * oy + oz * oz <= square
                            if a == b:
                                break
                    b += 1


@kernel
def linked(neighbours, distances, radii):
    """Cluster labels (M,) int64 of points linked to their nearest neighbours: the least index of the cluster.

    Point i and its neighbour j, of neighbours (M, k) int32, are linked where their distance is at most the
    lesser of radii[i] and radii[j].
    """
    parents = np.arange(len(neighbours))
    for i in range(len(neighbours)):
        for column in range(neighbours.shape[1]):
            j = neighbours[i, column]
            if j >= 0 and distances[i, column] <= min(radii[i], radii[j]):
                a, b = root(parents, i), root(parents, j)
                if a != b:
                    parents[max(a, b)] = min(a, b)
    for i in range(len(parents)):
        parents[i] = root(parents, i)
    return parents
