"""Gradients of the blended picture by each splat's footprint, pair by pair.

The tiles are walked once more, back to front. With g the gradient of the loss by a pixel, T_i the
transmittance in front of splat i, and the scalar

    S_i = g·(what the pixel shows of everything behind splat i, background included)

one has dL/dalpha_i = T_i·(g·c_i) - S_i / (1 - alpha_i). Both are known behind the last splat, as forward
keeps each pixel's final transmittance and last contributor, and from there T_i = T_(i+1) / (1 - alpha_i) and
S_(i-1) = S_i + alpha_i·T_i·(g·c_i): no list of past transmittances is kept. Walked front to back, S would be
the whole pixel less all splats in front, with the rounding errors of
the brightest of them: gradients that cancel, as those by the camera's pose, had lost 3 digits by that.

Each pair's sums over the pixels of its tile go to a row of their own, and `gather_pairs` adds them up
splat by splat: nothing is shared between threads, and sums do not depend on how many there are.

With t = dL/dln(alpha), zero where alpha is capped, u = A·dx + B·dy and v = C·dy as in `project`, a row is
the sums of t, t·u, t·u·dx, t·u·dy, t·v, t·v·dy, of alpha·T·g for red, green and blue, and, where somebody
asks for them, |t·u| and |t·(B·u + C·v)|.
"""

from __future__ import annotations

import numpy as np

from splatview.raster.blocks import MEMBERS, exp2_by, exp2_constants
from splatview.raster.compiling import inline, kernel
from splatview.raster.forward import (
    BLOCKS,
    CENTRES,
    CHUNK,
    EXPONENTS,
    G_A,
    G_B,
    G_BLUE,
    G_C,
    G_GREEN,
    G_LOG2_OPACITY,
    G_RED,
    G_X,
    G_Y,
    GATHERED,
    ITEMS,
    NO_BLOCKS,
    STRIPS,
    TILE_PIXELS,
    block_in_image,
    gather,
    list_items,
    place_centres,
    touched_blocks,
)
from splatview.raster.parameters import TILE
from splatview.raster.simd import (
    BLOCK_LANES,
    BLOCK_WIDTH,
    LANES,
    absolute,
    aligned,
    any_within,
    fill,
    fma,
    greatest_lane,
    keep_if_at_least,
    keep_if_below,
    load,
    load_block,
    maximum,
    minimum,
    negate,
    prefetch,
    reciprocal,
    spread,
    spread_block,
    store,
    sum_lanes,
)

T, TU, TUX, TUY, TV, TVY, D_RED, D_GREEN, D_BLUE, ABS_X, ABS_Y = range(11)
SUMS = 16
"""Numbers per row of sums; the last five are 0."""

AHEAD = 8
"""Splats by which memory is prefetched, where splats are taken in depth order: that is any order in memory,
and the processor cannot guess ahead where loops are as short as here."""

PIXEL_VECTORS = 6
"""Vectors per strip and block: transmittance, S, the loss's gradient by red, green and blue, and S behind
all."""

PIXELS = PIXEL_VECTORS * TILE_PIXELS


@inline
def start_pixels(pixels, left, top, first_pixel, background, transmittance, d_image):
    """Fills `pixels` (PIXELS,); transmittance and S are 0 until `restore_pixels`, and all is 0 beyond the
    border. transmittance as `forward` leaves it; d_image (H, W, 4)."""
    pixels[:] = 0
    for block in range(STRIPS * BLOCKS):
        x, y, columns, rows = block_in_image(block, left, top, d_image.shape[1], d_image.shape[0])
        for row in range(rows):
            for column in range(columns):
                lane = row * BLOCK_WIDTH + column
                at = block * PIXEL_VECTORS * BLOCK_LANES + lane
                d_pixel = d_image[y + row, x + column]
                # Alpha is 1 - T: a gradient by alpha is minus one by the final transmittance.
                by_transmittance = -d_pixel[3]
                for channel in range(3):
                    pixels[at + (2 + channel) * BLOCK_LANES] = d_pixel[channel]
                    by_transmittance += d_pixel[channel] * background[channel]
                final = transmittance[first_pixel + block * BLOCK_LANES + lane]
                pixels[at + 5 * BLOCK_LANES] = final * by_transmittance


