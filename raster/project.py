"""Gaussians to image footprints: steps 1 to 3 (or 2d and 3d) and 6 of the image model, one splat at a time.

The numbers in between are float64 in both variants, so that the float32 records below hold the footprints of
needles and of far-away scenes to their last digit; exponentials and logarithms are as exact as that needs
(`exponentials.EXP_DEGREE_FOR`: `project` took 0.9 of the time). Determinant and conic have the forms of
`scene.projection`. Only colours are summed in the dtype of the pictures, which show no more digits of them:
in float32 `project` took 0.95 of the time.

A record is one row of RECORD numbers, a cache line in float32, in the dtype of the pictures:

    X, Y            px, the mean in the image, rounded
    X_REST, Y_REST  px, what rounding X and Y left over
    A, B, C         with p = LOG2_OPACITY - (A·dx + B·dy)² - (C·dy)², alpha = 2^p
    LOG2_OPACITY    after the antialiasing factor
    RED, GREEN, BLUE
    RX, RY          px, half extents: beyond mean ± this, alpha is below the cut
    LOG2_DROP       log2(1 - alpha) at its most: the greatest log2 transmittance drop behind the splat
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.camera_models import image_axes, image_point, viewing_direction, within_lens
from splatview.raster.compiling import inline, kernel
from splatview.raster.edits import (
    FADES,
    LOG_FACTOR,
    MOVES,
    RECOLOURS,
    faded,
    is_shown,
    moved,
    palette_row,
    recoloured,
    turned,
    turned_back,
)
from splatview.raster.exponentials import exp_lanes, log2_lanes
from splatview.raster.parameters import HALF_LOG2_E, TILE
from splatview.raster.sh import ask_for_sh, sh_basis, sh_sum_of_rows
from splatview.raster.simd import (
    LANES,
    PART_LANES,
    aligned,
    any_above,
    ceil,
    converted,
    fill,
    floor,
    keep_if_at_least,
    keep_if_below,
    load_part,
    maximum,
    minimum,
    store,
    store_int,
    store_run,
    widened,
)
from splatview.raster.surfels import SURFEL, project_surfels
from splatview.raster.transpose import (
    MOST_CACHED,
    column,
    finish_stores,
    passes_caches,
    set_column,
    store_rows,
)
from splatview.scene.image_model import MIN_QUAT_COMPONENT
from splatview.scene.projection import FLOAT32_MAX

X, Y, X_REST, Y_REST, A, B, C, LOG2_OPACITY, RED, GREEN, BLUE, RX, RY, LOG2_DROP = range(14)
RECORD = 16
"""Numbers per record; the last two are padding to a cache line."""

CONIC_SCALE = math.sqrt(HALF_LOG2_E)

MOST_ALPHA = 1 - 2.0**-24
"""Alpha that LOG2_DROP takes in place of 1."""


@inline
def camera_point(view, x, y, z):
    """World offset from the eye -> camera axes."""
    r = view.rotation
    return (
        r[0, 0] * x + r[0, 1] * y + r[0, 2] * z,
        r[1, 0] * x + r[1, 1] * y + r[1, 2] * z,
        r[2, 0] * x + r[2, 1] * y + r[2, 2] * z,
    )


@inline
def is_finite(value):
    """Finite in float32; false for NaN."""
    return abs(value) <= FLOAT32_MAX


@inline
def rotation_matrix(w, x, y, z):
    """Unit quaternion -> nine entries, row by row."""
    return (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )


@inline
def sigmoid(logit):
    decay = math.exp(-abs(logit))
    return (1.0 if logit >= 0 else decay) / (1.0 + decay)


@inline
def sigmoid_lanes(logit, pictures):
    """The same in every lane; see `exp_lanes`."""
    decay = exp_lanes(-abs(logit), pictures)
    one, zero = fill(logit, 1.0), fill(logit, 0.0)
    return (keep_if_at_least(one, logit, zero) + keep_if_below(decay, logit, zero)) / (one + decay)


@inline
def splat_axes(p, r, sx, sy, sz):
    """M = P·R·diag(s): (2, 3), row by row."""
    return (
        (p[0] * r[0] + p[1] * r[3] + p[2] * r[6]) * sx,
        (p[0] * r[1] + p[1] * r[4] + p[2] * r[7]) * sy,
        (p[0] * r[2] + p[1] * r[5] + p[2] * r[8]) * sz,
        (p[3] * r[0] + p[4] * r[3] + p[5] * r[6]) * sx,
        (p[3] * r[1] + p[4] * r[4] + p[5] * r[7]) * sy,
        (p[3] * r[2] + p[4] * r[5] + p[5] * r[8]) * sz,
    )


@inline
def covariance(m, blur):
    """S'xx, S'xy, S'yy, det S', det of S' without blur; determinants as sums of positive terms."""
    xx = m[0] * m[0] + m[1] * m[1] + m[2] * m[2]
    xy = m[0] * m[3] + m[1] * m[4] + m[2] * m[5]
    yy = m[3] * m[3] + m[4] * m[4] + m[5] * m[5]
    nx, ny, nz = m[1] * m[5] - m[2] * m[4], m[2] * m[3] - m[0] * m[5], m[0] * m[4] - m[1] * m[3]
    unblurred = nx * nx + ny * ny + nz * nz
    return xx + blur, xy, yy + blur, unblurred + blur * (xx + yy) + blur * blur, unblurred


