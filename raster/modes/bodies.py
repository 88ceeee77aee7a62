"""Modes that draw splats as bodies: a dot for each centre, or the surface of each ellipsoid.

Both give the records of projected splats another outline, so that they are binned by it.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.edits import FADES, LOG_FACTOR, MOVES, faded, moved, palette_row, turned
from splatview.raster.parameters import TILE
from splatview.raster.project import (
    BLUE,
    GREEN,
    LOG2_OPACITY,
    RED,
    RX,
    RY,
    X_REST,
    Y_REST,
    A,
    B,
    C,
    X,
    Y,
    camera_point,
    rotation_matrix,
    sigmoid,
)

POINT_EXTENT = 1.6 + 0.5
"""px from a centre to where its dot ends; over the last one it fades."""

SIGMAS = 1.5
"""Standard deviations from an ellipsoid's centre to its surface."""

LEAST_OPACITY = 0.2
"""Fainter ellipsoids are left out: they would hide the others."""

LEAST_PIXELS = 0.7
"""px: no half axis of an ellipsoid is thinner, or it would shimmer."""

AMBIENT = 0.3
"""Light on what faces away from the lamp at the eye."""

AROUND_EYE = 1.01
"""Ratio of squared depth and squared extent in depth below which an ellipsoid may be seen everywhere."""

EVERYWHERE = 1e9
"""px"""

BODY = 13
"""Numbers of a body: the rows of the matrix from camera axes to those in which the ellipsoid is the unit
sphere, its centre there, its least depth."""


@inline
def give_outline(record, view, x, y, xx, xy, yy):
    """Has a splat binned where dᵀ·S⁻¹·d <= 1 about (x, y), px, whatever its opacity was."""
    bound = math.sqrt(min(-view.log2_cut, -view.log2_share))
    record[X], record[X_REST] = x, x - np.float64(record.dtype.type(x))
    record[Y], record[Y_REST] = y, y - np.float64(record.dtype.type(y))
    c = 1 / math.sqrt(yy)
    a = math.sqrt(yy / (xx * yy - xy * xy))
    record[A], record[B], record[C] = a * bound, -xy / yy * a * bound, c * bound
    record[LOG2_OPACITY] = 0.0
    record[RX], record[RY] = math.sqrt(xx), math.sqrt(yy)


@kernel
def outline_points(start, stop, visible, view, records):
    """Gives the records of visible[start:stop] the outline of a dot."""
    for k in range(start, stop):
        record = records[visible[k]]
        x = np.float64(record[X]) + np.float64(record[X_REST])
        y = np.float64(record[Y]) + np.float64(record[Y_REST])
        squared = POINT_EXTENT * POINT_EXTENT
        give_outline(record, view, x, y, squared, 0.0, squared)


@inline
def overlap(centre, extent, first, end):
    """First and last row or column, within [first, end), of pixels whose centres are within `extent` of
    `centre`, px, or a pixel farther out."""
    # Compared before they become whole numbers, which the largest extents would not fit.
    low = np.int64(max(np.float64(first), np.floor(centre - extent - 0.5)))
    return low, np.int64(min(end - 1.0, np.ceil(centre + extent - 0.5)))


@kernel(allocates=True)
def draw_points(start, stop, offsets, base, lists, records, view, background, image):
    """Draws the dots of tiles [start, stop), nearest first, into image (H, W, 4); arguments as in `forward`.
    Returns how many alphas were evaluated."""
    pixels = np.empty((TILE, TILE, 4))
    evaluated = 0
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        bottom, right = min(top + TILE, view.height), min(left + TILE, view.width)
        pixels[:, :, :3] = 0
        pixels[:, :, 3] = 1
        for place in range(offsets[tile] - base, offsets[tile + 1] - base):
            i = lists[place]  # rows are not sliced: see `compiling.kernel`
            x = np.float64(records[i, X]) + records[i, X_REST]
            y = np.float64(records[i, Y]) + records[i, Y_REST]
            red, green, blue = records[i, RED], records[i, GREEN], records[i, BLUE]
            first_row, last_row = overlap(y, POINT_EXTENT, top, bottom)
            first_column, last_column = overlap(x, POINT_EXTENT, left, right)
            for row in range(first_row, last_row + 1):
                dy = row + 0.5 - y
                for column in range(first_column, last_column + 1):
                    evaluated += 1
                    u, v = row - top, column - left
                    if not pixels[u, v, 3] > 0:
                        continue
                    dx = column + 0.5 - x
                    alpha = min(max(POINT_EXTENT - math.sqrt(dx * dx + dy * dy), 0.0), 1.0)
                    weight = alpha * pixels[u, v, 3]
                    pixels[u, v, 0] += weight * red
                    pixels[u, v, 1] += weight * green
                    pixels[u, v, 2] += weight * blue
                    pixels[u, v, 3] *= 1 - alpha
        for row in range(top, bottom):
            for column in range(left, right):
                T = pixels[row - top, column - left, 3]
                for channel in range(3):
                    image[row, column, channel] = (
                        pixels[row - top, column - left, channel] + T * background[channel]
                    )
                image[row, column, 3] = 1 - T
    return evaluated


