"""From gradients by footprints to gradients by the scene's parameters: the chain rule of `project`.

All in float64, in the forms that `project` uses: the determinant's gradient goes through the cross
product of M's rows, never through S'xx·S'yy - S'xy².

Gradients by SH, three quarters of what is written, go past the caches: reading the lines that they overwrite
took 0.09 of a step of 20,000 splats and 0.06 of one of 100,000 (kernels_past_caches.json). Dropped: the same
for sums by pair and by splat, which are read at once (0.77 in place of 0.40 ms for those of 20,000 splats,
others alike), and asking for these lines ahead.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.backward import ABS_X, ABS_Y, D_BLUE, D_GREEN, D_RED, SUMS, TU, TUX, TUY, TV, TVY, T
from splatview.raster.camera_models import image_axes, point_gradient, viewing_direction
from splatview.raster.compiling import SPLATS_PER_TASK, inline, kernel
from splatview.raster.exponentials import exp_lanes
from splatview.raster.project import (
    CONIC_SCALE,
    LOG_SCALE,
    LOGIT,
    OFFSET,
    QUAT,
    camera_point,
    covariance,
    four_columns,
    load_splat,
    rotation_matrix,
    set_three,
    sigmoid_lanes,
    splat_axes,
    three_columns,
)
from splatview.raster.sh import (
    SH_COLUMNS,
    ask_for_sh,
    load_sh,
    sh_basis,
    sh_direction_gradient,
    sh_sum,
    store_sh_products,
)
from splatview.raster.simd import (
    LANES,
    aligned,
    converted,
    fill,
    fma,
    keep_if_below,
    maximum,
    minimum,
    negate,
    widened,
)
from splatview.raster.transpose import column, finish_stores, load_rows, passes_caches, set_column
from splatview.scene.projection import FLOAT32_MAX

POSE_BLOCK = SPLATS_PER_TASK
"""Splats whose pose gradients are added up together: a fixed number that no two tasks share, so that sums
are the same on any number of threads."""

PER_SCALE = 1 / CONIC_SCALE


@inline
def camera_to_world(view, x, y, z):
    """Camera axes -> world axes."""
    r = view.rotation
    return (
        r[0, 0] * x + r[1, 0] * y + r[2, 0] * z,
        r[0, 1] * x + r[1, 1] * y + r[2, 1] * z,
        r[0, 2] * x + r[1, 2] * y + r[2, 2] * z,
    )


@inline
def axes_gradient(m, xy, yy, det, unblurred, blur, antialiased, sums):
    """dL/dM (2, 3), row by row, from a group's sums; m, xy, yy, det, unblurred as `covariance` has them."""
    inverse_det, inverse_yy = 1.0 / det, 1.0 / yy
    a = math.sqrt(yy * inverse_det)
    b_by_a = -xy * inverse_yy
    d_b, d_c = column(sums, TUY) * -PER_SCALE, column(sums, TVY) * -PER_SCALE
    # a = (yy/det)^½, b = -xy/yy·a, c = yy^-½
    d_a = column(sums, TUX) * -PER_SCALE + d_b * b_by_a
    d_xy = -d_b * a * inverse_yy
    d_yy = (0.5 * a * d_a - b_by_a * a * d_b - 0.5 * math.sqrt(inverse_yy) * d_c) * inverse_yy
    d_det = -0.5 * a * inverse_det * d_a
    d_unblurred = d_det
    if antialiased:  # the opacity's factor is (unblurred / det)^½
        by_det = 0.5 * column(sums, T) * inverse_det
        d_det = d_det - by_det
        d_unblurred = d_det + 0.5 * column(sums, T) / unblurred
    # unblurred = |n|², n = m0 x m1; det = unblurred + blur·(|m0|² + |m1|²) + blur²; yy = |m1|² + blur
    nx, ny, nz = m[1] * m[5] - m[2] * m[4], m[2] * m[3] - m[0] * m[5], m[0] * m[4] - m[1] * m[3]
    nx, ny, nz = 2 * d_unblurred * nx, 2 * d_unblurred * ny, 2 * d_unblurred * nz
    along0, along1 = 2 * blur * d_det, 2 * (blur * d_det + d_yy)
    return (
        m[4] * nz - m[5] * ny + along0 * m[0] + d_xy * m[3],
        m[5] * nx - m[3] * nz + along0 * m[1] + d_xy * m[4],
        m[3] * ny - m[4] * nx + along0 * m[2] + d_xy * m[5],
        ny * m[2] - nz * m[1] + along1 * m[3] + d_xy * m[0],
        nz * m[0] - nx * m[2] + along1 * m[4] + d_xy * m[1],
        nx * m[1] - ny * m[0] + along1 * m[5] + d_xy * m[2],
    )


