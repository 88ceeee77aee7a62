"""Tiles to pixels, front to back: steps 4 (or 4d) and 7 of the image model.

A tile is strips of columns, each as wide as a block of pixels of `simd`, and a strip is eight blocks. The
tile's list is taken in chunks: the records of a chunk are gathered into columns of numbers relative to
the tile, the rows that each ellipse can touch in each strip are computed 16 splats at a time, and then
only the blocks of these rows are blended.

After each chunk, pixels whose transmittance is below the early stop are terminated: their transmittance and
the number of splats so far (n_contrib, the last contributor) are recorded, and the transmittance is 0 from
there on. A chunk is cut short where its splats are so opaque that transmittance could fall from the early
stop to 0 within it, so that `backward` can follow each pixel from its end to its beginning. Terminated
blocks drop out at both ends of a strip; a tile ends when no block is left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splatview.raster.blocks import (
    BYTE,
    EXP2_CONSTANTS,
    MEMBERS,
    count_bits,
    exp2_by,
    exp2_constants,
    lowest_bit,
    no_bits,
    place_exp2_constants,
    store_bits,
    store_members,
    with_run,
)
from splatview.raster.compiling import inline, kernel
from splatview.raster.parameters import TILE
from splatview.raster.project import BLUE, LOG2_DROP, RECORD, X_REST, Y_REST, A, X, Y
from splatview.raster.simd import (
    BLOCK_HEIGHT,
    BLOCK_LANES,
    BLOCK_WIDTH,
    LANES,
    aligned,
    any_above,
    any_within,
    ceil,
    column_centres,
    divide,
    fill,
    floor,
    fma,
    keep_if_at_least,
    keep_if_below,
    load,
    load_block,
    maximum,
    minimum,
    negate,
    prefetch,
    row_centres,
    spread_block,
    sqrt,
    store,
    sum_lanes,
)
from splatview.raster.surfels import (
    MAX_TILT,
    NORMAL_RAY,
    NORMAL_X,
    NORMAL_Y,
    SURFEL,
    UX,
    UY,
    VX,
    VY,
    surfel_exponent,
)
from splatview.raster.tiles import MARGIN
from splatview.raster.transpose import load_rows, store_interleaved

STRIPS = TILE // BLOCK_WIDTH
BLOCKS = TILE // BLOCK_HEIGHT
"""Blocks of pixels per strip."""

TILE_PIXELS = STRIPS * BLOCKS * BLOCK_LANES

PIXELS = 4 * TILE_PIXELS
"""Numbers of a tile in work: by strip and block, a vector each of transmittance, red, green and blue."""

CHUNK = 64
"""Splats gathered at a time: some 2 KiB, so that they stay in the first-level cache."""

# Columns of `gathered`, CHUNK numbers each; G_CUT is the power of two below which alpha is 0, and G_ROOM is
# for LANES records as columns. Those of a surfel's row follow from G_SURFEL on.
G_X, G_Y, G_A, G_B, G_C, G_LOG2_OPACITY, G_RED, G_GREEN, G_BLUE, G_CUT, G_ROOM = range(11)
G_SURFEL = G_ROOM + RECORD * LANES // CHUNK
GATHERED = G_SURFEL
"""Columns without those of surfels."""


ALL_BLOCKS, NO_BLOCKS = np.uint64((1 << STRIPS * BLOCKS) - 1), np.uint64(0)
"""Sets of a tile's blocks."""

ITEMS = CHUNK * STRIPS * BLOCKS + BYTE
"""Most blocks of a chunk's splats, and room for what is listed beyond the last."""

PLACE_BITS = (STRIPS * BLOCKS).bit_length() - 1

EXPONENTS = 2 * TILE_PIXELS
"""Where the constants of `exp2_by` are behind the pixel centres."""

CENTRES = EXPONENTS + EXP2_CONSTANTS

LEAST_TRANSMITTANCE = 1e8
"""Least early stop, in smallest normal numbers of the picture's dtype."""

EARLY_STOP = 1e-5
"""Transmittance below which a pixel is terminated: the error is at most this times the brightest colour
behind."""


