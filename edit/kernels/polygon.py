"""Points of a picture in a polygon or under a brush: exact, and looking only at edges nearby."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splatview.edit.kernels.compiling import inline, kernel

ROWS_PER_EDGE = 4
MOST_ROWS = 4096
"""Most rows that a polygon's height is cut into; a point looks only at the edges that cross its own."""

CELLS_ACROSS = 256
"""Most cells per side that the bounds are cut into. All points of a cell that no border crosses get one
answer, found once."""

CELLS_PER_RADIUS = 8

OUTSIDE, INSIDE, CROSSED = 0, 1, 2
"""States of a cell."""

SLACK = 1e-6
"""Margin, in cells, within which a border counts as crossing a cell, so that rounding never decides."""


class Polygon(NamedTuple):
    """A closed polygon, its edges listed by row. Points that it winds around at least once are inside."""

    points: np.ndarray
    """(V, 2) float64, px; the last joins the first."""
    low: float
    per_row: float
    """Row of y: int((y - low) · per_row)."""
    offsets: np.ndarray
    """(rows + 1,) int64: where each row's edges begin in `edges`."""
    edges: np.ndarray
    """int32: edge i goes from point i to the next."""
    left: float
    per_column: float
    """Column of x: int((x - left) · per_column)."""
    per_line: float
    """Line of y: int((y - low) · per_line)."""
    states: np.ndarray
    """(CELLS_ACROSS + 1,) squared, uint8, by line and column."""


def make_polygon(points: np.ndarray) -> Polygon:
    """`points` (V, 2), V at least 3, finite."""
    points = np.ascontiguousarray(points, np.float64)
    low, high = float(points[:, 1].min()), float(points[:, 1].max())
    rows = min(ROWS_PER_EDGE * len(points), MOST_ROWS)
    # Rounding is monotone, so a point between an edge's ends is in a row between theirs.
    per_row = rows / (high - low) if high > low and math.isfinite(rows / (high - low)) else 0.0
    bins = ((points[:, 1] - low) * per_row).astype(np.int64).clip(0, rows - 1)
    following = np.roll(bins, -1)
    first, last = np.minimum(bins, following), np.maximum(bins, following)
    lengths = last - first + 1
    edge = np.repeat(np.arange(len(points), dtype=np.int32), lengths)
    row = np.arange(len(edge)) - np.repeat(np.cumsum(lengths) - lengths, lengths) + first[edge]
    offsets = np.zeros(rows + 1, np.int64)
    np.cumsum(np.bincount(row, minlength=rows), out=offsets[1:])
    left, right = float(points[:, 0].min()), float(points[:, 0].max())
    polygon = Polygon(
        points,
        low,
        per_row,
        offsets,
        edge[np.argsort(row, kind="stable")],
        left,
        _per_unit(right - left),
        _per_unit(high - low),
        np.zeros((CELLS_ACROSS + 1, CELLS_ACROSS + 1), np.uint8),
    )
    _find_states(polygon)
    return polygon


def _per_unit(length: float) -> float:
    """Cells a unit; 0, which puts all in one cell, where the length is too small to be cut."""
    return CELLS_ACROSS / length if length > 0 and math.isfinite(CELLS_ACROSS / length) else 0.0


@inline
def winding(polygon, x, y):
    """How often the polygon turns about (x, y), which lies in its bounds (Sunday 2001)."""
    row = min(int((y - polygon.low) * polygon.per_row), len(polygon.offsets) - 2)
    turns = 0
    for k in range(polygon.offsets[row], polygon.offsets[row + 1]):
        a = polygon.edges[k]
        b = a + 1 if a + 1 < len(polygon.points) else 0
        ax, ay = polygon.points[a, 0], polygon.points[a, 1]
        bx, by = polygon.points[b, 0], polygon.points[b, 1]
        side = (bx - ax) * (y - ay) - (x - ax) * (by - ay)
        if ay <= y < by and side > 0:
            turns += 1
        elif by <= y < ay and side < 0:
            turns -= 1
    return turns


@kernel
def _find_states(polygon):
    """Marks the cells that edges cross; of the others, each has one answer, that of its centre."""
    points, states = polygon.points, polygon.states
    last = len(states) - 1
    for a in range(len(points)):
        b = a + 1 if a + 1 < len(points) else 0
        x0, y0 = (
            (points[a, 0] - polygon.left) * polygon.per_column,
            (points[a, 1] - polygon.low) * polygon.per_line,
        )
        x1, y1 = (
            (points[b, 0] - polygon.left) * polygon.per_column,
            (points[b, 1] - polygon.low) * polygon.per_line,
        )
        if y0 > y1:
            x0, y0, x1, y1 = x1, y1, x0, y0
        for line in range(max(int(y0 - SLACK), 0), min(int(y1 + SLACK), last) + 1):
            # Where the edge enters and leaves this line of cells.
            enter, leave = x0, x1
            if y1 - y0 > SLACK:
                slope = (x1 - x0) / (y1 - y0)
                enter = x0 + (min(max(line - SLACK, y0), y1) - y0) * slope
                leave = x0 + (min(max(line + 1 + SLACK, y0), y1) - y0) * slope
            first, stop = min(enter, leave) - SLACK, max(enter, leave) + SLACK
            for column in range(max(int(first), 0), min(int(stop), last) + 1):
                states[line, column] = CROSSED
    if polygon.per_column == 0 or polygon.per_line == 0:
        states[:] = CROSSED
        return
    for line in range(last):
        for column in range(last):
            if states[line, column] != CROSSED:
                x = polygon.left + (column + 0.5) / polygon.per_column
                y = polygon.low + (line + 0.5) / polygon.per_line
                states[line, column] = INSIDE if winding(polygon, x, y) != 0 else OUTSIDE
    # The far borders themselves: few points are on them.
    states[last, :] = CROSSED
    states[:, last] = CROSSED