@inline
def quat_gradient(w, x, y, z, d):
    """dL/d(unit quaternion) from dL/dR (nine entries, row by row)."""
    return (
        2 * (z * (d[3] - d[1]) + y * (d[2] - d[6]) + x * (d[7] - d[5])),
        2 * (y * (d[1] + d[3]) + z * (d[2] + d[6]) + w * (d[7] - d[5]) - 2 * x * (d[4] + d[8])),
        2 * (x * (d[1] + d[3]) + z * (d[5] + d[7]) + w * (d[2] - d[6]) - 2 * y * (d[0] + d[8])),
        2 * (x * (d[2] + d[6]) + y * (d[5] + d[7]) + w * (d[3] - d[1]) - 2 * z * (d[0] + d[4])),
    )


# What `differentiate_group` makes of a group, in columns as in `project`: gradients by the world position as
# far as it moves the footprint, by quaternion, scales, logit and mean in the image; the sums by absolute
# value; unit direction and inverse distance from the eye; gradients by camera position and by turning.
D_POSITION, D_QUAT, D_LOG_SCALE, D_LOGIT, D_MEAN2D, ABS_MEAN2D, DIRECTION, AWAY, D_SHIFT, D_TURN = (
    11, 14, 18, 21, 22, 24, 26, 29, 30, 33
)  # fmt: skip
COLUMNS = 36