@inline
def camera_axes(view, r):
    """The columns of a rotation, nine entries row by row, in camera axes."""
    return (
        camera_point(view, r[0], r[3], r[6]),
        camera_point(view, r[1], r[4], r[7]),
        camera_point(view, r[2], r[5], r[8]),
    )


@inline
def squared_extent(view, log2_opacity):
    """The squared distance from the mean, in standard deviations, at which alpha falls below the cut that the
    kernels use, which is never quite 0."""
    return min(log2_opacity - view.log2_cut, -view.log2_share) * (1 / HALF_LOG2_E)


# A group of LANES splats is worked on in columns of LANES float64 numbers each: first the loaded parameters,
# ...
OFFSET, QUAT, LOG_SCALE, LOGIT = 0, 3, 7, 10
# ... then the results of `project_group`: the order of a record, the direction, the depth, and 1 or 0 for
# whether the splat is drawn, its colour apart.
FOOTPRINT, TOWARDS, DEPTH, DRAWN = 11, 25, 28, 29
SURFEL_ROW = 30  # and a row of `surfels`, if any
COLUMNS = SURFEL_ROW + SURFEL


@inline
def load_splat(i, lane, means, quats, log_scales, opacity_logits, view, lanes):
    """Copies the parameters of splat i to a lane of the columns; its mean becomes an offset from the eye.

    Dropped: rows of three and four numbers by vectors, turned into columns by shuffles as `load_rows` does:
    `project` took 1.13 to 1.15 times as long, `project_backward` 1.08.
    """
    for axis in range(3):
        lanes[(OFFSET + axis) * LANES + lane] = np.float64(means[i, axis]) - view.eye[axis]
        lanes[(LOG_SCALE + axis) * LANES + lane] = log_scales[i, axis]
    for component in range(4):
        lanes[(QUAT + component) * LANES + lane] = quats[i, component]
    lanes[LOGIT * LANES + lane] = opacity_logits[i]


