"""Lists of splats by 16x16 tile, in depth order: made by counting, without a second sort.

A splat belongs to a tile when its ellipse, the set where its alpha is at least the cut, meets the box
of the tile's pixel centres. For a row of tiles the ellipse leaves an interval of x: convex sets meet so,
which makes the test of the whole row two square roots, and exact. The ellipse is drawn a hair larger
(MARGIN) than it is, as the pixels' alphas are computed in float32.

These intervals, the spans, are found once, in the order of the splats in memory. Then the depth order is
cut into pieces; each piece counts its pairs per tile; the sums of the counts over earlier tiles and
earlier pieces are where it writes. So lists come out in depth order whatever the number of pieces.

Dropped: to count and write in the order of memory, and to sort each tile's pairs by depth, which needs no
order of all splats. Sorting and binning took 51 in place of 53 ms of processor time for `playbot` (two pairs
per splat), and 29 in place of 16 ms for `skull` (seven). Nor do one-row boxes gain by leaving out the
ellipse: these loops wait for memory.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.parameters import TILE
from splatview.raster.project import LOG2_OPACITY, RX, RY, A, B, C, X, Y
from splatview.raster.simd import prefetch

MARGIN = 2e-3
"""Enlargement of the ellipse, relative and in powers of two of alpha."""

AHEAD = 8
"""Splats by which memory is prefetched, where splats are taken in depth order: that is any order in memory,
and the processor cannot guess ahead where loops are as short as here."""


@inline
def ask_ahead(k, stop, order, spans_of, spans):
    """Asks for the spans of the splats that follow order[k], before `stop`."""
    if k + 2 * AHEAD < stop:
        prefetch(spans_of, order[k + 2 * AHEAD])
        prefetch(spans, spans_of[order[k + AHEAD], 0])


@inline
def tile_interval(centre, half):
    """First and last row or column of tiles, however far outside the image, whose pixel centres meet
    centre ± half (px), enlarged; first > last where none does. Of float64: whole numbers of 64 bits end at
    1e20 px."""
    half = half * (1 + MARGIN) + MARGIN
    return np.ceil((centre - half - (TILE - 0.5)) / TILE), np.floor((centre + half - 0.5) / TILE)


@inline
def tile_rows(record, tiles_y):
    """First and last row of tiles in the image that a splat's box meets; first > last where none."""
    first, last = tile_interval(np.float64(record[Y]), np.float64(record[RY]))
    return np.int64(max(first, 0.0)), np.int64(min(last, tiles_y - 1.0))


@inline
def ellipse(record, log2_cut, log2_share):
    """What `tile_span` needs of a splat, float64: x, y, then a, b, c, the bound of (a·dx + b·dy)² + (c·dy)²,
    the half extent in y and the dy at which the ellipse is farthest right."""
    a, b, c = np.float64(record[A]), np.float64(record[B]), np.float64(record[C])
    bound = min(np.float64(record[LOG2_OPACITY]) - log2_cut, -log2_share) * (1 + MARGIN) + MARGIN
    root = math.sqrt(bound)
    slope = b / c
    return (
        np.float64(record[X]),
        np.float64(record[Y]),
        a,
        b,
        c,
        bound,
        root / c,
        -slope * root / (math.sqrt(1 + slope * slope) * c),
    )


@inline
def tile_span(shape, row, tiles_x):
    """First and last tile of a row that the ellipse meets; first > last where none."""
    x, y, a, b, c, bound, ry, dy_right = shape
    low = max(row * TILE + 0.5 - y, -ry)
    high = min(row * TILE + (TILE - 0.5) - y, ry)
    # Farthest right and left within the rows low..high, at the ellipse's own extreme where that is inside.
    at_right, at_left = min(max(dy_right, low), high), min(max(-dy_right, low), high)
    right = x + (math.sqrt(max(bound - c * c * at_right * at_right, 0.0)) - b * at_right) / a
    left = x - (math.sqrt(max(bound - c * c * at_left * at_left, 0.0)) + b * at_left) / a
    first = max(np.ceil((left - (TILE - 0.5) - MARGIN) / TILE), 0.0)
    last = min(np.floor((right - 0.5 + MARGIN) / TILE), tiles_x - 1.0)
    return np.int64(first), np.int64(last)


@kernel
def count_rows(start, stop, visible, records, tiles_y):
    """How many spans the splats visible[start:stop] can have at most: the sum of their boxes' tile rows."""
    total = 0
    for k in range(start, stop):
        first, last = tile_rows(records[visible[k]], tiles_y)
        total += max(last - first + 1, 0)
    return total


@kernel
def find_spans(start, stop, first_span, visible, records, view, spans, spans_of):
    """Finds the runs of tiles that the splats visible[start:stop] meet.

    spans (S, 2) int32 receives first and one past the last tile, from row `first_span` on; spans_of
    (N, 2) int32 first and one past the last span of each splat. records (N, RECORD).
    """
    at = first_span
    for k in range(start, stop):
        splat = visible[k]
        record = records[splat]
        spans_of[splat, 0] = at
        first_row, last_row = tile_rows(record, view.tiles_y)
        first, last = tile_interval(np.float64(record[X]), np.float64(record[RX]))
        if first >= last:  # in one column of tiles the box says all
            if first == last and first >= 0 and last < view.tiles_x:
                for row in range(first_row, last_row + 1):
                    spans[at, 0] = row * view.tiles_x + np.int64(first)
                    spans[at, 1] = spans[at, 0] + 1
                    at += 1
        else:
            shape = ellipse(record, view.log2_cut, view.log2_share)
            for row in range(first_row, last_row + 1):
                left, right = tile_span(shape, row, view.tiles_x)
                if left <= right:
                    spans[at, 0] = row * view.tiles_x + left
                    spans[at, 1] = row * view.tiles_x + right + 1
                    at += 1
        spans_of[splat, 1] = at


@kernel
def count_pairs(start, stop, counts, order, spans_of, spans):
    """Counts the pairs of order[start:stop] by tile: counts (tiles,) int64 is overwritten."""
    counts[:] = 0
    for k in range(start, stop):
        ask_ahead(k, stop, order, spans_of, spans)
        splat = order[k]
        for span in range(spans_of[splat, 0], spans_of[splat, 1]):
            for tile in range(spans[span, 0], spans[span, 1]):
                counts[tile] += 1


@kernel
def place_lists(counts, offsets):
    """Turns counts (pieces, tiles) int64 into where each piece's part of each tile's list begins, and
    writes where the lists begin and end: offsets (tiles + 1,) int64."""
    total = 0
    for tile in range(counts.shape[1]):
        offsets[tile] = total
        for piece in range(counts.shape[0]):
            count = counts[piece, tile]
            counts[piece, tile] = total
            total += count
    offsets[counts.shape[1]] = total


@kernel
def write_pairs(start, stop, positions, order, spans_of, spans, first_tile, end_tile, base, lists):
    """Writes the splats order[start:stop] into the lists of tiles [first_tile, end_tile): lists (pairs,)
    int32, of which place `base` is the first. positions (tiles,) int64 says where each list goes on, and
    ends up behind the last entry."""
    for k in range(start, stop):
        ask_ahead(k, stop, order, spans_of, spans)
        splat = order[k]
        for span in range(spans_of[splat, 0], spans_of[splat, 1]):
            for tile in range(max(spans[span, 0], first_tile), min(spans[span, 1], end_tile)):
                lists[positions[tile] - base] = splat
                positions[tile] += 1