@inline
def most_contrib(first_pixel, n_contrib, below):
    """The greatest n_contrib below `below` of a tile's pixels."""
    limit = n_contrib.dtype.type(below)
    counts = load(n_contrib, first_pixel)
    most = keep_if_below(counts, counts, spread(limit))
    for at in range(first_pixel + LANES, first_pixel + TILE_PIXELS, LANES):
        counts = load(n_contrib, at)
        most = maximum(most, keep_if_below(counts, counts, spread(limit)))
    return np.int64(greatest_lane(most))


@inline
def restore_pixels(pixels, first_pixel, count, final_transmittance, n_contrib, alive):
    """Gives pixels whose n_contrib is `count` their final transmittance and S. Returns `alive`, a set of
    bits, with the blocks of such pixels."""
    before, behind = pixels.dtype.type(count - 0.5), pixels.dtype.type(count + 0.5)
    for strip in range(STRIPS):
        for block in range(BLOCKS):
            at = (strip * BLOCKS + block) * BLOCK_LANES
            ended = load_block(n_contrib, first_pixel + at)
            if any_within(ended, before, behind):
                base = at * PIXEL_VECTORS
                transmittance = load_block(pixels, base) + if_within(
                    load_block(final_transmittance, first_pixel + at), ended, before, behind
                )
                shown = load_block(pixels, base + BLOCK_LANES)
                shown = shown + if_within(load_block(pixels, base + 5 * BLOCK_LANES), ended, before, behind)
                store(pixels, base, transmittance)
                store(pixels, base + BLOCK_LANES, shown)
                alive |= np.uint64(1) << np.uint64(at // BLOCK_LANES)
    return alive


@inline
def if_within(value, x, above, below):
    """`value` where above <= x < below, else 0."""
    return keep_if_below(keep_if_at_least(value, x, spread_block(above)), x, spread_block(below))


@inline
def differentiate(
    gathered, start, stop, items, firsts, log2_cut, max_alpha, pixels, centres, first_row, sums, absolutes
):
    """Walks gathered splats [start, stop) from last to first; the sums of the j-th go to sums[first_row + j],
    sums being (pairs·SUMS,). items and firsts as `list_items` made them; absolutes None: without ABS_X and
    ABS_Y."""
    for k in range(start, stop):
        j = max(stop - 1 - (k - start), 0)  # max tells the compiler that no index is negative
        a, b = spread_block(gathered[G_A * CHUNK + j]), spread_block(gathered[G_B * CHUNK + j])
        c, log2_opacity = (
            spread_block(gathered[G_C * CHUNK + j]),
            spread_block(gathered[G_LOG2_OPACITY * CHUNK + j]),
        )
        red = spread_block(gathered[G_RED * CHUNK + j])
        green = spread_block(gathered[G_GREEN * CHUNK + j])
        blue = spread_block(gathered[G_BLUE * CHUNK + j])
        one = fill(red, 1.0)
        cut, cap = fill(red, log2_cut), fill(red, max_alpha)
        x_mean, y_mean = spread_block(gathered[G_X * CHUNK + j]), spread_block(gathered[G_Y * CHUNK + j])
        t_sum = tu_sum = tux_sum = tuy_sum = tv_sum = tvy_sum = abs_x = abs_y = fill(red, 0.0)
        red_sum = green_sum = blue_sum = fill(red, 0.0)
        # One loop over the blocks of all strips: the processor guesses the end of each wrong for most pairs.
        for n in range(np.int64(firsts[j]), np.int64(firsts[j + 1])):
            place = np.int64(items[n]) & (STRIPS * BLOCKS - 1)  # tells the compiler that no index is negative
            dx = load_block(centres, 2 * place * BLOCK_LANES) - x_mean
            dy = load_block(centres, (2 * place + 1) * BLOCK_LANES) - y_mean
            u, v = fma(b, dy, a * dx), c * dy
            power = fma(negate(u), u, fma(negate(v), v, log2_opacity))
            uncapped = exp2_by(exp2_constants(centres, EXPONENTS), power)
            alpha = keep_if_at_least(minimum(uncapped, cap), power, cut)

            base = place * PIXEL_VECTORS * BLOCK_LANES
            after, behind = load_block(pixels, base), load_block(pixels, base + BLOCK_LANES)
            d_red, d_green = (
                load_block(pixels, base + 2 * BLOCK_LANES),
                load_block(pixels, base + 3 * BLOCK_LANES),
            )
            d_blue = load_block(pixels, base + 4 * BLOCK_LANES)
            thinned = reciprocal(one - alpha)
            ratio = alpha * thinned
            weight = ratio * after
            shown = fma(d_red, red, fma(d_green, green, d_blue * blue))
            t = ratio * fma(after, shown, negate(behind))
            store(pixels, base, after * thinned)
            store(pixels, base + BLOCK_LANES, fma(weight, shown, behind))
            red_sum = fma(weight, d_red, red_sum)
            green_sum = fma(weight, d_green, green_sum)
            blue_sum = fma(weight, d_blue, blue_sum)

            t = keep_if_below(t, uncapped, cap)
            tu, tv = t * u, t * v
            t_sum = t_sum + t
            tu_sum = tu_sum + tu
            tv_sum = tv_sum + tv
            tux_sum = fma(tu, dx, tux_sum)
            tuy_sum = fma(tu, dy, tuy_sum)
            tvy_sum = fma(tv, dy, tvy_sum)
            if absolutes is not None:
                abs_x = abs_x + absolute(tu)
                abs_y = abs_y + absolute(fma(b, tu, c * tv))
        shape = t_sum, tu_sum, tux_sum, tuy_sum, tv_sum, tvy_sum
        colour = red_sum, green_sum, blue_sum
        if absolutes is None:
            store(sums, (first_row + j) * SUMS, sum_lanes((*shape, *colour)))
        else:
            store(sums, (first_row + j) * SUMS, sum_lanes((*shape, *colour, abs_x, abs_y)))


@inline
def add_background(pixels, first_pixel, transmittance, d_background):
    """Writes the sum of final transmittance times gradient by colour over a tile to d_background (3,). Uses
    up `pixels`."""
    red = green = blue = spread_block(pixels.dtype.type(0))
    for at in range(0, TILE_PIXELS, BLOCK_LANES):
        final, base = load_block(transmittance, first_pixel + at), at * PIXEL_VECTORS
        red = fma(final, load_block(pixels, base + 2 * BLOCK_LANES), red)
        green = fma(final, load_block(pixels, base + 3 * BLOCK_LANES), green)
        blue = fma(final, load_block(pixels, base + 4 * BLOCK_LANES), blue)
    store(pixels, 0, sum_lanes((red, green, blue)))
    for channel in range(3):
        d_background[channel] = pixels[channel]


@kernel(allocates=True)
def differentiate_tiles(
    start,
    stop,
    offsets,
    base,
    lists,
    records,
    view,
    background,
    transmittance,
    n_contrib,
    d_image,
    sums,
    walked,
    d_background,
    absolutes,
):
    """Writes the sums of the pairs of tiles [start, stop), how many pairs of each tile have any, and each
    tile's gradient by the background, d_background (tiles, 3) float64. absolutes None: without ABS_X, ABS_Y.

    offsets (tiles + 1,) int64; lists (pairs,) int32, lists[0] being place `base`; walked (tiles,) int64;
    transmittance and n_contrib as in `forward`; records (N, RECORD), background (3,), transmittance,
    n_contrib, d_image (H, W, 4) and sums (pairs·SUMS,) share one dtype.
    """
    gathered = aligned(GATHERED * CHUNK, d_image.dtype)
    touched = aligned(CHUNK, np.uint32)
    pixels, centres = aligned(PIXELS, d_image.dtype), aligned(CENTRES, d_image.dtype)
    place_centres(centres)
    starts = np.empty(LANES, np.int64)
    items, firsts = aligned(ITEMS, np.int32), np.empty(CHUNK + 1, np.uint32)
    members = MEMBERS.reshape(-1)
    flat_records = records.reshape(-1)
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        first_pixel = tile * TILE_PIXELS
        start_pixels(pixels, left, top, first_pixel, background, transmittance, d_image)
        alive = NO_BLOCKS
        first, end = offsets[tile] - base, offsets[tile + 1] - base
        until = min(most_contrib(first_pixel, n_contrib, np.inf), end - first)
        walked[tile] = until
        while until > 0:
            begin = (until - 1) // CHUNK * CHUNK
            next_start = first + max(begin - CHUNK, 0)
            gather(
                lists,
                first + begin,
                until - begin,
                next_start,
                first + begin,
                flat_records,
                left,
                top,
                -np.inf,
                gathered,
                None,
                starts,
            )
            touched_blocks(gathered, until - begin, view.log2_cut, view.log2_share, touched)
            while until > begin:
                alive = restore_pixels(pixels, first_pixel, until, transmittance, n_contrib, alive)
                before = max(most_contrib(first_pixel, n_contrib, until), begin)
                list_items(touched, before - begin, until - begin, alive, members, items, firsts)
                differentiate(
                    gathered,
                    before - begin,
                    until - begin,
                    items,
                    firsts,
                    view.log2_cut,
                    view.max_alpha,
                    pixels,
                    centres,
                    first + begin,
                    sums,
                    absolutes,
                )
                until = before
        add_background(pixels, first_pixel, transmittance, d_background[tile])


@kernel
def gather_pairs(
    start,
    stop,
    positions,
    order,
    runs,
    spans,
    first_tile,
    end_tile,
    offsets,
    base,
    walked,
    sums,
    splat_sums,
    again,
):
    """Adds up the sums of each splat of order[start:stop] over tiles [first_tile, end_tile), in the order
    of the tiles, into splat_sums (N·SUMS,); `again` says that rows hold sums of earlier tiles.

    The pairs are found as they were written: positions (tiles,) int64 says where, and is used up. Asking
    ahead for every row of a splat, not only for its first, made this 0 to 10 % faster (times 1.11, 0.99 and
    1.05 on a sphere of 100,000 splats, skull and playbot): half as much bookkeeping again for nothing.

    Dropped: no pass of its own. Binning can write each pair's number in the order of memory, and
    `project_backward` add the rows up: for 100,000 splats at 256x256 binning, backward, gather and what
    follows took 22.4 ms, and 23.0 with rows stored in that order and asked for ahead (25.0 without, 24.8 past
    the caches), 22.5 with rows read in it. Rows in any order are what costs, whoever meets them.
    """
    nothing = spread(sums.dtype.type(0))
    for k in range(start, stop):
        if k + AHEAD < stop:
            prefetch(splat_sums, order[k + AHEAD] * SUMS)
            if runs[k + AHEAD, 1] > 0:
                prefetch(sums, (positions[spans[runs[k + AHEAD, 0], 0]] - base) * SUMS)
        splat = order[k]
        total = nothing
        if again:
            total = load(splat_sums, splat * SUMS)
        for row in range(runs[k, 0], runs[k, 0] + runs[k, 1]):
            for tile in range(max(spans[row, 0], first_tile), min(spans[row, 1], end_tile)):
                position = positions[tile]
                positions[tile] = position + 1
                if position - offsets[tile] < walked[tile]:
                    total = total + load(sums, (position - base) * SUMS)
        store(splat_sums, splat * SUMS, total)
