"""Tiles to pixels, front to back: steps 4 (or 4d) and 7 of the image model.

A tile is two strips of 8 columns; a strip is eight blocks of 8x2 pixels, each a vector of `simd`. The
tile's list is taken in chunks: the records of a chunk are gathered into columns of numbers relative to
the tile, the rows that each ellipse can touch in each strip are computed 16 splats at a time, and then
only the blocks of these rows are blended.

After each chunk, pixels that let less light through than the early stop are retired: their light is put
aside together with the number of splats that they have met, and counts as 0 from there on. A chunk is cut
short where its splats are so opaque that light could fall from the early stop to 0 within it, and so
`backward` can follow each pixel's light from its end to its beginning. Blocks without light drop out at
both ends of a strip; a tile ends when no block is left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.parameters import TILE
from splatview.raster.project import BLUE, FALL, GREEN, LOG2_OPACITY, RED, X_REST, Y_REST, A, B, C, X, Y
from splatview.raster.simd import (
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    LANES,
    aligned,
    any_above,
    any_within,
    ceil,
    column_centres,
    divide,
    exp2,
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
from splatview.raster.surfels import DISC, FACING, LEAN_X, LEAN_Y, MOST_LEAN, UX, UY, VX, VY, disc_power
from splatview.raster.tiles import MARGIN

STRIPS = TILE // BLOCK_WIDTH
BLOCKS = TILE // BLOCK_HEIGHT
"""In a strip."""

TILE_PIXELS = STRIPS * BLOCKS * LANES

PIXELS = 4 * TILE_PIXELS
"""Numbers that a tile in work is: by strip and block, a vector each of transmittance, red, green, blue."""

CHUNK = 64
"""Splats gathered at a time: some 2 KiB, so that they stay in the first-level cache."""

# Columns of `gathered`, CHUNK numbers each; discs have those of their rows besides, from G_DISC on.
G_X, G_Y, G_A, G_B, G_C, G_LOG2_OPACITY, G_RED, G_GREEN, G_BLUE, G_DISC = range(10)
GATHERED = 9

LEAST_LIGHT = 1e8
"""No pixel goes on with less light than this times the smallest normal number, however low the early stop."""

EARLY_STOP = 1e-5
"""A pixel ends when less light than this comes through: what is left out is at most this times the
brightest colour behind."""


@inline
def gather(lists, start, count, next_start, next_stop, records, left, top, most_fall, gathered, discs):
    """Copies the records of lists[start:start + count] to `gathered` (gathered_columns(discs)·CHUNK,), means
    relative to the tile's corner; fills up to a whole vector with copies of the last. Asks for those of
    lists[next_start:next_stop], which will be gathered next, meanwhile.

    Returns how many it took: fewer than `count` where light, by these splats' opacities, could fall by more
    than `most_fall` powers of two, a negative number.
    """
    number = gathered.dtype.type
    for k in range(next_start, next_stop):
        prefetch(records, lists[k])
    fall = number(0)
    for j in range(count):
        record = records[lists[start + j]]
        fall += record[FALL]
        if fall < most_fall and j > 0:
            count = j
            break
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
        if discs is not None:
            row = discs.rows[lists[start + j]]
            for number_of in range(DISC):
                gathered[(G_DISC + number_of) * CHUNK + j] = row[number_of]
    for j in range(count, (count + LANES - 1) // LANES * LANES):
        for column in range(GATHERED):
            gathered[column * CHUNK + j] = gathered[column * CHUNK + count - 1]
    return count


@inline
def touched_blocks(gathered, count, log2_cut, log2_share, rows):
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
        reach = minimum(load(gathered, G_LOG2_OPACITY * CHUNK + j) - fill(x, log2_cut), fill(x, -log2_share))
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


class Retirement(NamedTuple):
    """When pixels retire."""

    stop_below: float
    """The light below which they do."""
    most_fall: float
    """By how many powers of two light may fall in a chunk and stay a normal number; negative."""


def make_retirement(early_stop: float, dtype: np.dtype) -> Retirement:
    smallest = float(np.finfo(dtype).smallest_normal)
    stop_below = max(early_stop, smallest * LEAST_LIGHT)
    return Retirement(stop_below, math.log2(smallest / stop_below))


@inline
def start_pixels(pixels, left, top, view):
    """Transmittance 1 and colour 0 in `pixels` (PIXELS,); transmittance 0 beyond the image's border, where
    nothing is left to do."""
    pixels[:] = 0
    for block in range(STRIPS * BLOCKS):
        _, _, columns, rows = block_in_image(block, left, top, view.width, view.height)
        for row in range(rows):
            for column in range(columns):
                pixels[block * 4 * LANES + row * BLOCK_WIDTH + column] = 1


@inline
def block_in_image(block, left, top, width, height):
    """The top left pixel of a tile's block, and how many columns and rows of it are in the image."""
    x = left + block // BLOCKS * BLOCK_WIDTH
    y = top + block % BLOCKS * BLOCK_HEIGHT
    return x, y, min(BLOCK_WIDTH, width - x), min(BLOCK_HEIGHT, height - y)


