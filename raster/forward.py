"""Tiles to pixels, front to back: steps 4 and 7 of the image model.

A tile is two strips of 8 columns; a strip is eight blocks of 8x2 pixels, each a vector of `simd`. The
tile's list is taken in chunks: the records of a chunk are gathered into columns of numbers relative to
the tile, the rows that each ellipse can touch in each strip are computed 16 splats at a time, and then
only the blocks of these rows are blended. After each chunk, blocks whose pixels are all opaque drop out
at both ends of a strip; a tile ends when no block is left.
"""

from __future__ import annotations

import numpy as np

from .bins import MARGIN
from .compiling import inline, kernel
from .exp import exp2
from .project import BLUE, GREEN, LOG2_OPACITY, RED, X_REST, Y_REST, A, B, C, X, Y
from .simd import (
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    LANES,
    aligned,
    any_above,
    ceil,
    column_centres,
    divide,
    fill,
    floor,
    fma,
    keep_if_at_least,
    keep_if_below,
    load,
    maximum,
    minimum,
    negate,
    prefetch,
    row_centres,
    spread,
    sqrt,
    store,
    store_int,
)
from .view import TILE

STRIPS = TILE // BLOCK_WIDTH
BLOCKS = TILE // BLOCK_HEIGHT
"""In a strip."""

PIXELS = STRIPS * BLOCKS * 4 * LANES
"""Numbers that a tile in work is: by strip and block, a vector each of transmittance, red, green, blue."""

CHUNK = 64
"""Splats gathered at a time: some 2 KiB, so that they stay in the first-level cache."""

# Columns of `gathered`, CHUNK numbers each.
G_X, G_Y, G_A, G_B, G_C, G_LOG2_OPACITY, G_RED, G_GREEN, G_BLUE = range(9)
GATHERED = 9

EARLY_STOP = 1e-5
"""A pixel ends when less light than this comes through: what is left out is at most this times the
brightest colour behind."""


