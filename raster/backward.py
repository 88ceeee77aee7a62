"""Gradients of the blended picture by each splat's footprint, pair by pair.

The tiles are walked front to back once more, in the same chunks and with the same decisions as in
`forward`. With g the gradient of the loss by a pixel, T_i the light in front of splat i, and the scalar

    S_i = g·(what the pixel shows of everything behind splat i, background included)

one has dL/dalpha_i = T_i·(g·c_i) - S_i / (1 - alpha_i). S starts as g·(the whole pixel), which forward
has left in the image, and each splat takes its own share off: no list of past transmittances is kept.

Each pair's sums over the pixels of its tile go to a row of their own, and `gather_pairs` adds them up
splat by splat: nothing is shared between threads, and sums do not depend on how many there are.

With t = dL/dln(alpha), zero where alpha is capped, u = A·dx + B·dy and v = C·dy as in `project`, a row is
the sums of t, t·u, t·u·dx, t·u·dy, t·v, t·v·dy, |t·u|, |t·(B·u + C·v)|, and of alpha·T·g for red, green
and blue.
"""

from __future__ import annotations

import numpy as np

from .bins import AHEAD, ask_ahead
from .compiling import inline, kernel
from .exp import exp2
from .forward import (
    BLOCKS,
    CHUNK,
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
    STRIPS,
    gather,
    touched_blocks,
)
from .simd import (
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    LANES,
    absolute,
    aligned,
    any_above,
    column_centres,
    fill,
    fma,
    keep_if_at_least,
    keep_if_below,
    load,
    minimum,
    negate,
    prefetch,
    reciprocal,
    row_centres,
    spread,
    store,
    sum_lanes,
)
from .view import TILE

T, TU, TUX, TUY, TV, TVY, ABS_X, ABS_Y, D_RED, D_GREEN, D_BLUE = range(11)
SUMS = 16
"""Numbers in a row of sums; the last five are 0."""

PIXEL_VECTORS = 5
"""By strip and block: transmittance, S, and the loss's gradient by red, green and blue."""

PIXELS = STRIPS * BLOCKS * PIXEL_VECTORS * LANES