@inline
def retire(pixels, first_pixel, stop_below, met, transmittance, n_contrib, alive):
    """Retires pixels with less light than `stop_below`, after `met` splats: their transmittance moves to
    lights and `met` to n_contrib, flat arrays where the tile begins at first_pixel. Narrows alive (2·STRIPS,)
    int64, first and last block by strip, to blocks with light left; returns whether there is one."""
    some = False
    zero, below = pixels.dtype.type(0), pixels.dtype.type(stop_below)
    for strip in range(STRIPS):
        first, last = np.int64(BLOCKS), np.int64(-1)
        for block in range(alive[2 * strip], alive[2 * strip + 1] + 1):
            at = (strip * BLOCKS + block) * LANES
            light = load(pixels, 4 * at)
            if any_within(light, zero, below):
                retired = keep_if_below(light, light, spread(below))
                put_aside(retired, first_pixel + at, met, transmittance, n_contrib)
                light = light - retired
                store(pixels, 4 * at, light)
            if any_above(light, zero):
                first, last = min(first, block), block
        alive[2 * strip], alive[2 * strip + 1] = first, last
        some = some or first <= last
    return some


@inline
def put_aside(retired, at, met, transmittance, n_contrib):
    """Notes the light of the pixels from `at` on where it is not 0, and how many splats they met."""
    store(transmittance, at, load(transmittance, at) + retired)
    count = keep_if_below(fill(retired, met), fill(retired, 0.0), retired)
    store(n_contrib, at, load(n_contrib, at) + count)


@inline
def gathered_columns(discs):
    return GATHERED if discs is None else GATHERED + DISC


@inline
def on_disc(gathered, j, discs, dx):
    """What `disc_power` needs of pixels dx from the j-th gathered mean, to which rows are added: parts of
    u, v, lean and the dot by dx, then what dy adds to u, v and lean."""
    row = (G_DISC * CHUNK) + j
    return (
        spread(gathered[row + UX * CHUNK]) * dx,
        spread(gathered[row + VX * CHUNK]) * dx,
        spread(gathered[row + LEAN_X * CHUNK]) * dx,
        fill(dx, discs.sharpness) * (dx * dx),
        spread(gathered[row + UY * CHUNK]),
        spread(gathered[row + VY * CHUNK]),
        spread(gathered[row + LEAN_Y * CHUNK]),
    )


@inline
def power_on_disc(across, gathered, j, discs, dy):
    """`disc_power` of pixels; `across` as `on_disc` made it."""
    u, v, lean, dot, down_u, down_v, down_lean = across
    row = (G_DISC * CHUNK) + j
    lean = fma(down_lean, dy, lean)
    slope = fma(fill(dy, discs.perspective), lean, spread(gathered[row + FACING * CHUNK]))
    return disc_power(
        fma(down_u, dy, u),
        fma(down_v, dy, v),
        lean,
        slope,
        spread(gathered[row + MOST_LEAN * CHUNK]),
        fma(fill(dy, discs.sharpness) * dy, dy, dot),
    )