@inline
def edit_splat(i, lane, edits, view, lanes):
    """Changes the parameters that `load_splat` has put in a lane by the edits of splat i: its offset back
    to a mean in between, as edits speak of the world. What is not shown gets a quaternion of zeros, which is
    culled. Returns whether the palette has what the splat's mark names."""
    entry = palette_row(edits, i)
    if entry >= edits.palette.shape[0]:
        return False
    row = edits.palette[entry]
    at, eye = OFFSET * LANES + lane, view.eye
    x, y, z = lanes[at] + eye[0], lanes[at + LANES] + eye[1], lanes[at + 2 * LANES] + eye[2]
    quat = QUAT * LANES + lane
    if row[MOVES] > 0:
        x, y, z = moved(row, x, y, z)
        lanes[at], lanes[at + LANES], lanes[at + 2 * LANES] = x - eye[0], y - eye[1], z - eye[2]
        w, p, q, r = turned(
            row, lanes[quat], lanes[quat + LANES], lanes[quat + 2 * LANES], lanes[quat + 3 * LANES]
        )
        lanes[quat], lanes[quat + LANES], lanes[quat + 2 * LANES], lanes[quat + 3 * LANES] = w, p, q, r
    for axis in range(3):
        lanes[(LOG_SCALE + axis) * LANES + lane] += row[LOG_FACTOR]
    if row[FADES] > 0:
        lanes[LOGIT * LANES + lane] = faded(row, lanes[LOGIT * LANES + lane])
    if not is_shown(edits, i, x, y, z):
        for component in range(4):
            lanes[(QUAT + component) * LANES + lane] = 0.0
    return True


@inline
def three_columns(lanes, index):
    return column(lanes, index), column(lanes, index + 1), column(lanes, index + 2)


@inline
def four_columns(lanes, index):
    return *three_columns(lanes, index), column(lanes, index + 3)


@inline
def column_part(lanes, index):
    return load_part(lanes, index * LANES)


@inline
def three_parts(lanes, index):
    return column_part(lanes, index), column_part(lanes, index + 1), column_part(lanes, index + 2)


@inline
def set_three(lanes, index, x, y, z):
    set_column(lanes, index, x)
    set_column(lanes, index + 1, y)
    set_column(lanes, index + 2, z)


@inline
def four_parts(lanes, index):
    return *three_parts(lanes, index), column_part(lanes, index + 3)


@inline
def if_finite(drawn, value):
    """`drawn`, and 0 where a value is not finite in float32."""
    return keep_if_at_least(drawn, fill(drawn, FLOAT32_MAX), abs(value))


@inline
def if_three_finite(drawn, x, y, z):
    return if_finite(if_finite(if_finite(drawn, x), y), z)