@inline
def gather(
    lists,
    start,
    count,
    next_start,
    next_stop,
    records,
    left,
    top,
    max_log2_drop,
    gathered,
    surfels,
    starts,
):
    """Copies the records of lists[start:start + count] to `gathered` (gathered_columns(surfels)·CHUNK,),
    means relative to the tile's corner; fills up to a whole vector with others. Asks for those of
    lists[next_start:next_stop], which will be gathered next, meanwhile. records (N·RECORD,); starts (LANES,)
    int64 is room to work in.

    Returns how many it took: fewer than `count` where these splats' opacities could let transmittance drop by
    more than `max_log2_drop` powers of two, a negative number.
    """
    number = gathered.dtype.type
    for k in range(next_start, next_stop):
        prefetch(records, np.int64(lists[k]) * RECORD)
    log2_drop, room = number(0), G_ROOM * CHUNK
    for j in range(0, count, LANES):
        for lane in range(LANES):  # beyond the end the last again
            starts[lane] = np.int64(lists[start + min(j + lane, count - 1)]) * RECORD
        load_rows(records, starts, RECORD, gathered, room)
        # The corner is subtracted first: exact near the tile, and only then is there room for the rest.
        x, y = load(gathered, room + X * LANES), load(gathered, room + Y * LANES)
        x, y = x - fill(x, left), y - fill(y, top)
        store(gathered, G_X * CHUNK + j, x + load(gathered, room + X_REST * LANES))
        store(gathered, G_Y * CHUNK + j, y + load(gathered, room + Y_REST * LANES))
        for column in range(A, BLUE + 1):  # from G_A to G_BLUE in the same order
            store(gathered, (G_A - A + column) * CHUNK + j, load(gathered, room + column * LANES))
        here = min(LANES, count - j)
        if surfels is not None:
            for lane in range(here):
                row = surfels.rows[lists[start + j + lane]]
                for number_of in range(SURFEL):
                    gathered[(G_SURFEL + number_of) * CHUNK + j + lane] = row[number_of]
        # Without asking for each where all are within bounds.
        drops = load(gathered, room + LOG2_DROP * LANES)
        store(gathered, room, sum_lanes((drops,)))
        if here == LANES and log2_drop + gathered[room] >= max_log2_drop:
            log2_drop += gathered[room]
            continue
        for lane in range(here):
            log2_drop += gathered[room + LOG2_DROP * LANES + lane]
            if log2_drop < max_log2_drop and j + lane > 0:
                return j + lane
    return count


@inline
def touched_blocks(gathered, count, log2_cut, log2_share, touched):
    """The blocks of the tile that each gathered ellipse meets, a bit each: touched (CHUNK,) uint32. All
    blocks where the arithmetic overflows. Fills the column G_CUT too.

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
        log2_opacity = load(gathered, G_LOG2_OPACITY * CHUNK + j)
        cut = maximum(log2_opacity + fill(x, log2_share), fill(x, log2_cut))
        store(gathered, G_CUT * CHUNK + j, cut)
        bound = minimum(log2_opacity - fill(x, log2_cut), fill(x, -log2_share))
        bound = fma(bound, fill(x, 1 + MARGIN), fill(x, MARGIN))
        zero, half, margin, blocks = fill(x, 0.0), fill(x, 0.5), fill(x, MARGIN), no_bits()
        per_row = fill(x, 1 / BLOCK_HEIGHT)
        inverse = divide(fill(x, 1.0), fma(b, b, c * c))
        slope = negate(a * b) * inverse
        curvature = a * a * c * c * inverse  # bound - curvature·dx² is left for dy
        rx = sqrt(divide(bound, curvature))
        dx_bottom = negate(divide(b * sqrt(bound), a * c))
        for strip in range(STRIPS):
            left = maximum(fill(x, strip * BLOCK_WIDTH + 0.5) - x, negate(rx))
            right = minimum(fill(x, strip * BLOCK_WIDTH + (BLOCK_WIDTH - 0.5)) - x, rx)
            bottom = minimum(maximum(dx_bottom, left), right)
            top = minimum(maximum(negate(dx_bottom), left), right)
            below = sqrt(maximum(bound - curvature * bottom * bottom, zero) * inverse) + slope * bottom
            above = sqrt(maximum(bound - curvature * top * top, zero) * inverse) - slope * top
            # maximum and minimum return their second argument for NaN: then all rows are touched.
            first = maximum(ceil(y - above - half - margin), zero)
            last = minimum(floor(y + below - half + margin), fill(x, TILE - 1.0))
            # Nothing is left between the rows, or left > right: the strip is wholly beside the ellipse.
            blocks = with_run(blocks, strip * BLOCKS, first * per_row, last * per_row, left, right + margin)
        store_bits(touched, j, blocks)


class Termination(NamedTuple):
    """When pixels are terminated."""

    stop_below: float
    """Transmittance below which a pixel is terminated."""
    max_log2_drop: float
    """Largest log2 transmittance drop within a chunk that leaves a normal number; negative."""


def make_termination(early_stop: float, dtype: np.dtype) -> Termination:
    smallest = float(np.finfo(dtype).smallest_normal)
    stop_below = max(early_stop, smallest * LEAST_TRANSMITTANCE)
    return Termination(stop_below, math.log2(smallest / stop_below))


@inline
def start_pixels(pixels, left, top, view):
    """Transmittance 1 and colour 0 in `pixels` (PIXELS,); transmittance 0 beyond the image's border."""
    pixels[:] = 0
    for block in range(STRIPS * BLOCKS):
        _, _, columns, rows = block_in_image(block, left, top, view.width, view.height)
        if columns == BLOCK_WIDTH and rows == BLOCK_HEIGHT:
            store(pixels, block * 4 * BLOCK_LANES, spread_block(pixels.dtype.type(1)))
            continue
        for row in range(rows):
            for column in range(columns):
                pixels[block * 4 * BLOCK_LANES + row * BLOCK_WIDTH + column] = 1