@inline
def blend_chunk(gathered, count, rows, alive, log2_cut, log2_share, max_alpha, pixels, discs):
    """Blends gathered splats over the pixels of a tile, in their order. Returns the number of blocks."""
    number = gathered.dtype.type
    blocks = 0
    for j in range(count):
        b, c = spread(gathered[G_B * CHUNK + j]), spread(gathered[G_C * CHUNK + j])
        log2_opacity = spread(gathered[G_LOG2_OPACITY * CHUNK + j])
        red = spread(gathered[G_RED * CHUNK + j])
        green = spread(gathered[G_GREEN * CHUNK + j])
        blue = spread(gathered[G_BLUE * CHUNK + j])
        cut = maximum(log2_opacity + fill(red, log2_share), fill(red, log2_cut))
        cap, step = fill(red, max_alpha), fill(red, BLOCK_HEIGHT)
        y_centres = row_centres(red) - spread(gathered[G_Y * CHUNK + j])
        for strip in range(STRIPS):
            first = max(np.int64(rows[2 * strip * CHUNK + j]), alive[2 * strip])
            last = min(np.int64(rows[(2 * strip + 1) * CHUNK + j]), alive[2 * strip + 1])
            x_mean = gathered[G_X * CHUNK + j] - number(strip * BLOCK_WIDTH)
            dx = column_centres(red) - spread(x_mean)
            adx = spread(gathered[G_A * CHUNK + j]) * dx
            if discs is not None:
                across = on_disc(gathered, j, discs, dx)
            dy = y_centres + fill(red, first * BLOCK_HEIGHT)
            blocks += max(last - first + 1, 0)
            for block in range(first, last + 1):
                if discs is None:
                    u, v = fma(b, dy, adx), c * dy
                    power = fma(negate(u), u, fma(negate(v), v, log2_opacity))
                else:
                    plane = across  # pyright: ignore[reportPossiblyUnboundVariable]
                    power = log2_opacity - power_on_disc(plane, gathered, j, discs, dy)
                dy = dy + step
                alpha = keep_if_at_least(minimum(exp2(power), cap), power, cut)
                base = (strip * BLOCKS + block) * 4 * LANES
                light = load(pixels, base)
                weight = alpha * light
                # Not light - weight, whose rounding would be that of the light in front.
                store(pixels, base, fma(negate(alpha), light, light))
                store(pixels, base + LANES, fma(weight, red, load(pixels, base + LANES)))
                store(pixels, base + 2 * LANES, fma(weight, green, load(pixels, base + 2 * LANES)))
                store(pixels, base + 3 * LANES, fma(weight, blue, load(pixels, base + 3 * LANES)))
    return blocks


@inline
def write_pixels(pixels, left, top, first_pixel, background, transmittance, image):
    """Writes the tile's part of image (H, W, 4): colour over the background, alpha."""
    for block in range(STRIPS * BLOCKS):
        x, y, columns, rows = block_in_image(block, left, top, image.shape[1], image.shape[0])
        for row in range(rows):
            for column in range(columns):
                lane = row * BLOCK_WIDTH + column
                at = block * 4 * LANES + lane
                light = transmittance[first_pixel + block * LANES + lane]
                pixel = image[y + row, x + column]
                pixel[0] = pixels[at + LANES] + light * background[0]
                pixel[1] = pixels[at + 2 * LANES] + light * background[1]
                pixel[2] = pixels[at + 3 * LANES] + light * background[2]
                pixel[3] = 1 - light


@kernel
def draw_tiles(
    start,
    stop,
    offsets,
    base,
    lists,
    records,
    discs,
    view,
    background,
    retirement,
    image,
    transmittance,
    n_contrib,
):
    """Draws tiles [start, stop), numbered by rows, into image (H, W, 4). Returns the number of blocks that
    were blended, of LANES pixels each.

    offsets (tiles + 1,) int64 and lists (pairs,) int32 as `bins` makes them, lists[0] being place `base`;
    discs is a `DiscArrays` or None, retirement a `Retirement`. transmittance and n_contrib
    (tiles·TILE_PIXELS,) receive per pixel the transmittance and how many splats of its tile's list it met,
    one vector per block, strip by strip; both are 0 beyond the image. records (N, RECORD), background (3,),
    image, transmittance and n_contrib share one dtype.
    """
    gathered = aligned(gathered_columns(discs) * CHUNK, image.dtype)
    rows = aligned(STRIPS * 2 * CHUNK, np.int32)
    pixels = aligned(PIXELS, image.dtype)
    alive = np.empty(2 * STRIPS, np.int64)
    blocks = 0
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        first_pixel = tile * TILE_PIXELS
        transmittance[first_pixel : first_pixel + TILE_PIXELS] = 0
        n_contrib[first_pixel : first_pixel + TILE_PIXELS] = 0
        start_pixels(pixels, left, top, view)
        for strip in range(STRIPS):
            alive[2 * strip], alive[2 * strip + 1] = 0, BLOCKS - 1
        first, end = offsets[tile] - base, offsets[tile + 1] - base
        position, some = first, True
        while position < end and some:
            count = min(end - position, CHUNK)
            next_stop = min(position + 2 * CHUNK, end)
            count = gather(
                lists,
                position,
                count,
                position + count,
                next_stop,
                records,
                left,
                top,
                retirement.most_fall,
                gathered,
                discs,
            )
            touched_blocks(gathered, count, view.log2_cut, view.log2_share, rows)
            blocks += blend_chunk(
                gathered, count, rows, alive, view.log2_cut, view.log2_share, view.max_alpha, pixels, discs
            )
            position += count
            some = retire(
                pixels, first_pixel, retirement.stop_below, position - first, transmittance, n_contrib, alive
            )
        retire(pixels, first_pixel, np.inf, position - first, transmittance, n_contrib, alive)
        write_pixels(pixels, left, top, first_pixel, background, transmittance, image)
    return blocks