@inline
def differentiate_group(view, optics, sums, lanes, by_view, pictures):
    """Fills the columns from D_POSITION on from the loaded ones and the splats' sums, columns too; `by_view`
    None: without those that are nobody's gradient by a parameter, from D_MEAN2D on. `pictures` is an array of
    the pictures' dtype."""
    lens, parallel = optics
    ox, oy, oz = three_columns(lanes, OFFSET)
    x, y, z = camera_point(view, ox, oy, oz)
    qw, qx, qy, qz = four_columns(lanes, QUAT)
    shrink = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    qw, qx, qy, qz = qw * shrink, qx * shrink, qy * shrink, qz * shrink
    r = rotation_matrix(qw, qx, qy, qz)
    sx, sy, sz = three_columns(lanes, LOG_SCALE)
    sx, sy, sz = exp_lanes(sx, pictures), exp_lanes(sy, pictures), exp_lanes(sz, pictures)
    p = image_axes(lens, parallel, view, x, y, z)
    m = splat_axes(p, r, sx, sy, sz)
    _, xy, yy, det, unblurred = covariance(m, view.blur)

    # Opacity: dln(opacity)/dlogit = 1 - opacity.
    set_column(lanes, D_LOGIT, column(sums, T) * sigmoid_lanes(-column(lanes, LOGIT), pictures))

    # Footprint: M = P·R·diag(s).
    d_m = axes_gradient(m, xy, yy, det, unblurred, view.blur, view.antialiased, sums)
    set_three(
        lanes,
        D_LOG_SCALE,
        d_m[0] * m[0] + d_m[3] * m[3],
        d_m[1] * m[1] + d_m[4] * m[4],
        d_m[2] * m[2] + d_m[5] * m[5],
    )
    q0, q1, q2 = d_m[0] * sx, d_m[1] * sy, d_m[2] * sz
    q3, q4, q5 = d_m[3] * sx, d_m[4] * sy, d_m[5] * sz
    d_r = (
        p[0] * q0 + p[3] * q3,
        p[0] * q1 + p[3] * q4,
        p[0] * q2 + p[3] * q5,
        p[1] * q0 + p[4] * q3,
        p[1] * q1 + p[4] * q4,
        p[1] * q2 + p[4] * q5,
        p[2] * q0 + p[5] * q3,
        p[2] * q1 + p[5] * q4,
        p[2] * q2 + p[5] * q5,
    )
    dw, dx, dy, dz = quat_gradient(qw, qx, qy, qz, d_r)
    radial = qw * dw + qx * dx + qy * dy + qz * dz  # the length of a quaternion changes nothing
    set_column(lanes, D_QUAT, (dw - qw * radial) * shrink)
    set_three(
        lanes,
        D_QUAT + 1,
        (dx - qx * radial) * shrink,
        (dy - qy * radial) * shrink,
        (dz - qz * radial) * shrink,
    )
    d_p = (
        q0 * r[0] + q1 * r[1] + q2 * r[2],
        q0 * r[3] + q1 * r[4] + q2 * r[5],
        q0 * r[6] + q1 * r[7] + q2 * r[8],
        q3 * r[0] + q4 * r[1] + q5 * r[2],
        q3 * r[3] + q4 * r[4] + q5 * r[5],
        q3 * r[6] + q4 * r[7] + q5 * r[8],
    )

    # Mean in the image, and J.
    inverse_det, inverse_yy = 1.0 / det, 1.0 / yy  # as in `axes_gradient`, so that each is computed once
    a, tu = math.sqrt(yy * inverse_det), column(sums, TU)
    d_x2 = a * tu * PER_SCALE
    d_y2 = (math.sqrt(inverse_yy) * column(sums, TV) - xy * inverse_yy * a * tu) * PER_SCALE
    if by_view is not None:
        set_column(lanes, D_MEAN2D, d_x2)
        set_column(lanes, D_MEAN2D + 1, d_y2)
        set_column(lanes, ABS_MEAN2D, a * column(sums, ABS_X) * PER_SCALE)
        set_column(lanes, ABS_MEAN2D + 1, column(sums, ABS_Y) * (PER_SCALE * PER_SCALE))

    # P = J·W: rows of dL/dP times the rows of W are dL/dJ.
    d_j = *camera_point(view, d_p[0], d_p[1], d_p[2]), *camera_point(view, d_p[3], d_p[4], d_p[5])
    tx, ty, tz, turn_x, turn_y, turn_z = point_gradient(lens, parallel, view, x, y, z, d_x2, d_y2, d_j)
    wx, wy, wz = camera_to_world(view, tx, ty, tz)
    set_three(lanes, D_POSITION, wx, wy, wz)
    # The camera: t' = t + shift + turn x t, W' = (1 + [turn])·W, and the eye moves against the shift.
    if by_view is not None:
        set_three(lanes, D_SHIFT, tx, ty, tz)
        set_three(lanes, D_TURN, turn_x, turn_y, turn_z)
    nx, ny, nz, away = viewing_direction(parallel, view, ox, oy, oz)
    set_three(lanes, DIRECTION, nx, ny, nz)
    set_column(lanes, AWAY, away)