@inline
def block_in_image(block, left, top, width, height):
    """The top left pixel of a tile's block, and how many columns and rows of it are in the image."""
    x = left + block // BLOCKS * BLOCK_WIDTH
    y = top + block % BLOCKS * BLOCK_HEIGHT
    return x, y, min(BLOCK_WIDTH, width - x), min(BLOCK_HEIGHT, height - y)


@inline
def terminate_pixels(pixels, first_pixel, stop_below, count, final_transmittance, n_contrib, alive):
    """Terminates pixels with a transmittance below `stop_below` after `count` splats: their transmittance
    moves to final_transmittance and `count` to n_contrib, flat arrays where the tile begins at first_pixel.
    Of the blocks in `alive`, a set of bits, returns those with pixels left."""
    left, zero, below = NO_BLOCKS, pixels.dtype.type(0), pixels.dtype.type(stop_below)
    while alive:
        block = lowest_bit(alive)
        bit = alive & (~alive + np.uint64(1))
        alive ^= bit
        at = block * BLOCK_LANES
        transmittance = load_block(pixels, 4 * at)
        if any_within(transmittance, zero, below):
            final = keep_if_below(transmittance, transmittance, spread_block(below))
            to = first_pixel + at
            store(final_transmittance, to, load_block(final_transmittance, to) + final)
            contributors = keep_if_below(fill(final, count), fill(final, 0.0), final)
            store(n_contrib, to, load_block(n_contrib, to) + contributors)
            transmittance = transmittance - final
            store(pixels, 4 * at, transmittance)
        if any_above(transmittance, zero):
            left |= bit
    return left


@inline
def gathered_columns(surfels):
    return GATHERED if surfels is None else GATHERED + SURFEL


@inline
def surfel_columns(gathered, j, surfels, dx):
    """What `surfel_exponent` needs of pixels dx from the j-th gathered mean, before rows are added: the parts
    of u, v, tilt and the dot that depend on dx, then what dy adds to u, v and tilt."""
    row = (G_SURFEL * CHUNK) + j
    return (
        spread_block(gathered[row + UX * CHUNK]) * dx,
        spread_block(gathered[row + VX * CHUNK]) * dx,
        spread_block(gathered[row + NORMAL_X * CHUNK]) * dx,
        fill(dx, surfels.sharpness) * (dx * dx),
        spread_block(gathered[row + UY * CHUNK]),
        spread_block(gathered[row + VY * CHUNK]),
        spread_block(gathered[row + NORMAL_Y * CHUNK]),
    )


@inline
def surfel_exponent_at(columns, gathered, j, surfels, dy):
    """`surfel_exponent` of pixels; `columns` as `surfel_columns` made them."""
    u, v, tilt, dot, down_u, down_v, down_tilt = columns
    row = (G_SURFEL * CHUNK) + j
    tilt = fma(down_tilt, dy, tilt)
    slope = fma(fill(dy, surfels.perspective), tilt, spread_block(gathered[row + NORMAL_RAY * CHUNK]))
    return surfel_exponent(
        fma(down_u, dy, u),
        fma(down_v, dy, v),
        tilt,
        slope,
        spread_block(gathered[row + MAX_TILT * CHUNK]),
        fma(fill(dy, surfels.sharpness) * dy, dy, dot),
    )


