"""Lists of splats by 16x16 tile, in depth order: made by counting, without a second sort.

A splat belongs to a tile when its ellipse, the set where its alpha is at least the cut, meets the box
of the tile's pixel centres. For a row of tiles the ellipse leaves an interval of x: convex sets meet so,
which makes the test of the whole row two square roots, and exact. The ellipse is drawn a hair larger
(MARGIN) than it is, as the pixels' alphas are computed in float32.

The depth order is cut into pieces. Each finds these intervals, the spans, LANES splats at a time, writes them
down in that order and counts its pairs per tile; the sums of the counts over earlier tiles and earlier pieces
are where it writes its lists. So these come out in depth order whatever the number of pieces. Only records
are read in any order, and asked for ahead. Spans found in the order of memory, and read in that of depth by
two passes, one that counts and one that writes, took 1.5 times as long to bin 500,000 splats; and to sum up
gradients, which reads spans in that order too, took 1.2 times as long.

Spans are found in the dtype of the records: pixels' alphas are no more exact than that. In float64 they took
1.13 times as long.

Most splats have one or two spans of one or two tiles, and which it is cannot be guessed: loops over them
spend most of their time on wrong guesses. So the tiles of many splats are first put into one list, whole
vectors at a time of which only the beginning counts, and the list is worked off in one loop.

Dropped, of spans in the order of memory: to count and write in that order, too, and to sort each tile's pairs
by depth, which needs no order of all splats. Sorting and binning took 51 in place of 53 ms of processor time
for `playbot` (two pairs per splat), and 29 in place of 16 ms for `skull` (seven).
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
    X_REST,
    Y_REST,
    A,
    B,
    C,
    X,
    Y,
    column,
    tile_interval,
    tile_rows,
)
from splatview.raster.simd import (
    LANES,
    aligned,
    ceil,
    converted,
    fill,
    floor,
    fma,
    greatest_lane,
    keep_if_at_least,
    keep_if_below,
    maximum,
    minimum,
    prefetch,
    store_int,
    store_run,
    store_same,
    widened,
)
from splatview.raster.transpose import load_rows

AHEAD = 32
"""Splats by which records are asked for ahead, where they are taken in depth order."""

ROUNDING = 1e-6
"""Of a splat's place and extent in px, what the arithmetic of spans may round away in float32, several times
over."""

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
    """What `tile_span` needs of LANES splats, in the dtype of their records: x and y, and what rounding them
    left over, then a, b, c, the bound of (a·dx + b·dy)² + (c·dy)², the half extent in y, the dy at which the
    ellipse is farthest right, and px by which spans are longer."""
    a, b, c = column(rows, A), column(rows, B), column(rows, C)
    log2_opacity = column(rows, LOG2_OPACITY)
    bound = minimum(log2_opacity - fill(a, log2_cut), fill(a, -log2_share))
    bound = fma(bound, fill(a, 1 + MARGIN), fill(a, MARGIN))
    root, slope, by_c = math.sqrt(bound), b / c, fill(a, 1.0) / c
    dy_right = -(slope * root * by_c) / math.sqrt(fma(slope, slope, fill(a, 1.0)))
    x, y = column(rows, X), column(rows, Y)
    margin = fma(abs(x) + column(rows, RX), fill(x, ROUNDING), fill(x, MARGIN))
    return x, y, column(rows, X_REST), column(rows, Y_REST), a, b, c, bound, root * by_c, dy_right, margin


@inline
def tile_span(shapes, row, tiles_x):
    """First and last tile of the rows `row`, lane by lane, that the ellipses meet; first > last where none.
    All of the row where the arithmetic overflows."""
    x, y, x_rest, y_rest, a, b, c, bound, ry, dy_right, margin = shapes
    # The mean is subtracted first: exact near the row, and only then is there room for the rest.
    top = (fma(row, fill(x, TILE), fill(x, 0.5)) - y) - y_rest
    low, high = maximum(top, -ry), minimum(top + fill(x, TILE - 1.0), ry)
    # Farthest right and left within the rows low..high, at the ellipse's own extreme where that is inside.
    at_right = minimum(maximum(dy_right, low), high)
    at_left = minimum(maximum(-dy_right, low), high)
    nothing, inverse = fill(x, 0.0), fill(x, 1.0) / a
    v_right, v_left = c * at_right, c * at_left
    right = math.sqrt(maximum(bound - v_right * v_right, nothing)) - b * at_right
    left = math.sqrt(maximum(bound - v_left * v_left, nothing)) + b * at_left
    right, left = x + fma(right, inverse, x_rest), x - fma(left, inverse, -x_rest)
    first = ceil((left - fill(x, TILE - 0.5) - margin) * fill(x, 1 / TILE))
    last = floor((right - fill(x, 0.5) + margin) * fill(x, 1 / TILE))
    return clipped(first, last, tiles_x)


@inline
def clipped(first, last, tiles):
    """What there is of intervals in [0, tiles); of NaN all. Numbers that fit into int32."""
    first = minimum(maximum(first, fill(first, 0.0)), fill(first, tiles))
    return first, maximum(minimum(last, fill(last, tiles - 1)), fill(last, -1.0))


@kernel(allocates=True)
def find_rows(start, stop, visible, records, view, rows_of):
    """Writes how many rows of tiles the boxes of the splats visible[start:stop] meet to rows_of (N,)
    uint16."""
    rows, starts = aligned(RECORD * LANES, records.dtype), np.empty(LANES, np.int64)
    flat_records, met_rows = records.reshape(-1), np.empty(LANES, np.uint16)
    for k in range(start, stop, LANES):
        for lane in range(LANES):  # beyond the end the last again
            starts[lane] = np.int64(visible[min(k + lane, stop - 1)]) * RECORD
        load_rows(flat_records, starts, RECORD, rows, 0)
        _, met = tile_rows(rows, view.tiles_y)
        store_int(met_rows, 0, met)
        for lane in range(min(LANES, stop - k)):
            rows_of[visible[k + lane]] = met_rows[lane]


@kernel
def sum_rows(start, stop, order, rows_of):
    """How many rows of `spans` the splats order[start:stop] can need."""
    total = np.int64(0)
    for k in range(start, stop):
        total += rows_of[order[k]]
    return total


@kernel(allocates=True)
def find_spans(start, stop, first_span, counts, order, records, view, spans, runs):
    """Finds the runs of tiles that the splats order[start:stop] meet, and counts their pairs by tile: counts
    (tiles,) int64 is overwritten.

    spans (S, 2) int32 receives first and one past the last tile, from row `first_span` on, SPARE rows more
    than there are spans; runs (V, 2) int32 each splat's first row of it and how many, in that order. records
    (N, RECORD).
    """
    rows, starts = aligned(RECORD * LANES, records.dtype), np.empty(LANES, np.int64)
    flat_records = records.reshape(-1)
    met = np.empty(LANES, np.int32)
    # Room for the rows that are taken without asking whether there are so many.
    firsts = np.zeros(max(view.tiles_y, UNGUESSED) * LANES, np.int32)
    ends = np.zeros(max(view.tiles_y, UNGUESSED) * LANES, np.int32)
    tiles, found = aligned(WAITING + LANES, np.int32), np.zeros(len(counts), np.int32)
    at, waiting = first_span, 0
    for k in range(start, stop, LANES):
        for lane in range(LANES):  # beyond the end the last again
            starts[lane] = np.int64(order[min(k + lane, stop - 1)]) * RECORD
            prefetch(flat_records, np.int64(order[min(k + lane + AHEAD, stop - 1)]) * RECORD)
        load_rows(flat_records, starts, RECORD, rows, 0)
        first_row, count = tile_rows(rows, view.tiles_y)
        store_int(met, 0, count)
        first_row = converted(first_row, rows)
        box_first, box_last = tile_interval(widened(column(rows, X)), widened(column(rows, RX)))
        wide = converted(box_last - box_first, rows)
        box_first, box_last = clipped(converted(box_first, rows), converted(box_last, rows), view.tiles_x)
        shapes = ellipses(rows, view.log2_cut, view.log2_share)
        nothing = fill(wide, 0.0)
        for number in range(np.int64(greatest_lane(count))):
            row = first_row + fill(first_row, number)
            first, last = tile_span(shapes, row, view.tiles_x)
            # In one column of tiles the box says all.
            first = keep_if_below(first, nothing, wide) + keep_if_at_least(box_first, nothing, wide)
            last = keep_if_below(last, nothing, wide) + keep_if_at_least(box_last, nothing, wide)
            tile = row * fill(row, view.tiles_x)
            store_int(firsts, number * LANES, tile + first)
            store_int(ends, number * LANES, tile + last + fill(row, 1.0))
        for lane in range(min(LANES, stop - k)):
            begin = at
            for number in range(max(met[lane], UNGUESSED)):
                first, end = firsts[number * LANES + lane], ends[number * LANES + lane]
                spans[at, 0] = first
                spans[at, 1] = end
                length = max(end - first, 0) * (number < met[lane])
                at += length > 0
                if length > LANES or waiting + length > WAITING:
                    for tile in range(first, first + length):
                        found[tile] += 1
                    continue
                store_run(tiles, waiting, first)
                waiting += length
            runs[k + lane, 0] = begin
            runs[k + lane, 1] = at - begin
            if waiting > WAITING - UNGUESSED * LANES:
                add_counts(tiles, waiting, found)
                waiting = 0
    add_counts(tiles, waiting, found)
    counts[:] = found


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
def write_pairs(start, stop, positions, order, runs, spans, first_tile, end_tile, lists):
    """Writes the splats order[start:stop] into the lists of tiles [first_tile, end_tile): lists (pairs,)
    int32. positions (tiles,) int32 says where each list goes on, and ends up behind the last entry."""
    tiles, splats = aligned(WAITING + LANES, np.int32), aligned(WAITING + LANES, np.int32)
    waiting = 0
    for k in range(start, stop):
        row, count, splat = runs[k, 0], runs[k, 1], order[k]
        for number in range(max(count, UNGUESSED)):
            first, length = span_at(row, number, count, spans, first_tile, end_tile)
            if length > LANES or waiting + length > WAITING:
                append_pairs(tiles, splats, waiting, positions, lists)
                waiting = 0
                for tile in range(first, first + length):
                    lists[positions[tile]] = splat
                    positions[tile] += 1
                continue
            store_run(tiles, waiting, first)
            store_same(splats, waiting, splat)
            waiting += length
        if waiting > WAITING - UNGUESSED * LANES:
            append_pairs(tiles, splats, waiting, positions, lists)
            waiting = 0
    append_pairs(tiles, splats, waiting, positions, lists)


@inline
def append_pairs(tiles, splats, waiting, positions, lists):
    for place in range(waiting):
        tile = tiles[place]
        position = positions[tile]
        lists[position] = splats[place]
        positions[tile] = position + 1