@inline
def pixel_index(x, y):
    """Where the transmittance of pixel (x, y) of a tile is; the others follow at steps of LANES."""
    block = (x // BLOCK_WIDTH) * BLOCKS + y // BLOCK_HEIGHT
    return block * PIXEL_VECTORS * LANES + (y % BLOCK_HEIGHT) * BLOCK_WIDTH + x % BLOCK_WIDTH


@inline
def start_pixels(pixels, left, top, image, d_image):
    """Fills `pixels` (PIXELS,) from image and its gradient, both (H, W, 4); beyond the border all is 0."""
    pixels[:] = 0
    for y in range(min(TILE, image.shape[0] - top)):
        for x in range(min(TILE, image.shape[1] - left)):
            pixel, d_pixel = image[top + y, left + x], d_image[top + y, left + x]
            at = pixel_index(x, y)
            pixels[at] = 1
            # Alpha is 1 - T, so a gradient by alpha is one by the light that is left, with its sign turned.
            pixels[at + LANES] = (
                d_pixel[0] * pixel[0] + d_pixel[1] * pixel[1] + d_pixel[2] * pixel[2]
            ) - d_pixel[3] * (1 - pixel[3])
            for channel in range(3):
                pixels[at + (2 + channel) * LANES] = d_pixel[channel]


@inline
def shrink_alive(pixels, stop_below, alive):
    """As in `forward`: narrows alive (2·STRIPS,) to blocks with light left; whether there is one."""
    some = False
    step = PIXEL_VECTORS * LANES
    for strip in range(STRIPS):
        first, last = alive[2 * strip], alive[2 * strip + 1]
        while first <= last and not any_above(load(pixels, (strip * BLOCKS + first) * step), stop_below):
            first += 1
        while first <= last and not any_above(load(pixels, (strip * BLOCKS + last) * step), stop_below):
            last -= 1
        alive[2 * strip], alive[2 * strip + 1] = first, last
        some = some or first <= last
    return some


@inline
def differentiate_chunk(gathered, count, rows, alive, log2_cut, max_alpha, pixels, first_row, sums):
    """Walks gathered splats; the sums of the j-th go to sums[first_row + j], sums being (pairs·SUMS,)."""
    number = gathered.dtype.type
    for j in range(count):
        a, b = spread(gathered[G_A * CHUNK + j]), spread(gathered[G_B * CHUNK + j])
        c, log2_opacity = spread(gathered[G_C * CHUNK + j]), spread(gathered[G_LOG2_OPACITY * CHUNK + j])
        red = spread(gathered[G_RED * CHUNK + j])
        green = spread(gathered[G_GREEN * CHUNK + j])
        blue = spread(gathered[G_BLUE * CHUNK + j])
        one, step = fill(red, 1.0), fill(red, BLOCK_HEIGHT)
        cut, cap = fill(red, log2_cut), fill(red, max_alpha)
        y_centres = row_centres(red) - spread(gathered[G_Y * CHUNK + j])
        t_sum = tu_sum = tux_sum = tuy_sum = tv_sum = tvy_sum = abs_x = abs_y = fill(red, 0.0)
        red_sum = green_sum = blue_sum = fill(red, 0.0)
        for strip in range(STRIPS):
            first = max(np.int64(rows[2 * strip * CHUNK + j]), alive[2 * strip])
            last = min(np.int64(rows[(2 * strip + 1) * CHUNK + j]), alive[2 * strip + 1])
            x_mean = gathered[G_X * CHUNK + j] - number(strip * BLOCK_WIDTH)
            dx = column_centres(red) - spread(x_mean)
            adx = a * dx
            dy = y_centres + fill(red, first * BLOCK_HEIGHT)
            for block in range(first, last + 1):
                u, v = fma(b, dy, adx), c * dy
                power = fma(negate(u), u, fma(negate(v), v, log2_opacity))
                uncapped = exp2(power)
                alpha = keep_if_at_least(minimum(uncapped, cap), power, cut)

                base = (strip * BLOCKS + block) * PIXEL_VECTORS * LANES
                light, behind = load(pixels, base), load(pixels, base + LANES)
                d_red, d_green = load(pixels, base + 2 * LANES), load(pixels, base + 3 * LANES)
                d_blue = load(pixels, base + 4 * LANES)
                weight = alpha * light
                shown = fma(d_red, red, fma(d_green, green, d_blue * blue))
                behind = fma(negate(weight), shown, behind)
                store(pixels, base, light - weight)
                store(pixels, base + LANES, behind)
                red_sum = fma(weight, d_red, red_sum)
                green_sum = fma(weight, d_green, green_sum)
                blue_sum = fma(weight, d_blue, blue_sum)

                t = weight * shown - alpha * behind * reciprocal(one - alpha)
                t = keep_if_below(t, uncapped, cap)
                tu, tv = t * u, t * v
                t_sum = t_sum + t
                tu_sum = tu_sum + tu
                tv_sum = tv_sum + tv
                tux_sum = fma(tu, dx, tux_sum)
                tuy_sum = fma(tu, dy, tuy_sum)
                tvy_sum = fma(tv, dy, tvy_sum)
                abs_x = abs_x + absolute(tu)
                abs_y = abs_y + absolute(fma(b, tu, c * tv))
                dy = dy + step
        total = sum_lanes(
            (
                t_sum,
                tu_sum,
                tux_sum,
                tuy_sum,
                tv_sum,
                tvy_sum,
                abs_x,
                abs_y,
                red_sum,
                green_sum,
                blue_sum,
            )
        )
        store(sums, (first_row + j) * SUMS, total)


@inline
def add_background(pixels, d_background):
    """Writes the sum of the light left times the gradient by colour over a tile to d_background (3,)."""
    red = green = blue = spread(pixels.dtype.type(0))
    for base in range(0, PIXELS, PIXEL_VECTORS * LANES):
        light = load(pixels, base)
        red = fma(light, load(pixels, base + 2 * LANES), red)
        green = fma(light, load(pixels, base + 3 * LANES), green)
        blue = fma(light, load(pixels, base + 4 * LANES), blue)
    total = aligned(LANES, pixels.dtype)
    store(total, 0, sum_lanes((red, green, blue)))
    for channel in range(3):
        d_background[channel] = total[channel]


@kernel
def differentiate_tiles(
    start, stop, offsets, base, lists, records, view, stop_below, image, d_image, sums, walked, d_background
):
    """Writes the sums of the pairs of tiles [start, stop), how many pairs of each tile have any, and each
    tile's gradient by the background, d_background (tiles, 3) float64.

    offsets (tiles + 1,) int64; lists (pairs,) int32, lists[0] being place `base`; walked (tiles,) int64;
    records (N, RECORD), image and d_image (H, W, 4) and sums (pairs·SUMS,) in one dtype.
    """
    gathered = aligned(GATHERED * CHUNK, image.dtype)
    rows = aligned(STRIPS * 2 * CHUNK, np.int32)
    pixels = aligned(PIXELS, image.dtype)
    alive = np.empty(2 * STRIPS, np.int64)
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        start_pixels(pixels, left, top, image, d_image)
        for strip in range(STRIPS):
            alive[2 * strip], alive[2 * strip + 1] = 0, BLOCKS - 1
        position, end = offsets[tile] - base, offsets[tile + 1] - base
        while position < end and shrink_alive(pixels, stop_below, alive):
            count = min(end - position, CHUNK)
            gather(lists, position, count, end, records, left, top, gathered)
            touched_blocks(gathered, count, view.log2_cut, rows)
            differentiate_chunk(
                gathered, count, rows, alive, view.log2_cut, view.max_alpha, pixels, position, sums
            )
            position += count
        walked[tile] = position + base - offsets[tile]
        add_background(pixels, d_background[tile])


@kernel
def gather_pairs(
    start,
    stop,
    positions,
    order,
    spans_of,
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

    The pairs are found as they were written: positions (tiles,) int64 says where, and is used up.
    """
    nothing = spread(sums.dtype.type(0))
    for k in range(start, stop):
        ask_ahead(k, stop, order, spans_of, spans)
        if k + AHEAD < stop:
            soon = order[k + AHEAD]
            prefetch(splat_sums, soon * SUMS)
            if spans_of[soon, 0] < spans_of[soon, 1]:
                prefetch(sums, (positions[spans[spans_of[soon, 0], 0]] - base) * SUMS)
        splat = order[k]
        total = nothing
        if again:
            total = load(splat_sums, splat * SUMS)
        for span in range(spans_of[splat, 0], spans_of[splat, 1]):
            for tile in range(max(spans[span, 0], first_tile), min(spans[span, 1], end_tile)):
                position = positions[tile]
                positions[tile] = position + 1
                if position - offsets[tile] < walked[tile]:
                    total = total + load(sums, (position - base) * SUMS)
        store(splat_sums, splat * SUMS, total)