@inline
def differentiate_colours(view, optics, degree, sums, excess, lanes, basis, coefficients, along, by_view):
    """Adds what the colours' dependence on the direction moves to the columns of position and, unless
    `by_view` is None, of the camera; coefficients as `load_sh` has them. Returns three columns: products of
    these and those of `basis` are the gradients by coefficients. basis and along (16·LANES,) are room to work
    in, in the dtype of the splats' sums, columns too, and what is computed of colours has it too; `excess`
    times the sums are the gradients."""
    nx, ny, nz = three_columns(lanes, DIRECTION)
    to_x, to_y, to_z = converted(nx, basis), converted(ny, basis), converted(nz, basis)
    count = (degree + 1) * (degree + 1)
    sh_basis(to_x, to_y, to_z, degree, basis)
    red, green, blue = sh_sum(coefficients, basis, count)
    nothing = fill(red, 0.0)
    d_red = keep_if_below(column(sums, D_RED), nothing, red)
    d_green = keep_if_below(column(sums, D_GREEN), nothing, green)
    d_blue = keep_if_below(column(sums, D_BLUE), nothing, blue)
    whole_red, whole_green, whole_blue = held(d_red * excess), held(d_green * excess), held(d_blue * excess)
    for k in range(count):
        by_red = d_red * converted(column(coefficients, 3 * k), basis)
        by_green = fma(d_green, converted(column(coefficients, 3 * k + 1), basis), by_red)
        set_column(along, k, fma(d_blue, converted(column(coefficients, 3 * k + 2), basis), by_green))
    dx, dy, dz = sh_direction_gradient(to_x, to_y, to_z, degree, along)
    dx, dy, dz = widened(dx) * excess, widened(dy) * excess, widened(dz) * excess
    radial = nx * dx + ny * dy + nz * dz
    dx, dy, dz = dx - nx * radial, dy - ny * radial, dz - nz * radial
    if by_view is not None and optics.parallel is not None:  # the direction is the camera's and turns with it
        cx, cy, _ = camera_point(view, dx, dy, dz)
        set_column(lanes, D_TURN, column(lanes, D_TURN) + cy)
        set_column(lanes, D_TURN + 1, column(lanes, D_TURN + 1) - cx)
    away = column(lanes, AWAY)
    dx, dy, dz = dx * away, dy * away, dz * away
    px, py, pz = three_columns(lanes, D_POSITION)
    set_three(lanes, D_POSITION, px + dx, py + dy, pz + dz)
    if by_view is not None:
        cx, cy, cz = camera_point(view, dx, dy, dz)
        tx, ty, tz = three_columns(lanes, D_SHIFT)
        set_three(lanes, D_SHIFT, tx + cx, ty + cy, tz + cz)
    return whole_red, whole_green, whole_blue


@inline
def held(gradient):
    """A column kept within what float32 holds. NaN stays."""
    most = fill(gradient, FLOAT32_MAX)
    return minimum(most, maximum(negate(most), gradient))


@inline
def hold(lanes, end):
    """Keeps the columns of gradients below `end` within what float32 holds: by a quaternion of length 1e-30,
    say, or a splat at the eye, they are more. NaN stays."""
    for index in range(D_POSITION, end):
        set_column(lanes, index, held(column(lanes, index)))