@inline
def gather(lists, start, count, end, records, left, top, gathered):
    """Copies the records of lists[start:start + count] to `gathered` (GATHERED·CHUNK,), means relative to
    the tile's corner; fills up to a whole vector with copies of the last. Asks for those of the next
    chunk, up to lists[end], meanwhile."""
    number = gathered.dtype.type
    for k in range(start + count, min(start + 2 * count, end)):
        prefetch(records, lists[k])
    for j in range((count + LANES - 1) // LANES * LANES):
        record = records[lists[start + min(j, count - 1)]]
        # The corner is subtracted first: exact near the tile, and only then is there room for the rest.
        gathered[G_X * CHUNK + j] = (record[X] - number(left)) + record[X_REST]
        gathered[G_Y * CHUNK + j] = (record[Y] - number(top)) + record[Y_REST]
        gathered[G_A * CHUNK + j] = record[A]
        gathered[G_B * CHUNK + j] = record[B]
        gathered[G_C * CHUNK + j] = record[C]
        gathered[G_LOG2_OPACITY * CHUNK + j] = record[LOG2_OPACITY]
        gathered[G_RED * CHUNK + j] = record[RED]
        gathered[G_GREEN * CHUNK + j] = record[GREEN]
        gathered[G_BLUE * CHUNK + j] = record[BLUE]


@inline
def touched_blocks(gathered, count, log2_cut, rows):
    """First and last block that each gathered ellipse meets in each strip: rows (STRIPS·2·CHUNK,) int32,
    for a strip CHUNK firsts, then CHUNK lasts. First > last where it meets none; all blocks where the
    arithmetic overflows.

    Within the columns of a strip an ellipse reaches farthest down at the column nearest to its own lowest
    point; there the quadratic form, solved for dy, gives dy = -ab/(b² + c²)·dx + sqrt(...).
    """
    for j in range(0, count, LANES):
        x, y = load(gathered, G_X * CHUNK + j), load(gathered, G_Y * CHUNK + j)
        a, b, c = (
            load(gathered, G_A * CHUNK + j),
            load(gathered, G_B * CHUNK + j),
            load(gathered, G_C * CHUNK + j),
        )
        reach = load(gathered, G_LOG2_OPACITY * CHUNK + j) - fill(x, log2_cut)
        reach = fma(reach, fill(x, 1 + MARGIN), fill(x, MARGIN))
        zero, half, margin = fill(x, 0.0), fill(x, 0.5), fill(x, MARGIN)
        inverse = divide(fill(x, 1.0), fma(b, b, c * c))
        slope = negate(a * b) * inverse
        fall = a * a * c * c * inverse  # reach - fall·dx² is what dx leaves for dy
        rx = sqrt(divide(reach, fall))
        dx_bottom = negate(divide(b * sqrt(reach), a * c))
        for strip in range(STRIPS):
            left = maximum(fill(x, strip * BLOCK_WIDTH + 0.5) - x, negate(rx))
            right = minimum(fill(x, strip * BLOCK_WIDTH + (BLOCK_WIDTH - 0.5)) - x, rx)
            bottom = minimum(maximum(dx_bottom, left), right)
            top = minimum(maximum(negate(dx_bottom), left), right)
            below = sqrt(maximum(reach - fall * bottom * bottom, zero) * inverse) + slope * bottom
            above = sqrt(maximum(reach - fall * top * top, zero) * inverse) - slope * top
            # maximum and minimum return their second argument for NaN: then all rows are touched.
            first = maximum(ceil(y - above - half - margin), zero)
            last = minimum(floor(y + below - half + margin), fill(x, TILE - 1.0))
            # Nothing is left between the rows, or left > right: the strip is wholly beside the ellipse.
            missed = keep_if_below(fill(x, 2.0 * TILE), last, first) + keep_if_below(
                fill(x, 2.0 * TILE), right + margin, left
            )
            per_row = fill(x, 1 / BLOCK_HEIGHT)
            first = minimum(first + missed, fill(x, TILE + 0.0)) * per_row
            store_int(rows, 2 * strip * CHUNK + j, first)
            store_int(rows, (2 * strip + 1) * CHUNK + j, maximum(last, zero) * per_row)


@inline
def start_pixels(pixels, left, top, view):
    """Transmittance 1 and colour 0 in `pixels` (PIXELS,); transmittance 0 beyond the image's border, where
    nothing is left to do."""
    pixels[:] = 0
    for y in range(min(TILE, view.height - top)):
        for x in range(min(TILE, view.width - left)):
            pixels[pixel_index(x, y)] = 1


@inline
def pixel_index(x, y):
    """Where the transmittance of pixel (x, y) of a tile is; its colour follows at steps of LANES."""
    block = (x // BLOCK_WIDTH) * BLOCKS + y // BLOCK_HEIGHT
    return block * 4 * LANES + (y % BLOCK_HEIGHT) * BLOCK_WIDTH + x % BLOCK_WIDTH


@inline
def shrink_alive(pixels, stop_below, alive):
    """Narrows alive (2·STRIPS,) int64, first and last block by strip, to blocks with light left. Returns
    whether there is one."""
    some = False
    for strip in range(STRIPS):
        first, last = alive[2 * strip], alive[2 * strip + 1]
        while first <= last and not any_above(load(pixels, (strip * BLOCKS + first) * 4 * LANES), stop_below):
            first += 1
        while first <= last and not any_above(load(pixels, (strip * BLOCKS + last) * 4 * LANES), stop_below):
            last -= 1
        alive[2 * strip], alive[2 * strip + 1] = first, last
        some = some or first <= last
    return some


@inline
def blend_chunk(gathered, count, rows, alive, log2_cut, max_alpha, pixels):
    """Blends gathered splats over the pixels of a tile, in their order. Returns the number of blocks."""
    number = gathered.dtype.type
    blocks = 0
    for j in range(count):
        b, c = spread(gathered[G_B * CHUNK + j]), spread(gathered[G_C * CHUNK + j])
        log2_opacity = spread(gathered[G_LOG2_OPACITY * CHUNK + j])
        red = spread(gathered[G_RED * CHUNK + j])
        green = spread(gathered[G_GREEN * CHUNK + j])
        blue = spread(gathered[G_BLUE * CHUNK + j])
        cut, cap, step = fill(red, log2_cut), fill(red, max_alpha), fill(red, BLOCK_HEIGHT)
        y_centres = row_centres(red) - spread(gathered[G_Y * CHUNK + j])
        for strip in range(STRIPS):
            first = max(np.int64(rows[2 * strip * CHUNK + j]), alive[2 * strip])
            last = min(np.int64(rows[(2 * strip + 1) * CHUNK + j]), alive[2 * strip + 1])
            x_mean = gathered[G_X * CHUNK + j] - number(strip * BLOCK_WIDTH)
            adx = spread(gathered[G_A * CHUNK + j]) * (column_centres(red) - spread(x_mean))
            dy = y_centres + fill(red, first * BLOCK_HEIGHT)
            blocks += max(last - first + 1, 0)
            for block in range(first, last + 1):
                u, v = fma(b, dy, adx), c * dy
                dy = dy + step
                power = fma(negate(u), u, fma(negate(v), v, log2_opacity))
                alpha = keep_if_at_least(minimum(exp2(power), cap), power, cut)
                base = (strip * BLOCKS + block) * 4 * LANES
                light = load(pixels, base)
                weight = alpha * light
                store(pixels, base, light - weight)
                store(pixels, base + LANES, fma(weight, red, load(pixels, base + LANES)))
                store(pixels, base + 2 * LANES, fma(weight, green, load(pixels, base + 2 * LANES)))
                store(pixels, base + 3 * LANES, fma(weight, blue, load(pixels, base + 3 * LANES)))
    return blocks


@inline
def write_pixels(pixels, left, top, background, image):
    """Writes the tile's part of image (H, W, 4): colour over the background, alpha."""
    for y in range(min(TILE, image.shape[0] - top)):
        for x in range(min(TILE, image.shape[1] - left)):
            base = pixel_index(x, y)
            light = pixels[base]
            pixel = image[top + y, left + x]
            pixel[0] = pixels[base + LANES] + light * background[0]
            pixel[1] = pixels[base + 2 * LANES] + light * background[1]
            pixel[2] = pixels[base + 3 * LANES] + light * background[2]
            pixel[3] = 1 - light


@kernel
def draw_tiles(start, stop, offsets, base, lists, records, view, background, stop_below, image):
    """Draws tiles [start, stop), numbered by rows, into image (H, W, 4). Returns the number of blocks
    that were blended, of LANES pixels each.

    offsets (tiles + 1,) int64 and lists (pairs,) int32 as `bins` makes them, lists[0] being place `base`;
    records (N, RECORD), background (3,), stop_below (a number) and image share one dtype.
    """
    gathered = aligned(GATHERED * CHUNK, image.dtype)
    rows = aligned(STRIPS * 2 * CHUNK, np.int32)
    pixels = aligned(PIXELS, image.dtype)
    alive = np.empty(2 * STRIPS, np.int64)
    blocks = 0
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        start_pixels(pixels, left, top, view)
        for strip in range(STRIPS):
            alive[2 * strip], alive[2 * strip + 1] = 0, BLOCKS - 1
        position, end = offsets[tile] - base, offsets[tile + 1] - base
        while position < end and shrink_alive(pixels, stop_below, alive):
            count = min(end - position, CHUNK)
            gather(lists, position, count, end, records, left, top, gathered)
            touched_blocks(gathered, count, view.log2_cut, rows)
            blocks += blend_chunk(gathered, count, rows, alive, view.log2_cut, view.max_alpha, pixels)
            position += count
        write_pixels(pixels, left, top, background, image)
    return blocks
