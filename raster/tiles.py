"""Lists of splats by 16x16 tile, in depth order: made by counting, without a second sort.

A splat belongs to a tile when its ellipse, the set where its alpha is at least the cut, meets the box
of the tile's pixel centres. For a row of tiles the ellipse leaves an interval of x: convex sets meet so,
which makes the test of the whole row two square roots, and exact. The ellipse is drawn a hair larger
(MARGIN) than it is, as the pixels' alphas are computed in float32.

These intervals, the spans, are found once, LANES splats at a time in the order of memory. Then the depth
order is cut into pieces; each piece counts its pairs per tile; the sums of the counts over earlier tiles and
earlier pieces are where it writes. So lists come out in depth order whatever the number of pieces.

Most splats have one or two spans of one or two tiles, and which it is cannot be guessed: loops over them
spend most of their time on wrong guesses. So the tiles of many splats are first put into one list, whole
vectors at a time of which only the beginning counts, and the list is worked off in one loop.

Dropped: to count and write in the order of memory, and to sort each tile's pairs by depth, which needs no
order of all splats. Sorting and binning took 51 in place of 53 ms of processor time for `playbot` (two pairs
per splat), and 29 in place of 16 ms for `skull` (seven). Nor to keep a splat's only span in its own row, and
copies of rows in depth order, for memory to be read in any order once: counting 500,000 splats took 15 in
place of 11 ms, by one more guess.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.parameters import TILE
from splatview.raster.project import (
    LOG2_OPACITY,
    MARGIN,
    RECORD,
    RX,
    A,
    B,
    C,
    X,
    Y,
    column,
    lane_sum,
    tile_interval,
    tile_rows,
)
from splatview.raster.simd import (
    LANES,
    aligned,
    ceil,
    fill,
    floor,
    greatest_lane,
    keep_if_at_least,
    keep_if_below,
    load,
    maximum,
    minimum,
    prefetch,
    store_int,
    store_run,
    store_same,
    widened,
)
from splatview.raster.transpose import load_rows

AHEAD = 8
"""Splats by which memory is prefetched, where splats are taken in depth order: that is any order in memory,
and the processor cannot guess ahead where loops are as short as here."""


WAITING = 1024
"""Pairs that are listed before they are worked off."""

UNGUESSED = 2
"""Spans of each splat that are taken without asking whether it has them."""

SPARE = 2
"""Rows of `spans` that may be written behind those of each piece, and read behind all."""


@inline
def span_at(row, number, count, spans, first_tile, end_tile):
    """First tile and length, 0 beyond `count`, of row `row` + `number` of `spans`, as far as it is in
    [first_tile, end_tile)."""
    first, end = max(spans[row + number, 0], first_tile), min(spans[row + number, 1], end_tile)
    return first, max(end - first, 0) * (number < count)


@inline
def ellipses(rows, log2_cut, log2_share):
    """What `tile_span` needs of LANES splats, float64 lanes: x, y, then a, b, c, the bound of
    (a·dx + b·dy)² + (c·dy)², the half extent in y and the dy at which the ellipse is farthest right."""
    a, b, c = widened(column(rows, A)), widened(column(rows, B)), widened(column(rows, C))
    log2_opacity = widened(column(rows, LOG2_OPACITY))
    bound = minimum(log2_opacity - log2_cut, fill(a, -log2_share)) * (1 + MARGIN) + MARGIN
    root, slope, by_c = math.sqrt(bound), b / c, 1.0 / c
    dy_right = -(slope * root * by_c) / math.sqrt(1 + slope * slope)
    x, y = widened(column(rows, X)), widened(column(rows, Y))
    return x, y, a, b, c, bound, root * by_c, dy_right


@inline
def tile_span(shapes, row, tiles_x):
    """First and last tile of a row, lane by lane, that the ellipses meet; first > last where none. All of the
    row where the arithmetic overflows."""
    x, y, a, b, c, bound, ry, dy_right = shapes
    low, high = row * TILE + 0.5 - y, row * TILE + (TILE - 0.5) - y
    low, high = maximum(low, -ry), minimum(high, ry)
    # Farthest right and left within the rows low..high, at the ellipse's own extreme where that is inside.
    at_right = minimum(maximum(dy_right, low), high)
    at_left = minimum(maximum(-dy_right, low), high)
    nothing, inverse = fill(x, 0.0), 1.0 / a
    right = x + (math.sqrt(maximum(bound - c * c * at_right * at_right, nothing)) - b * at_right) * inverse
    left = x - (math.sqrt(maximum(bound - c * c * at_left * at_left, nothing)) + b * at_left) * inverse
    first = ceil((left - (TILE - 0.5) - MARGIN) * (1 / TILE))
    last = floor((right - 0.5 + MARGIN) * (1 / TILE))
    return clipped(first, last, tiles_x)


@inline
def clipped(first, last, tiles):
    """What there is of intervals in [0, tiles); of NaN all. Numbers that fit into int32."""
    first = minimum(maximum(first, fill(first, 0.0)), fill(first, tiles))
    return first, maximum(minimum(last, fill(last, tiles - 1)), fill(last, -1.0))


@kernel(allocates=True)
def count_spans(start, stop, visible, records, view):
    """How many rows of `spans` the splats visible[start:stop] can need."""
    rows, starts = aligned(RECORD * LANES, records.dtype), np.empty(LANES, np.int64)
    flat_records = records.reshape(-1)
    room = aligned(LANES, np.float64)
    room[:] = 0
    total = load(room, 0)
    for k in range(start, stop, LANES):
        for lane in range(LANES):  # beyond the end the last again: a few rows too many
            starts[lane] = np.int64(visible[min(k + lane, stop - 1)]) * RECORD
        load_rows(flat_records, starts, RECORD, rows, 0)
        _, met = tile_rows(rows, view.tiles_y)
        total = total + met
    return np.int64(lane_sum(total, room))


@kernel(allocates=True)
def find_spans(start, stop, first_span, visible, records, view, spans, spans_of):
    """Finds the runs of tiles that the splats visible[start:stop] meet.

    spans (S, 2) int32 receives first and one past the last tile, from row `first_span` on, SPARE rows more
    than there are spans; spans_of (N, 2) int32 each splat's first row of it and how many. records (N,
    RECORD).
    """
    rows, starts = aligned(RECORD * LANES, records.dtype), np.empty(LANES, np.int64)
    flat_records = records.reshape(-1)
    counts = np.empty(LANES, np.int32)
    # Room for the rows that are taken without asking whether there are so many.
    firsts = np.zeros(max(view.tiles_y, UNGUESSED) * LANES, np.int32)
    ends = np.zeros(max(view.tiles_y, UNGUESSED) * LANES, np.int32)
    at = first_span
    for k in range(start, stop, LANES):
        for lane in range(LANES):  # beyond the end the last again
            starts[lane] = np.int64(visible[min(k + lane, stop - 1)]) * RECORD
        load_rows(flat_records, starts, RECORD, rows, 0)
        first_row, count = tile_rows(rows, view.tiles_y)
        store_int(counts, 0, count)
        box_first, box_last = tile_interval(widened(column(rows, X)), widened(column(rows, RX)))
        wide = box_last - box_first
        box_first, box_last = clipped(box_first, box_last, view.tiles_x)
        shapes = ellipses(rows, view.log2_cut, view.log2_share)
        nothing = fill(wide, 0.0)
        for number in range(np.int64(greatest_lane(count))):
            row = first_row + number
            first, last = tile_span(shapes, row, view.tiles_x)
            # In one column of tiles the box says all.
            first = keep_if_below(first, nothing, wide) + keep_if_at_least(box_first, nothing, wide)
            last = keep_if_below(last, nothing, wide) + keep_if_at_least(box_last, nothing, wide)
            store_int(firsts, number * LANES, row * view.tiles_x + first)
            store_int(ends, number * LANES, row * view.tiles_x + last + 1)
        for lane in range(min(LANES, stop - k)):
            splat = visible[k + lane]
            begin = at
            for number in range(max(counts[lane], UNGUESSED)):
                first, end = firsts[number * LANES + lane], ends[number * LANES + lane]
                spans[at, 0] = first
                spans[at, 1] = end
                at += (first < end) & (number < counts[lane])
            spans_of[splat, 0] = begin
            spans_of[splat, 1] = at - begin


@kernel(allocates=True)
def count_pairs(start, stop, counts, order, spans_of, spans, runs):
    """Counts the pairs of order[start:stop] by tile: counts (tiles,) int64 is overwritten. runs (V, 2) int32
    receives the rows of `spans_of` in that order."""
    counts[:] = 0
    tiles = aligned(WAITING + LANES, np.int32)
    waiting = 0
    for k in range(start, stop):
        if k + 2 * AHEAD < stop:
            prefetch(spans_of, order[k + 2 * AHEAD])
            prefetch(spans, spans_of[order[k + AHEAD], 0])
        row, count = spans_of[order[k], 0], spans_of[order[k], 1]
        runs[k, 0] = row
        runs[k, 1] = count
        for number in range(max(count, UNGUESSED)):
            first, length = span_at(row, number, count, spans, 0, len(counts))
            if length > LANES or waiting + length > WAITING:
                for tile in range(first, first + length):
                    counts[tile] += 1
                continue
            store_run(tiles, waiting, first)
            waiting += length
        if waiting > WAITING - UNGUESSED * LANES:
            add_counts(tiles, waiting, counts)
            waiting = 0
    add_counts(tiles, waiting, counts)


@inline
def add_counts(tiles, waiting, counts):
    for place in range(waiting):
        counts[tiles[place]] += 1


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


@kernel(allocates=True)
def write_pairs(start, stop, positions, order, runs, spans, first_tile, end_tile, base, lists):
    """Writes the splats order[start:stop] into the lists of tiles [first_tile, end_tile): lists (pairs,)
    int32, of which place `base` is the first. positions (tiles,) int64 says where each list goes on, and
    ends up behind the last entry."""
    tiles, splats = aligned(WAITING + LANES, np.int32), aligned(WAITING + LANES, np.int32)
    waiting = 0
    for k in range(start, stop):
        if k + AHEAD < stop:
            prefetch(spans, runs[k + AHEAD, 0])
        row, count, splat = runs[k, 0], runs[k, 1], order[k]
        for number in range(max(count, UNGUESSED)):
            first, length = span_at(row, number, count, spans, first_tile, end_tile)
            if length > LANES or waiting + length > WAITING:
                append_pairs(tiles, splats, waiting, positions, base, lists)
                waiting = 0
                for tile in range(first, first + length):
                    lists[positions[tile] - base] = splat
                    positions[tile] += 1
                continue
            store_run(tiles, waiting, first)
            store_same(splats, waiting, splat)
            waiting += length
        if waiting > WAITING - UNGUESSED * LANES:
            append_pairs(tiles, splats, waiting, positions, base, lists)
            waiting = 0
    append_pairs(tiles, splats, waiting, positions, base, lists)


@inline
def append_pairs(tiles, splats, waiting, positions, base, lists):
    for place in range(waiting):
        tile = tiles[place]
        position = positions[tile]
        lists[position - base] = splats[place]
        positions[tile] = position + 1
