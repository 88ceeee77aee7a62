"""Modes that draw splats as ever, and paint them: their depths or normals, or one each for overdraw.

Depths and normals replace the colours of projected splats, and are blended as those are. Sums of depths, and
counts of splats, become colours pixel by pixel afterwards.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.blocks import MEMBERS
from splatview.raster.compiling import inline, kernel
from splatview.raster.edits import MOVES, moved, palette_row, turned
from splatview.raster.forward import (
    ALL_BLOCKS,
    BLOCKS,
    CENTRES,
    CHUNK,
    G_CUT,
    ITEMS,
    PLACE_BITS,
    STRIPS,
    TILE_PIXELS,
    block_in_image,
    exponent_at,
    gather,
    gathered_columns,
    list_items,
    place_centres,
    touched_blocks,
)
from splatview.raster.parameters import TILE
from splatview.raster.project import BLUE, GREEN, RED, camera_point, rotation_matrix
from splatview.raster.simd import (
    BLOCK_LANES,
    BLOCK_WIDTH,
    LANES,
    aligned,
    fill,
    keep_if_at_least,
    load_block,
    spread_block,
    store,
)


@kernel
def paint_depths(start, stop, visible, depths, records):
    """Replaces red of the records of visible[start:stop] by depths (N,), world units."""
    for k in range(start, stop):
        records[visible[k], RED] = depths[visible[k]]


@kernel
def paint_normals(start, stop, visible, means, quats, log_scales, view, parallel, flat, edits, records):
    """Replaces the colours of the records of visible[start:stop] by those of `scene.normals`: the axis of the
    smallest scale, or the third where `flat`, turned to the eye. `parallel`: rays do not come from it."""
    for k in range(start, stop):
        i = visible[k]
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        a, b = np.float64(quats[i, 0]), np.float64(quats[i, 1])
        c, d = np.float64(quats[i, 2]), np.float64(quats[i, 3])
        if edits is not None:
            row = edits.palette[palette_row(edits, i)]
            if row[MOVES] > 0:
                x, y, z = moved(row, x, y, z)
                a, b, c, d = turned(row, a, b, c, d)
        shrink = 1 / math.sqrt(a * a + b * b + c * c + d * d)
        r = rotation_matrix(a * shrink, b * shrink, c * shrink, d * shrink)
        s0, s1, s2 = log_scales[i, 0], log_scales[i, 1], log_scales[i, 2]
        if flat or (s2 < s0 and s2 < s1):
            nx, ny, nz = camera_point(view, r[2], r[5], r[8])
        elif s1 < s0:
            nx, ny, nz = camera_point(view, r[1], r[4], r[7])
        else:
            nx, ny, nz = camera_point(view, r[0], r[3], r[6])
        away = nz
        if not parallel:
            tx, ty, tz = camera_point(view, x - view.eye[0], y - view.eye[1], z - view.eye[2])
            away = nx * tx + ny * ty + nz * tz
        half = -0.5 if away > 0 else 0.5
        records[i, RED], records[i, GREEN], records[i, BLUE] = (
            0.5 + half * nx,
            0.5 - half * ny,
            0.5 - half * nz,
        )


@inline
def count_items(items, total, gathered, centres, pixels, surfels):
    """Counts gathered splats in the `pixels` (TILE_PIXELS,) of a tile; arguments as in `blend_items`."""
    for n in range(total):
        item = np.int64(items[n])
        j, place = (item >> PLACE_BITS) & (CHUNK - 1), item & (STRIPS * BLOCKS - 1)
        power = exponent_at(gathered, centres, j, place, surfels)
        one, cut, at = fill(power, 1.0), spread_block(gathered[G_CUT * CHUNK + j]), place * BLOCK_LANES
        store(pixels, at, load_block(pixels, at) + keep_if_at_least(one, power, cut))


@kernel(allocates=True)
def count_tiles(start, stop, offsets, base, lists, records, surfels, view, counts):
    """Writes how many splats touch each pixel of tiles [start, stop), hidden ones included: counts (H, W) in
    the records' dtype. Returns the number of blocks evaluated. The other arguments as in `forward`."""
    gathered = aligned(gathered_columns(surfels) * CHUNK, records.dtype)
    touched, items = aligned(CHUNK, np.uint32), aligned(ITEMS, np.int32)
    pixels, centres = aligned(TILE_PIXELS, records.dtype), aligned(CENTRES, records.dtype)
    members = MEMBERS.reshape(-1)
    place_centres(centres)
    flat_records, starts = records.reshape(-1), np.empty(LANES, np.int64)
    blocks = 0
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        pixels[:] = 0
        position, end = offsets[tile] - base, offsets[tile + 1] - base
        while position < end:
            count = min(end - position, CHUNK)
            stop_at = min(position + 2 * CHUNK, end)
            count = gather(
                lists,
                position,
                count,
                position + count,
                stop_at,
                flat_records,
                left,
                top,
                -np.inf,
                gathered,
                surfels,
                starts,
            )
            touched_blocks(gathered, count, view.log2_cut, view.log2_share, touched)
            total = list_items(touched, 0, count, ALL_BLOCKS, members, items, None)
            count_items(items, total, gathered, centres, pixels, surfels)
            blocks += total
            position += count
        for block in range(STRIPS * BLOCKS):
            x, y, columns, block_rows = block_in_image(block, left, top, counts.shape[1], counts.shape[0])
            for row in range(block_rows):
                for column in range(columns):
                    counts[y + row, x + column] = pixels[block * BLOCK_LANES + row * BLOCK_WIDTH + column]
    return blocks


@inline
def map_colour(coefficients, t, channel):
    """A polynomial (powers, 3), highest power first, at t; 0 to 1."""
    value = coefficients[0, channel]
    for power in range(1, coefficients.shape[0]):
        value = value * t + coefficients[power, channel]
    return min(max(value, 0.0), 1.0)


@kernel
def map_depths(start, stop, near, far, coefficients, image):
    """Turns rows [start, stop) of image (H, W, 4), over black, from sums of depths in red into colours, near
    ones by the map's end. Expected depth: the mean over what the pixel shows."""
    for y in range(start, stop):
        for x in range(image.shape[1]):
            opacity = np.float64(image[y, x, 3])
            depth = image[y, x, 0] / max(opacity, 1e-6)
            t = 1 - min(max((depth - near) / (far - near), 0.0), 1.0)
            for channel in range(3):
                image[y, x, channel] = map_colour(coefficients, t, channel) * opacity


@kernel
def map_counts(start, stop, counts, most, coefficients, image):
    """Writes rows [start, stop) of image (H, W, 4) from counts (H, W): each doubling is the same step of
    colour, `most` the last one."""
    step = 1 / math.log2(1.0 + most)
    for y in range(start, stop):
        for x in range(image.shape[1]):
            t = min(math.log2(1.0 + counts[y, x]) * step, 1.0)
            for channel in range(3):
                image[y, x, channel] = map_colour(coefficients, t, channel)
            image[y, x, 3] = 1