@kernel
def outline_ellipsoids(
    start, stop, visible, means, quats, log_scales, opacity_logits, view, parallel, edits, records, bodies
):
    """Gives the records of visible[start:stop] the outline of their ellipsoids, and none to faint ones;
    fills bodies (N, BODY). `parallel`: rays do not come from the eye."""
    for k in range(start, stop):
        i = visible[k]
        record, body = records[i], bodies[i]
        x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
        a, b = np.float64(quats[i, 0]), np.float64(quats[i, 1])
        c, d = np.float64(quats[i, 2]), np.float64(quats[i, 3])
        logit, larger = np.float64(opacity_logits[i]), 0.0
        if edits is not None:
            row = edits.palette[palette_row(edits, i)]
            larger = row[LOG_FACTOR]
            if row[MOVES] > 0:
                x, y, z = moved(row, x, y, z)
                a, b, c, d = turned(row, a, b, c, d)
            if row[FADES] > 0:
                logit = faded(row, logit)
        record[RX], record[RY] = -4.0 * TILE, -4.0 * TILE
        if not sigmoid(logit) >= LEAST_OPACITY:
            continue
        tx, ty, tz = camera_point(view, x - view.eye[0], y - view.eye[1], z - view.eye[2])
        shrink = 1 / math.sqrt(a * a + b * b + c * c + d * d)
        r = rotation_matrix(a * shrink, b * shrink, c * shrink, d * shrink)
        thinnest = LEAST_PIXELS * (1.0 if parallel else tz) / view.fx
        s_xx = s_xy = s_yy = s_xz = s_yz = s_zz = 0.0
        for axis in range(3):
            half = max(math.exp(log_scales[i, axis] + larger) * SIGMAS, thinnest)
            ax, ay, az = camera_point(view, r[axis], r[3 + axis], r[6 + axis])
            body[3 * axis], body[3 * axis + 1], body[3 * axis + 2] = ax / half, ay / half, az / half
            body[9 + axis] = (ax * tx + ay * ty + az * tz) / half
            ax, ay, az = ax * half, ay * half, az * half
            s_xx, s_xy, s_yy = s_xx + ax * ax, s_xy + ax * ay, s_yy + ay * ay
            s_xz, s_yz, s_zz = s_xz + ax * az, s_yz + ay * az, s_zz + az * az
        body[12] = tz - math.sqrt(s_zz)
        if parallel:
            u, v = tx, ty
            xx, xy, yy = s_xx, s_xy, s_yy
        else:
            # The dual of the cone of rays that touch the ellipsoid is t·tᵀ - S.
            depth = tz * tz - s_zz
            u, v = (tx * tz - s_xz) / depth, (ty * tz - s_yz) / depth
            xx = u * u - (tx * tx - s_xx) / depth
            xy = u * v - (tx * ty - s_xy) / depth
            yy = v * v - (ty * ty - s_yy) / depth
        bounded = parallel or tz * tz > AROUND_EYE * s_zz
        if bounded and xx > 0 and yy > 0 and xx * yy - xy * xy > 0:
            fx, fy = view.fx, view.fy
            u, v = u * fx + view.cx, v * fy + view.cy
            give_outline(record, view, u, v, xx * fx * fx, xy * fx * fy, yy * fy * fy)
        else:
            squared = EVERYWHERE * EVERYWHERE
            give_outline(record, view, 0.5 * view.width, 0.5 * view.height, squared, 0.0, squared)