@inline
def project_group(view, optics, surfels, lanes, first, pictures):
    """Fills the columns from FOOTPRINT on from the loaded ones, of PART_LANES splats from lane `first` on.
    `pictures` is an array of the pictures' dtype.

    Of all LANES at once hardly a number stays in a register: `project` took 1.02 to 1.07 times as long.
    `project_backward` did not gain by it (1.03).
    """
    lens, parallel = optics
    lanes = lanes[first:]
    ox, oy, oz = three_parts(lanes, OFFSET)
    tx, ty, tz = camera_point(view, ox, oy, oz)
    nothing, one = fill(tx, 0.0), fill(tx, 1.0)
    drawn = keep_if_at_least(one, tz, fill(tz, view.near))  # guard: near plane := drawn = one
    drawn = if_three_finite(if_three_finite(drawn, ox, oy, oz), tx, ty, tz)
    drawn = within_lens(lens, drawn, tx, ty, tz)
    set_column(lanes, DEPTH, tz)
    towards_x, towards_y, towards_z, _ = viewing_direction(parallel, view, ox, oy, oz)
    set_three(lanes, TOWARDS, towards_x, towards_y, towards_z)

    qw, qx, qy, qz = four_parts(lanes, QUAT)
    largest = max(max(abs(qw), abs(qx)), max(abs(qy), abs(qz)))  # noqa: PLW3301 vectors come in twos
    # guard: zero quaternions
    drawn = keep_if_at_least(drawn, largest, fill(largest, MIN_QUAT_COMPONENT))
    drawn = if_finite(if_three_finite(drawn, qw, qx, qy), qz)
    sx, sy, sz = three_parts(lanes, LOG_SCALE)
    sx, sy, sz = exp_lanes(sx, pictures), exp_lanes(sy, pictures), exp_lanes(sz, pictures)
    drawn = if_three_finite(drawn, sx, sy, sz)

    shrink = one / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    rotation = rotation_matrix(qw * shrink, qx * shrink, qy * shrink, qz * shrink)
    opacity = sigmoid_lanes(column_part(lanes, LOGIT), pictures)
    if surfels is None:
        axes = splat_axes(image_axes(lens, parallel, view, tx, ty, tz), rotation, sx, sy, sz)
    else:
        bound = squared_extent(view, log2_lanes(opacity, pictures))
        turned_axes = camera_axes(view, rotation)
        can_show, axes = project_surfels(
            view, surfels.perspective, tx, ty, tz, turned_axes, (sx, sy, sz), bound, lanes, SURFEL_ROW
        )
        drawn = keep_if_below(drawn, nothing, can_show)
    xx, xy, yy, det, unblurred = covariance(axes, view.blur)
    drawn = if_three_finite(keep_if_below(drawn, nothing, det), xx, xy, yy)
    if surfels is None and view.antialiased:
        opacity = opacity * math.sqrt(unblurred / det)
    drawn = keep_if_below(drawn, nothing, opacity)
    drawn = keep_if_at_least(drawn, opacity, fill(opacity, view.alpha_cut))

    inverse = one / (yy * det)
    inverse_yy, root_yy = inverse * det, math.sqrt(yy)
    a, c = math.sqrt(yy * yy * inverse), root_yy * inverse_yy
    b = -(xy * inverse_yy * a)
    drawn = if_three_finite(drawn, a, b, c)
    x, y = image_point(lens, parallel, view, tx, ty, tz)
    drawn = if_finite(if_finite(drawn, x), y)
    log2_opacity = log2_lanes(opacity, pictures)
    extent = math.sqrt(squared_extent(view, log2_opacity))  # apart, as the product may overflow
    rx, ry = extent * math.sqrt(xx), extent * root_yy
    drawn = keep_if_at_least(drawn, x + rx, fill(x, 0.5))
    drawn = keep_if_at_least(drawn, y + ry, fill(y, 0.5))
    drawn = keep_if_at_least(drawn, fill(x, view.width - 0.5), x - rx)
    drawn = keep_if_at_least(drawn, fill(y, view.height - 0.5), y - ry)

    set_column(lanes, DRAWN, drawn)
    set_column(lanes, FOOTPRINT + X, x)
    set_column(lanes, FOOTPRINT + Y, y)
    set_column(lanes, FOOTPRINT + A, a * CONIC_SCALE)
    set_column(lanes, FOOTPRINT + B, b * CONIC_SCALE)
    set_column(lanes, FOOTPRINT + C, c * CONIC_SCALE)
    set_column(lanes, FOOTPRINT + LOG2_OPACITY, log2_opacity)
    set_column(lanes, FOOTPRINT + RX, rx)
    set_column(lanes, FOOTPRINT + RY, ry)
    most_alpha = min(view.max_alpha, MOST_ALPHA)
    set_column(lanes, FOOTPRINT + LOG2_DROP, log2_lanes(one - min(opacity, most_alpha), pictures))


@inline
def shade_group(degree, flat_sh, starts, basis, lanes):
    """Fills the columns of colours, of the directions in the columns and the rows of SH that begin at starts
    (LANES,) int64; what has none that is finite is not drawn."""
    dx, dy, dz = three_columns(lanes, TOWARDS)
    sh_basis(converted(dx, basis), converted(dy, basis), converted(dz, basis), degree, basis)
    red, green, blue = sh_sum_of_rows(flat_sh, starts, 3 * (degree + 1) * (degree + 1), basis)
    red, green, blue = widened(red), widened(green), widened(blue)
    drawn, infinite = column(lanes, DRAWN), fill(red, np.inf)
    drawn = keep_if_below(drawn, abs(red), infinite)  # guard: finite colours
    drawn = keep_if_below(drawn, abs(green), infinite)  # guard: finite colours
    drawn = keep_if_below(drawn, abs(blue), infinite)  # guard: finite colours
    set_column(lanes, DRAWN, drawn)
    set_three(lanes, FOOTPRINT + RED, red, green, blue)