@kernel(allocates=True)
def project_backward(
    start,
    stop,
    run_start,
    run_stop,
    visible,
    means,
    quats,
    log_scales,
    opacity_logits,
    sh,
    degree,
    view,
    optics,
    splat_sums,
    excess,
    d_means,
    d_quats,
    d_log_scales,
    d_opacity_logits,
    d_sh,
    d_means2d,
    abs_means2d,
    pose_sums,
):
    """Writes the gradients of splats [start, stop), of which visible[run_start:run_stop] are visible.

    Parameters and their gradients have the shapes of `Parameters`; d_means2d and abs_means2d (N, 2)
    receive the gradient by the mean in px and the sum of its absolute values by pixel (Ye et al. 2024,
    AbsGS). pose_sums (blocks, 6) float64 receives gradients by a small motion of the camera, added up
    by POSE_BLOCK splats: see `gradients`. These three are None where nobody asks for them. The sums are
    those of a loss `excess` times smaller. Rows of splats that are not visible become 0.
    """
    basis, along = aligned(16 * LANES, splat_sums.dtype), aligned(16 * LANES, splat_sums.dtype)
    coefficients = aligned(SH_COLUMNS * LANES, sh.dtype)
    starts = np.empty(LANES, np.int64)
    flat_sh, flat_d_sh, flat_sums = sh.reshape(-1), d_sh.reshape(-1), splat_sums.reshape(-1)
    numbers = 3 * sh.shape[1]
    past = passes_caches(flat_d_sh, numbers)
    used = 3 * (degree + 1) * (degree + 1)
    lanes = aligned(COLUMNS * LANES, np.float64)
    rows = aligned(SUMS * LANES, splat_sums.dtype)
    sums = aligned(SUMS * LANES, np.float64)
    if pose_sums is not None:
        pose_sums[start // POSE_BLOCK : (stop + POSE_BLOCK - 1) // POSE_BLOCK] = 0
    written = start
    for group in range(run_start, run_stop, LANES):
        for lane in range(LANES):  # beyond the end the last again
            i = visible[min(group + lane, run_stop - 1)]
            load_splat(i, lane, means, quats, log_scales, opacity_logits, view, lanes)
            starts[lane] = np.int64(i) * SUMS
            ask_for_sh(flat_sh, np.int64(visible[min(group + LANES + lane, run_stop - 1)]) * numbers, used)
        load_rows(flat_sums, starts, SUMS, rows, 0)
        for index in range(D_RED):
            set_column(sums, index, widened(column(rows, index)) * excess)
        if pose_sums is not None:
            for index in range(ABS_X, ABS_Y + 1):
                set_column(sums, index, widened(column(rows, index)) * excess)
        differentiate_group(view, optics, sums, lanes, pose_sums, splat_sums)
        for lane in range(LANES):
            starts[lane] = np.int64(visible[min(group + lane, run_stop - 1)]) * numbers
        load_sh(flat_sh, starts, used, coefficients)
        colours = rows, excess, lanes, basis, coefficients, along, pose_sums
        red, green, blue = differentiate_colours(view, optics, degree, *colours)
        for lane in range(LANES):
            starts[lane] = np.int64(visible[min(group + lane, run_stop - 1)]) * numbers
        store_sh_products(flat_d_sh, starts, numbers, used, basis, red, green, blue, past)
        hold(lanes, D_MEAN2D if pose_sums is None else DIRECTION)
        for lane in range(min(LANES, run_stop - group)):
            i = np.int64(visible[group + lane])
            if written < i:
                zero_rows(
                    written, i, d_means, d_quats, d_log_scales, d_opacity_logits, d_sh, d_means2d, abs_means2d
                )
            written = i + 1
            for axis in range(3):
                d_means[i, axis] = lanes[(D_POSITION + axis) * LANES + lane]
                d_log_scales[i, axis] = lanes[(D_LOG_SCALE + axis) * LANES + lane]
            for component in range(4):
                d_quats[i, component] = lanes[(D_QUAT + component) * LANES + lane]
            d_opacity_logits[i] = lanes[D_LOGIT * LANES + lane]
            if pose_sums is not None:
                for axis in range(2):
                    d_means2d[i, axis] = lanes[(D_MEAN2D + axis) * LANES + lane]
                    abs_means2d[i, axis] = lanes[(ABS_MEAN2D + axis) * LANES + lane]
                pose = pose_sums[i // POSE_BLOCK]
                for axis in range(3):
                    pose[axis] += lanes[(D_SHIFT + axis) * LANES + lane]
                    pose[3 + axis] += lanes[(D_TURN + axis) * LANES + lane]
    zero_rows(written, stop, d_means, d_quats, d_log_scales, d_opacity_logits, d_sh, d_means2d, abs_means2d)
    finish_stores()


@inline
def zero_rows(start, stop, d_means, d_quats, d_log_scales, d_opacity_logits, d_sh, d_means2d, abs_means2d):
    for i in range(start, stop):
        for axis in range(3):
            d_means[i, axis] = d_log_scales[i, axis] = 0
        for component in range(4):
            d_quats[i, component] = 0
        d_opacity_logits[i] = 0
        for k in range(d_sh.shape[1]):
            for channel in range(3):
                d_sh[i, k, channel] = 0
        if d_means2d is not None:
            for axis in range(2):
                d_means2d[i, axis] = abs_means2d[i, axis] = 0