@kernel(allocates=True)
def draw_ellipsoids(start, stop, offsets, base, lists, records, bodies, view, parallel, background, image):
    """Draws the surfaces of tiles [start, stop), by a depth for each pixel, into image (H, W, 4); arguments
    as in `forward` and `outline_ellipsoids`. Returns how many rays were intersected.

    With e the pixel's ray and c the centre where the ellipsoid is the unit sphere, |e·z - c| = 1; the
    discriminant as |e|² - |e x c|², which keeps its digits on thin ellipsoids.
    """
    nearest = np.empty((TILE, TILE))
    evaluated = 0
    bound = math.sqrt(min(-view.log2_cut, -view.log2_share))
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        bottom, right = min(top + TILE, view.height), min(left + TILE, view.width)
        nearest[:] = np.inf
        nearest[bottom - top :] = 0.0
        nearest[:, right - left :] = 0.0
        for row in range(top, bottom):
            for column in range(left, right):
                for channel in range(3):
                    image[row, column, channel] = background[channel]
                image[row, column, 3] = 0
        first, farthest = offsets[tile] - base, np.inf
        for place in range(first, offsets[tile + 1] - base):
            if (place - first) % TILE == TILE - 1:
                farthest = nearest.max()
            i = lists[place]  # rows are not sliced: see `compiling.kernel`
            if not bodies[i, 12] <= farthest:
                continue
            x = np.float64(records[i, X]) + records[i, X_REST]
            y = np.float64(records[i, Y]) + records[i, Y_REST]
            a, b, c = np.float64(records[i, A]), np.float64(records[i, B]), np.float64(records[i, C])
            xx, xy, xz = np.float64(bodies[i, 0]), np.float64(bodies[i, 1]), np.float64(bodies[i, 2])
            yx, yy, yz = np.float64(bodies[i, 3]), np.float64(bodies[i, 4]), np.float64(bodies[i, 5])
            zx, zy, zz = np.float64(bodies[i, 6]), np.float64(bodies[i, 7]), np.float64(bodies[i, 8])
            cx, cy, cz = np.float64(bodies[i, 9]), np.float64(bodies[i, 10]), np.float64(bodies[i, 11])
            red, green, blue = records[i, RED], records[i, GREEN], records[i, BLUE]
            first_row, last_row = overlap(y, records[i, RY], top, bottom)
            for row in range(first_row, last_row + 1):
                dy = row + 0.5 - y
                # Of the outline in this row.
                half = math.sqrt(max(bound * bound - c * c * dy * dy, 0.0)) / a
                low, high = overlap(x - b / a * dy, half, left, right)
                evaluated += max(high - low + 1, 0)
                q = (row + 0.5 - view.cy) / view.fy
                for column in range(low, high + 1):
                    p = (column + 0.5 - view.cx) / view.fx
                    if parallel:
                        ex, ey, ez = xz, yz, zz
                        fx, fy, fz = cx - xx * p - xy * q, cy - yx * p - yy * q, cz - zx * p - zy * q
                    else:
                        ex, ey, ez = xx * p + xy * q + xz, yx * p + yy * q + yz, zx * p + zy * q + zz
                        fx, fy, fz = cx, cy, cz
                    mx, my, mz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
                    ee = ex * ex + ey * ey + ez * ez
                    discriminant = ee - mx * mx - my * my - mz * mz
                    if not discriminant >= 0:
                        continue
                    z = (ex * fx + ey * fy + ez * fz - math.sqrt(discriminant)) / ee
                    if not (z >= view.near and z < nearest[row - top, column - left]):
                        continue
                    nearest[row - top, column - left] = z
                    sx, sy, sz = ex * z - fx, ey * z - fy, ez * z - fz
                    nx, ny, nz = (
                        xx * sx + yx * sy + zx * sz,
                        xy * sx + yy * sy + zy * sz,
                        xz * sx + yz * sy + zz * sz,
                    )
                    facing, ray = nz, 1.0
                    if not parallel:
                        facing, ray = nx * p + ny * q + nz, p * p + q * q + 1
                    facing = max(-facing / math.sqrt((nx * nx + ny * ny + nz * nz) * ray), 0.0)
                    shade = AMBIENT + (1 - AMBIENT) * facing
                    image[row, column, 0] = red * shade
                    image[row, column, 1] = green * shade
                    image[row, column, 2] = blue * shade
                    image[row, column, 3] = 1
    return evaluated