@inline
def cut_colours(lanes):
    """Cuts the columns of colours at 0; what is beyond float32 is not drawn."""
    red, green, blue = three_columns(lanes, FOOTPRINT + RED)
    nothing = fill(red, 0.0)
    red, green, blue = max(red, nothing), max(green, nothing), max(blue, nothing)  # guard: colours at least 0
    # guard: finite colours
    set_column(lanes, DRAWN, if_three_finite(column(lanes, DRAWN), red, green, blue))
    set_three(lanes, FOOTPRINT + RED, red, green, blue)


@inline
def turn_back(i, lane, edits, lanes):
    """Turns the direction in a lane back into the axes in which splat i has its colours."""
    at = TOWARDS * LANES + lane
    row = edits.palette[palette_row(edits, i)]
    x, y, z = turned_back(row, lanes[at], lanes[at + LANES], lanes[at + 2 * LANES])
    lanes[at], lanes[at + LANES], lanes[at + 2 * LANES] = x, y, z


@inline
def recolour(i, lane, edits, lanes):
    """Changes the colour in a lane by the edits of splat i."""
    row = edits.palette[palette_row(edits, i)]
    if row[RECOLOURS] > 0:
        at = (FOOTPRINT + RED) * LANES + lane
        red, green, blue = recoloured(row, lanes[at], lanes[at + LANES], lanes[at + 2 * LANES])
        lanes[at], lanes[at + LANES], lanes[at + 2 * LANES] = red, green, blue


MARGIN = 2e-3
"""Enlargement of ellipses where they are binned, relative and in powers of two of alpha."""


@inline
def tile_interval(centre, half):
    """First and last row or column of tiles, however far outside the image, whose pixel centres meet
    centre ± half (px), enlarged, of float64 lanes; first > last where none does."""
    half = half * (1 + MARGIN) + MARGIN
    return ceil((centre - half - (TILE - 0.5)) * (1 / TILE)), floor((centre + half - 0.5) * (1 / TILE))


@inline
def tile_rows(rows, tiles_y):
    """The first row of tiles in the image that the boxes of LANES records meet, and how many they meet; rows
    (RECORD·LANES,) has the records as columns."""
    first, last = tile_interval(widened(column(rows, Y)), widened(column(rows, RY)))
    nothing = fill(first, 0.0)
    # maximum and minimum return their second argument for NaN: then all rows are met.
    first = minimum(maximum(first, nothing), fill(first, tiles_y))
    return first, maximum(minimum(last, fill(last, tiles_y - 1)) - first + 1, nothing)


