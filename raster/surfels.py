"""Flat splats as planar discs: what the kernels do otherwise where the image model has them.

A kernel's `discs` is a `DiscArrays` or None, two types and so two machine codes. Projection writes a row a
splat beside its record, whose conic becomes that of an ellipse around the disc: bins and touched blocks
need no more. The formulas are those of `scene.discs`.

    UX, UY, VX, VY    1/px, in the unit of the records' conic: p = LOG2_OPACITY - (u² + v²), with
                      u = (UX·dx + UY·dy) / slope, v alike
    FACING            slope at the mean
    LEAN_X, LEAN_Y    1/px: slope = FACING + perspective·lean, lean = LEAN_X·dx + LEAN_Y·dy
    MOST_LEAN         lean beyond which the plane is met nearer than the near plane
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import inline
from splatview.raster.parameters import HALF_LOG2_E
from splatview.raster.simd import LANES, divide, fill, fma, keep_if_at_least, keep_if_below, minimum, store
from splatview.scene import Camera, ImageModel
from splatview.scene.image_model import DISC_LEAST_SLOPE, DISC_LEAST_WIDTH
from splatview.scene.surfels import LEAST_NEAR, LEAST_SCALE, WIDEST, check_surfels

UX, UY, VX, VY, FACING, LEAN_X, LEAN_Y, MOST_LEAN = range(8)
DISC = 8
"""Numbers in a row."""

MOST_SHARPNESS = 1e30
"""1/px²: of a blur of 0; times the square of 0 px it is 0."""

REACH_SLACK = 4e-3
"""By how much, relative and in itself, the reach of a disc is taken larger than it is; `bins` take an ellipse
a hair larger too."""

STRONG = 1.5
"""By this factor a disc's reach is nearer than its mean where a box may be smaller than the ellipse."""

NO_BOUND = 1e30

BOX_SLACK = 1e-5
"""Of slopes, by which boxes about discs are larger than they are."""

DISC_SCALE = math.sqrt(HALF_LOG2_E)


class DiscModel(NamedTuple):
    """What all discs of a picture share."""

    sharpness: float
    """1/px²: p = LOG2_OPACITY - sharpness·(dx² + dy²) of the dot that a disc is at least."""
    perspective: float
    """1, or 0 where rays are parallel."""


class DiscArrays(NamedTuple):
    """All of a picture's discs."""

    rows: np.ndarray
    """(N, DISC) in the picture's dtype, see above; written for visible splats only."""
    sharpness: float
    perspective: float


def make_discs(camera: Camera, model: ImageModel) -> DiscModel | None:
    """None where the model has no discs. Raises InputError where it has and the camera has a lens."""
    check_surfels(camera, model)
    if model.footprint != "disc":
        return None
    sharpness = min(HALF_LOG2_E / model.blur, MOST_SHARPNESS) if model.blur > 0 else MOST_SHARPNESS
    return DiscModel(sharpness, 0.0 if camera.orthographic else 1.0)


@inline
def picked(share, x, y):
    """x where `share` is 1, y where it is 0: three lanes each."""
    rest = 1.0 - share
    return share * x[0] + rest * y[0], share * x[1] + rest * y[1], share * x[2] + rest * y[2]


@inline
def seen_between(along, z, a, b, a_z, b_z, reach):
    """Least and greatest x/z (or y/z) of what is before the eye of a disc at (along, z) with scaled axes a
    and b: where the planes along = k·z touch it. Of a disc that goes through the eye's plane at least one is
    NO_BOUND."""
    zero, one, far = fill(z, 0.0), fill(z, 1.0), fill(z, NO_BOUND)
    p = z * z - reach * (a_z * a_z + b_z * b_z)
    q = along * z - reach * (a * a_z + b * b_z)
    r = along * along - reach * (a * a + b * b)
    inside = q * q - p * r
    root = math.sqrt(max(inside, zero))
    size = max(abs(p), 1e-9 * z * z)
    one_side, other = (q - root) / size, (q + root) / size
    through = keep_if_below(one, p, 1e-9 * z * z)
    # Before the eye are those on the side of the mean: with p below 0 the roots change places and sign.
    above = keep_if_at_least(one, along, z * max(-one_side, -other))
    below = keep_if_at_least(one, z * min(-one_side, -other), along)
    clear = keep_if_below(one, 1e-9 * z * z, -p) * keep_if_below(one, zero, inside)
    above, below = above * clear, below * clear * (one - above)
    low = (one - through) * one_side + through * (above * max(-one_side, -other) - (one - above) * far)
    high = (one - through) * other + through * (below * min(-one_side, -other) + (one - below) * far)
    return low, high