@kernel
def in_polygon(points, bounds, polygon, inside):
    """inside (P,) bool of points (P, 2); `bounds` (4,): least x, y, greatest x, y. NaN is not inside."""
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        inside[i] = False
        if (bounds[0] <= x) & (x <= bounds[2]) & (bounds[1] <= y) & (y <= bounds[3]):
            column = int((x - polygon.left) * polygon.per_column)
            line = int((y - polygon.low) * polygon.per_line)
            state = polygon.states[line, column]
            inside[i] = winding(polygon, x, y) != 0 if state == CROSSED else state == INSIDE


@kernel
def in_rectangle(points, bounds, inside):
    """Whether points are within the bounds, as `in_polygon`; the border belongs to it."""
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        inside[i] = (bounds[0] <= x) & (x <= bounds[2]) & (bounds[1] <= y) & (y <= bounds[3])


class Stroke(NamedTuple):
    """A round brush drawn along a line of points, its segments listed by cell."""

    points: np.ndarray
    """(V, 2) float64, px; segment i goes from point i to i + 1, of a single point to itself."""
    radius: float
    left: float
    top: float
    cell: float
    columns: int
    rows: int
    offsets: np.ndarray
    """(rows·columns + 1,) int64: where each cell's segments begin in `segments`."""
    segments: np.ndarray
    """int32."""
    full: np.ndarray
    """(rows·columns,) bool: cells covered by one segment as a whole."""


def make_stroke(points: np.ndarray, radius: float) -> Stroke:
    """`points` (V, 2), V at least 1, finite; `radius` > 0, px."""
    points = np.ascontiguousarray(points, np.float64)
    if len(points) == 1:
        points = np.repeat(points, 2, axis=0)
    left, top = points.min(axis=0) - radius
    width, height = points.max(axis=0) + radius - (left, top)
    cell = max(radius / CELLS_PER_RADIUS, width / CELLS_ACROSS, height / CELLS_ACROSS)
    columns, rows = math.ceil(width / cell) + 1, math.ceil(height / cell) + 1
    counts = np.zeros(rows * columns + 1, np.int64)
    empty = np.empty(0, np.int32)
    full = np.zeros(rows * columns, bool)
    stroke = Stroke(points, radius, left, top, cell, columns, rows, counts, empty, full)
    _list_segments(stroke, counts[1:], empty, False)
    offsets = np.cumsum(counts)
    segments = np.empty(offsets[-1], np.int32)
    _list_segments(stroke, offsets[:-1].copy(), segments, True)
    return stroke._replace(offsets=offsets, segments=segments)


@inline
def squared_distance(stroke, segment, x, y):
    """From (x, y) to a segment, px²."""
    ax, ay = stroke.points[segment, 0], stroke.points[segment, 1]
    dx, dy = stroke.points[segment + 1, 0] - ax, stroke.points[segment + 1, 1] - ay
    length = dx * dx + dy * dy
    share = ((x - ax) * dx + (y - ay) * dy) / length if length > 0 else 0.0
    share = min(max(share, 0.0), 1.0)
    ox, oy = x - ax - share * dx, y - ay - share * dy
    return ox * ox + oy * oy


@kernel
def _list_segments(stroke, cursors, segments, write):
    """Lists, or only counts, for each cell the segments within a radius of any of its points."""
    half_diagonal = stroke.cell * (0.5 * math.sqrt(2.0) + SLACK)
    radius = stroke.radius + half_diagonal
    sure = max(stroke.radius - half_diagonal, 0.0)
    for s in range(len(stroke.points) - 1):
        x0 = min(stroke.points[s, 0], stroke.points[s + 1, 0]) - stroke.radius - stroke.left
        x1 = max(stroke.points[s, 0], stroke.points[s + 1, 0]) + stroke.radius - stroke.left
        y0 = min(stroke.points[s, 1], stroke.points[s + 1, 1]) - stroke.radius - stroke.top
        y1 = max(stroke.points[s, 1], stroke.points[s + 1, 1]) + stroke.radius - stroke.top
        for row in range(max(int(y0 / stroke.cell), 0), min(int(y1 / stroke.cell), stroke.rows - 1) + 1):
            for column in range(
                max(int(x0 / stroke.cell), 0), min(int(x1 / stroke.cell), stroke.columns - 1) + 1
            ):
                x = stroke.left + (column + 0.5) * stroke.cell
                y = stroke.top + (row + 0.5) * stroke.cell
                square = squared_distance(stroke, s, x, y)
                if square <= radius * radius:
                    cell = row * stroke.columns + column
                    if square < sure * sure:
                        stroke.full[cell] = True
                    if write:
                        segments[cursors[cell]] = s
                    cursors[cell] += 1


@kernel
def in_stroke(points, stroke, inside):
    """Whether points are within a stroke, as `in_polygon`; its border belongs to it."""
    for i in range(len(points)):
        inside[i] = False
        x, y = points[i, 0], points[i, 1]
        column, row = (x - stroke.left) / stroke.cell, (y - stroke.top) / stroke.cell
        if (0 <= column < stroke.columns) & (0 <= row < stroke.rows):
            cell = int(row) * stroke.columns + int(column)
            if stroke.full[cell]:
                inside[i] = True
                continue
            for k in range(stroke.offsets[cell], stroke.offsets[cell + 1]):
                if squared_distance(stroke, stroke.segments[k], x, y) <= stroke.radius * stroke.radius:
                    inside[i] = True
                    break