@inline
def list_items(touched, start, stop, alive, members, items, firsts):
    """Writes the blocks in `alive`, a set of bits, that gathered splats [start, stop) touch, splat by splat,
    to items (ITEMS,) int32: the j-th splat's block at place p of the tile is j·STRIPS·BLOCKS + p. Returns how
    many there are; firsts (CHUNK + 1,) uint32, if any, receives where each splat's begin, from firsts[start]
    to firsts[stop]. `members` is MEMBERS, flat.

    Of loops over each splat's own few blocks the processor guesses the end wrong for nearly every pair: six
    taken bit by bit, and the others asked for, took 12.5 ns a pair in place of 2.3. Dropped: six bit by bit
    and then a loop, the forward pass 1.06 and 1.15 of a loop's (100,000 and 20,000 splats); lists by strips
    of 4x2 blocks, 1.11.
    """
    total = 0
    for j in range(start, stop):
        if firsts is not None:
            firsts[j] = total
        blocks = touched[j] & alive
        for strip in range(STRIPS):
            here = (blocks >> np.uint64(strip * BLOCKS)) & np.uint64((1 << BLOCKS) - 1)
            store_members(items, total, members, here, (j * STRIPS + strip) * BLOCKS)
            total += count_bits(here)
    if firsts is not None:
        firsts[stop] = total
    return total


@inline
def place_centres(centres):
    """Writes the pixel centres of the blocks of a tile: centres (CENTRES,), by strip and block a vector of x
    and one of y, px from the tile's corner; then the constants of `exp2_by`."""
    like = load_block(centres, 0)
    place_exp2_constants(centres, EXPONENTS)
    for place in range(STRIPS * BLOCKS):
        x, y = place // BLOCKS * BLOCK_WIDTH, place % BLOCKS * BLOCK_HEIGHT
        store(centres, 2 * place * BLOCK_LANES, column_centres(like) + fill(like, x))
        store(centres, (2 * place + 1) * BLOCK_LANES, row_centres(like) + fill(like, y))


@inline
def exponent_at(gathered, centres, j, place, surfels):
    """log2(alpha), before cut and cap, of the j-th gathered splat in the pixels of a block of the tile."""
    dx = load_block(centres, 2 * place * BLOCK_LANES) - spread_block(gathered[G_X * CHUNK + j])
    dy = load_block(centres, (2 * place + 1) * BLOCK_LANES) - spread_block(gathered[G_Y * CHUNK + j])
    log2_opacity = spread_block(gathered[G_LOG2_OPACITY * CHUNK + j])
    if surfels is None:
        u = fma(spread_block(gathered[G_B * CHUNK + j]), dy, spread_block(gathered[G_A * CHUNK + j]) * dx)
        v = spread_block(gathered[G_C * CHUNK + j]) * dy
        return fma(negate(u), u, fma(negate(v), v, log2_opacity))
    across = surfel_columns(gathered, j, surfels, dx)
    return log2_opacity - surfel_exponent_at(across, gathered, j, surfels, dy)


@inline
def blend_items(items, total, gathered, centres, max_alpha, pixels, surfels):
    """Blends gathered splats over the pixels of a tile: `items` as `list_items` made them, in their order.

    Dropped: block by block, each with its splats as the bits of a number, so that its pixels are loaded and
    stored once: the forward pass took 1.05 to 1.12 times as long, on one thread and on two.
    """
    constants = exp2_constants(centres, EXPONENTS)
    for n in range(total):
        item = np.int64(items[n])  # as bits, which tell the compiler that no index is negative
        j, place = (item >> PLACE_BITS) & (CHUNK - 1), item & (STRIPS * BLOCKS - 1)
        power = exponent_at(gathered, centres, j, place, surfels)
        cut = spread_block(gathered[G_CUT * CHUNK + j])
        alpha = keep_if_at_least(minimum(exp2_by(constants, power), fill(power, max_alpha)), power, cut)
        base = place * 4 * BLOCK_LANES
        transmittance = load_block(pixels, base)
        weight = alpha * transmittance
        # Not transmittance - weight, whose rounding would be that of the transmittance in front.
        store(pixels, base, fma(negate(alpha), transmittance, transmittance))
        red, green = spread_block(gathered[G_RED * CHUNK + j]), spread_block(gathered[G_GREEN * CHUNK + j])
        blue = spread_block(gathered[G_BLUE * CHUNK + j])
        store(pixels, base + BLOCK_LANES, fma(weight, red, load_block(pixels, base + BLOCK_LANES)))
        store(pixels, base + 2 * BLOCK_LANES, fma(weight, green, load_block(pixels, base + 2 * BLOCK_LANES)))
        store(pixels, base + 3 * BLOCK_LANES, fma(weight, blue, load_block(pixels, base + 3 * BLOCK_LANES)))