@inline
def half_box(low, high, focal, centre, size, mean, dot):
    """How far from the mean, px, a disc is seen within the picture; less than 0 where it is not."""
    low = low - (abs(low) + 1.0) * BOX_SLACK
    high = high + (abs(high) + 1.0) * BOX_SLACK
    first = max(low * focal + centre - dot, fill(low, 0.0))
    last = min(high * focal + centre + dot, fill(low, size))
    half = max(max(last - mean, mean - first), dot)  # noqa: PLW3301 vectors come in twos
    return half - keep_if_below(half + 1.0, last, first)


@inline
def project_discs(view, perspective, tx, ty, tz, axes, scales, reach, lanes, first):
    """Writes the rows of LANES splats to the columns of `lanes` from `first` on. Returns whether anything can
    be seen, 1 or 0, and M, (2, 3) row by row: what the picture sees of u² + v² <= reach is within the ellipse
    of M·Mᵀ with that reach about the mean.

    All are float64 vectors: camera points, three unit axes in camera axes, three scales, reach.
    """
    sx, sy, sz = scales
    one, zero, floor = fill(tx, 1.0), fill(tx, 0.0), fill(tx, LEAST_SCALE)
    x_size, y_size, z_size = max(sx, floor), max(sy, floor), max(sz, floor)
    x_is_least = keep_if_below(one, x_size, min(y_size, z_size))
    z_is_least = one - max(x_is_least, keep_if_below(one, y_size, z_size))
    e_u = picked(x_is_least, axes[1], axes[0])
    e_v = picked(z_is_least, axes[1], axes[2])
    n = picked(z_is_least, axes[2], picked(x_is_least, axes[0], axes[1]))
    s_u = x_is_least * sy + (one - x_is_least) * sx
    s_v = z_is_least * sy + (one - z_is_least) * sz

    distance = one
    rx, ry = zero, zero
    if perspective > 0:
        distance = tz
        rx, ry = tx / tz, ty / tz
    least = distance * (DISC_LEAST_WIDTH / view.fx)
    s_u, s_v = max(s_u, least), max(s_v, least)
    near = max(view.near, LEAST_NEAR)
    facing = n[0] * rx + n[1] * ry + n[2]
    turn = one - 2.0 * keep_if_below(one, facing, zero)
    facing = facing * turn
    growth, most_lean = one, facing * (tz - near)
    if perspective > 0:
        deepest = math.sqrt(s_u * e_u[2] * (s_u * e_u[2]) + s_v * e_v[2] * (s_v * e_v[2]))
        growth = tz / max(tz - math.sqrt(reach) * deepest, fill(tz, near))
        most_lean = facing * (tz * (1.0 / near) - 1.0)

    u_size, v_size = DISC_SCALE * distance / s_u, DISC_SCALE * distance / s_v
    store(lanes, (first + UX) * LANES, (e_v[1] - e_v[2] * ry) * u_size * (1.0 / view.fx))
    store(lanes, (first + UY) * LANES, (e_v[2] * rx - e_v[0]) * u_size * (1.0 / view.fy))
    store(lanes, (first + VX) * LANES, (e_u[1] - e_u[2] * ry) * v_size * (1.0 / view.fx))
    store(lanes, (first + VY) * LANES, (e_u[2] * rx - e_u[0]) * v_size * (1.0 / view.fy))
    store(lanes, (first + FACING) * LANES, facing)
    store(lanes, (first + LEAN_X) * LANES, n[0] * turn * (1.0 / view.fx))
    store(lanes, (first + LEAN_Y) * LANES, n[1] * turn * (1.0 / view.fy))
    store(lanes, (first + MOST_LEAN) * LANES, most_lean)

    u_length, v_length = s_u * growth / distance, s_v * growth / distance
    m0, m1 = (e_u[0] - rx * e_u[2]) * u_length * view.fx, (e_v[0] - rx * e_v[2]) * v_length * view.fx
    m3, m4 = (e_u[1] - ry * e_u[2]) * u_length * view.fy, (e_v[1] - ry * e_v[2]) * v_length * view.fy
    seen = one
    if perspective > 0:
        # Where the ellipse would be far too large: one around a box, as far as that is in the picture.
        dot = math.sqrt(reach * view.blur)
        a_z, b_z = s_u * e_u[2], s_v * e_v[2]
        low, high = seen_between(tx, tz, s_u * e_u[0], s_v * e_v[0], a_z, b_z, reach)
        x_half = half_box(low, high, view.fx, view.cx, view.width, rx * view.fx + view.cx, dot)
        low, high = seen_between(ty, tz, s_u * e_u[1], s_v * e_v[1], a_z, b_z, reach)
        y_half = half_box(low, high, view.fy, view.cy, view.height, ry * view.fy + view.cy, dot)
        strong = keep_if_at_least(one, growth, fill(growth, STRONG))
        seen = one - strong * keep_if_below(one, min(x_half, y_half), zero)
        boxed = strong * keep_if_below(one, 2.0 * x_half * y_half, abs(m0 * m4 - m1 * m3) * reach)
        to_m = boxed * math.sqrt(2.0 / reach)
        solid = one - boxed
        m0, m1, m3, m4 = solid * m0 + to_m * x_half, solid * m1, solid * m3, solid * m4 + to_m * y_half
    longest = max(max(abs(m0), abs(m1)), max(abs(m3), abs(m4)))  # noqa: PLW3301 vectors come in twos
    fits = keep_if_at_least(one, fill(longest, WIDEST), longest)
    wide = (one - fits) * WIDEST
    return seen, (fits * m0 + wide, fits * m1, zero, fits * m3, fits * m4 + wide, zero)