@kernel(allocates=True)
def project(
    start,
    stop,
    bounds,
    means,
    quats,
    log_scales,
    opacity_logits,
    sh,
    degree,
    view,
    optics,
    records,
    depths,
    visible,
    edits,
    surfels,
    own_degrees,
    rows_of,
):
    """Projects splats [start, stop) and returns how many are visible; their indices, ascending, go to
    `visible` from `start` on. Or -1, if a mark names an entry that is not in the palette of the edits.

    means (N, 3) float32 or float64; quats (N, 4), log_scales (N, 3), opacity_logits (N,), sh (N, K, 3)
    float32 or float64; records (N, RECORD) in the pictures' dtype and depths (N,) float64, both written for
    visible splats only; visible (N,) int32; bounds (3,) float64: least and greatest depth and brightest
    colour, written; edits an `EditArrays` or None; surfels
    `SurfelArrays`, whose rows are written too, or None; own_degrees (N,) uint8, the SH degree beyond which
    each splat has only zeros, or None; rows_of (N,) uint16, how many rows of tiles the box of each visible
    splat meets, written.
    """
    basis = aligned(16 * LANES, records.dtype)
    rows = aligned(RECORD * LANES, records.dtype)
    rows[:] = 0
    starts, met_rows = np.empty(LANES, np.int64), np.empty(LANES, np.uint16)
    flat_sh, flat_records = sh.reshape(-1), records.reshape(-1)
    past = flat_records.nbytes > MOST_CACHED and passes_caches(flat_records, RECORD)
    number = records.dtype.type
    lanes = aligned(COLUMNS * LANES, np.float64)
    lanes[:LANES] = 0
    brightest = column(lanes, 0)
    least, greatest = fill(brightest, np.inf), fill(brightest, -np.inf)
    count = 0
    for first in range(start, stop, LANES):
        for lane in range(LANES):  # beyond the end the last again
            splat = min(first + lane, stop - 1)
            ask_for_sh(flat_sh, (first + LANES + lane) * (sh.shape[1] * 3), 3 * (degree + 1) * (degree + 1))
            load_splat(splat, lane, means, quats, log_scales, opacity_logits, view, lanes)
            if edits is not None and not edit_splat(splat, lane, edits, view, lanes):
                return -1
        for part in range(0, LANES, PART_LANES):
            project_group(view, optics, surfels, lanes, part, records)
        if not any_above(column(lanes, DRAWN), 0.0):
            continue
        own = degree
        if own_degrees is not None:  # beyond its own degree a splat has only zeros
            own = np.int64(0)
            for lane in range(LANES):
                own = max(own, np.int64(own_degrees[min(first + lane, stop - 1)]))
            own = min(own, degree)
        if edits is not None:
            for lane in range(LANES):
                turn_back(min(first + lane, stop - 1), lane, edits, lanes)
        for lane in range(LANES):
            starts[lane] = np.int64(min(first + lane, stop - 1)) * (sh.shape[1] * 3)
        shade_group(own, flat_sh, starts, basis, lanes)
        if edits is not None:
            for lane in range(LANES):
                recolour(min(first + lane, stop - 1), lane, edits, lanes)
        cut_colours(lanes)
        if not any_above(column(lanes, DRAWN), 0.0):
            continue

        for field in (A, B, C, LOG2_OPACITY, RED, GREEN, BLUE, RX, RY, LOG2_DROP):
            set_column(rows, field, converted(column(lanes, FOOTPRINT + field), rows))
        for field, rest in ((X, X_REST), (Y, Y_REST)):
            exact = column(lanes, FOOTPRINT + field)
            rounded = converted(exact, rows)
            set_column(rows, field, rounded)
            set_column(rows, rest, converted(exact - widened(rounded), rows))
        _, met = tile_rows(rows, view.tiles_y)
        for lane in range(LANES):
            starts[lane] = np.int64(min(first + lane, stop - 1)) * RECORD
        store_rows(flat_records, starts, RECORD, rows, 0, past)
        if surfels is not None:
            for lane in range(min(LANES, stop - first)):
                for field in range(SURFEL):
                    surfels.rows[first + lane, field] = number(lanes[(SURFEL_ROW + field) * LANES + lane])
        # Without asking for each whether it is drawn: the answers could not be guessed.
        drawn, depth = column(lanes, DRAWN), column(lanes, DEPTH)
        nothing, absent = fill(depth, 0.0), (1.0 - drawn) * FLOAT32_MAX
        shown = keep_if_below(depth, nothing, drawn)
        least, greatest = minimum(least, shown + absent), maximum(greatest, shown - absent)
        red, green, blue = three_columns(lanes, FOOTPRINT + RED)
        brightest = maximum(brightest, keep_if_below(max(max(red, green), blue), nothing, drawn))  # noqa: PLW3301
        if first + LANES <= stop and not any_above(absent, 0.0):
            store(depths, first, depth)
            store_run(visible, start + count, first)
            store_int(rows_of, first, met)
            count += LANES
            continue
        store_int(met_rows, 0, met)
        for lane in range(min(LANES, stop - first)):
            rows_of[first + lane] = met_rows[lane]
            depths[first + lane] = lanes[DEPTH * LANES + lane]
            visible[start + count] = first + lane
            count += lanes[DRAWN * LANES + lane] > 0
    finish_stores()
    store(lanes, 0, least)
    store(lanes, LANES, greatest)
    store(lanes, 2 * LANES, brightest)
    bounds[0], bounds[1] = lanes[:LANES].min(), lanes[LANES : 2 * LANES].max()
    bounds[2] = lanes[2 * LANES : 3 * LANES].max()
    return count