@inline
def write_pixels(pixels, left, top, first_pixel, background, transmittance, image, flat_image):
    """Writes the tile's part of image (H, W, 4), which is `flat_image` too: colour over the background,
    alpha."""
    for block in range(STRIPS * BLOCKS):
        x, y, columns, rows = block_in_image(block, left, top, image.shape[1], image.shape[0])
        if columns == BLOCK_WIDTH and rows == BLOCK_HEIGHT:
            base, final = (
                block * 4 * BLOCK_LANES,
                load_block(transmittance, first_pixel + block * BLOCK_LANES),
            )
            first = 4 * (y * image.shape[1] + x)
            store_interleaved(
                flat_image,
                first,
                first + 4 * image.shape[1],
                fma(final, spread_block(background[0]), load_block(pixels, base + BLOCK_LANES)),
                fma(final, spread_block(background[1]), load_block(pixels, base + 2 * BLOCK_LANES)),
                fma(final, spread_block(background[2]), load_block(pixels, base + 3 * BLOCK_LANES)),
                fill(final, 1.0) - final,
            )
            continue
        for row in range(rows):
            for column in range(columns):
                lane = row * BLOCK_WIDTH + column
                at = block * 4 * BLOCK_LANES + lane
                T = transmittance[first_pixel + block * BLOCK_LANES + lane]
                pixel = image[y + row, x + column]
                pixel[0] = pixels[at + BLOCK_LANES] + T * background[0]
                pixel[1] = pixels[at + 2 * BLOCK_LANES] + T * background[1]
                pixel[2] = pixels[at + 3 * BLOCK_LANES] + T * background[2]
                pixel[3] = 1 - T


@kernel(allocates=True)
def draw_tiles(
    start,
    stop,
    offsets,
    base,
    lists,
    records,
    surfels,
    view,
    background,
    termination,
    image,
    transmittance,
    n_contrib,
):
    """Draws tiles [start, stop), numbered by rows, into image (H, W, 4). Returns the number of blocks that
    were blended.

    offsets (tiles + 1,) int64 and lists (pairs,) int32 as `tiles` makes them, lists[0] being place `base`;
    surfels is a `SurfelArrays` or None, termination a `Termination`. transmittance and n_contrib
    (tiles·TILE_PIXELS,) receive each pixel's final transmittance and last contributor, a place in its tile's
    list, one vector per block, strip by strip; both are 0 beyond the image. records (N, RECORD), background
    (3,), image, transmittance and n_contrib share one dtype.
    """
    gathered = aligned(gathered_columns(surfels) * CHUNK, image.dtype)
    touched = aligned(CHUNK, np.uint32)
    pixels, centres = aligned(PIXELS, image.dtype), aligned(CENTRES, image.dtype)
    items, members = aligned(ITEMS, np.int32), MEMBERS.reshape(-1)
    place_centres(centres)
    flat_image, listed = image.reshape(-1), offsets[stop] - base
    starts = np.empty(LANES, np.int64)
    flat_records = records.reshape(-1)
    blocks = 0
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        first_pixel = tile * TILE_PIXELS
        transmittance[first_pixel : first_pixel + TILE_PIXELS] = 0
        n_contrib[first_pixel : first_pixel + TILE_PIXELS] = 0
        start_pixels(pixels, left, top, view)
        first, end = offsets[tile] - base, offsets[tile + 1] - base
        position, alive = first, ALL_BLOCKS
        while position < end and alive:
            count = min(end - position, CHUNK)
            stop_at = min(position + count + CHUNK, listed)  # of the next tile's list too
            count = gather(
                lists,
                position,
                count,
                position + count,
                stop_at,
                flat_records,
                left,
                top,
                termination.max_log2_drop,
                gathered,
                surfels,
                starts,
            )
            touched_blocks(gathered, count, view.log2_cut, view.log2_share, touched)
            total = list_items(touched, 0, count, alive, members, items, None)
            blend_items(items, total, gathered, centres, view.max_alpha, pixels, surfels)
            blocks += total
            position += count
            alive = terminate_pixels(
                pixels, first_pixel, termination.stop_below, position - first, transmittance, n_contrib, alive
            )
        terminate_pixels(pixels, first_pixel, np.inf, position - first, transmittance, n_contrib, alive)
        write_pixels(pixels, left, top, first_pixel, background, transmittance, image, flat_image)
    return blocks