@inline
def disc_power(u, v, lean, slope, most_lean, screen):
    """(u/slope)² + (v/slope)² of pixels that meet the plane, and at most `screen`: vectors."""
    slope = keep_if_at_least(slope, slope, fill(slope, DISC_LEAST_SLOPE))  # guard: least slope
    slope = keep_if_at_least(slope, most_lean, lean)  # guard: near plane
    # A slope of 0 makes these infinite, or NaN at the mean: minimum gives its second argument then.
    inverse = divide(fill(slope, 1.0), slope)
    return minimum(fma(u, u, v * v) * (inverse * inverse), screen)


@inline
def met_at(discs, splat, dx, dy, depth):
    """The same of one splat at one pixel, float64, and the depth at which the pixel's ray meets the plane:
    where the dot is seen instead, `depth`, which is the mean's."""
    row = discs.rows[splat]
    facing = np.float64(row[FACING])
    screen = discs.sharpness * (dx * dx + dy * dy)
    lean = row[LEAN_X] * dx + row[LEAN_Y] * dy
    slope = facing + discs.perspective * lean
    if not (slope >= DISC_LEAST_SLOPE and lean <= row[MOST_LEAN]):
        return screen, depth
    u, v = (row[UX] * dx + row[UY] * dy) / slope, (row[VX] * dx + row[VY] * dy) / slope
    on_plane = u * u + v * v
    if not on_plane < screen:
        return screen, depth
    return on_plane, depth * facing / slope if discs.perspective > 0 else depth - lean / facing
