"""Flat splats as surfels, planar discs: what the kernels do differently where the image model has them.

A kernel's `surfels` is a `SurfelArrays` or None, two types and so two kernel variants. Projection writes one
row per splat beside its record, whose conic becomes that of an ellipse around the disc: bins and touched
blocks need no more. The formulas are those of `scene.surfels`; slope is the dot product of the plane's
normal with a pixel's ray.

    UX, UY, VX, VY      1/px, in the unit of the records' conic: p = LOG2_OPACITY - (u² + v²), with
                        u = (UX·dx + UY·dy) / slope, v alike
    NORMAL_RAY          slope at the mean
    NORMAL_X, NORMAL_Y  1/px: slope = NORMAL_RAY + perspective·tilt, tilt = NORMAL_X·dx + NORMAL_Y·dy
    MAX_TILT            tilt beyond which a ray meets the plane nearer than the near plane
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

UX, UY, VX, VY, NORMAL_RAY, NORMAL_X, NORMAL_Y, MAX_TILT = range(8)
SURFEL = 8
"""Numbers per row."""

MOST_SHARPNESS = 1e30
"""Sharpness of a blur of 0, 1/px²; times the square of 0 px it is 0."""

EXTENT_SLACK = 4e-3
"""Enlargement of a disc's extent, relative and absolute; `tiles` enlarge the ellipse a hair too."""

LEAST_BOUND = 1e-12
"""Smallest squared extent that a box is divided by: never 0."""

STRONG = 1.5
"""Depth of a disc's mean over that of its nearest point, from where on a box may be smaller than the
ellipse."""

NO_BOUND = 1e30

BOX_SLACK = 1e-5
"""Enlargement of boxes around discs, in slopes."""

SURFEL_SCALE = math.sqrt(HALF_LOG2_E)


class SurfelModel(NamedTuple):
    """Constants shared by all discs of a picture."""

    sharpness: float
    """1/px²: a disc is at least as large as the dot p = LOG2_OPACITY - sharpness·(dx² + dy²)."""
    perspective: float
    """1, or 0 where rays are parallel."""


class SurfelArrays(NamedTuple):
    """The discs of a picture."""

    rows: np.ndarray
    """(N, SURFEL) in the picture's dtype, see above; written for visible splats only."""
    sharpness: float
    perspective: float


def make_surfels(camera: Camera, model: ImageModel) -> SurfelModel | None:
    """None where the model has no discs. Raises InputError for discs visible through a lens."""
    check_surfels(camera, model)
    if model.footprint != "disc":
        return None
    sharpness = min(HALF_LOG2_E / model.blur, MOST_SHARPNESS) if model.blur > 0 else MOST_SHARPNESS
    return SurfelModel(sharpness, 0.0 if camera.orthographic else 1.0)


@inline
def picked(share, x, y):
    """x where `share` is 1, y where it is 0: three lanes each."""
    rest = 1.0 - share
    return share * x[0] + rest * y[0], share * x[1] + rest * y[1], share * x[2] + rest * y[2]


@inline
def visible_slopes(along, z, a, b, a_z, b_z, bound):
    """Least and greatest slope x/z (or y/z) of the part before the eye of a disc at (along, z) with scaled
    axes a and b: where the planes along = k·z touch it. For a disc through the eye's plane at least one is
    NO_BOUND."""
    zero, one, far = fill(z, 0.0), fill(z, 1.0), fill(z, NO_BOUND)
    p = z * z - bound * (a_z * a_z + b_z * b_z)
    q = along * z - bound * (a * a_z + b * b_z)
    r = along * along - bound * (a * a + b * b)
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
    """Half extent around the mean, px, of a disc's part within the picture; below 0 where there is none."""
    low = low - (abs(low) + 1.0) * BOX_SLACK
    high = high + (abs(high) + 1.0) * BOX_SLACK
    first = max(low * focal + centre - dot, fill(low, 0.0))
    last = min(high * focal + centre + dot, fill(low, size))
    half = max(max(last - mean, mean - first), dot)  # noqa: PLW3301 vectors come in twos
    return half - keep_if_below(half + 1.0, last, first)


@inline
def project_surfels(view, perspective, tx, ty, tz, axes, scales, bound, lanes, first):
    """Writes the rows of LANES splats to the columns of `lanes` from `first` on. Returns whether they can be
    visible, 1 or 0, and M, (2, 3) row by row: the image of u² + v² <= bound is within the ellipse of M·Mᵀ
    with that bound around the mean.

    All are float64 vectors: camera points, three unit axes in camera axes, three scales, bound.
    """
    plain, bound = bound, bound * (1 + EXTENT_SLACK) + EXTENT_SLACK
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
    normal_ray = n[0] * rx + n[1] * ry + n[2]
    flip = one - 2.0 * keep_if_below(one, normal_ray, zero)
    normal_ray = normal_ray * flip
    growth, max_tilt = one, normal_ray * (tz - near)
    if perspective > 0:
        deepest = math.sqrt(s_u * e_u[2] * (s_u * e_u[2]) + s_v * e_v[2] * (s_v * e_v[2]))
        growth = tz / max(tz - math.sqrt(bound) * deepest, fill(tz, near))
        max_tilt = normal_ray * (tz * (1.0 / near) - 1.0)

    u_size, v_size = SURFEL_SCALE * distance / s_u, SURFEL_SCALE * distance / s_v
    store(lanes, (first + UX) * LANES, (e_v[1] - e_v[2] * ry) * u_size * (1.0 / view.fx))
    store(lanes, (first + UY) * LANES, (e_v[2] * rx - e_v[0]) * u_size * (1.0 / view.fy))
    store(lanes, (first + VX) * LANES, (e_u[1] - e_u[2] * ry) * v_size * (1.0 / view.fx))
    store(lanes, (first + VY) * LANES, (e_u[2] * rx - e_u[0]) * v_size * (1.0 / view.fy))
    store(lanes, (first + NORMAL_RAY) * LANES, normal_ray)
    store(lanes, (first + NORMAL_X) * LANES, n[0] * flip * (1.0 / view.fx))
    store(lanes, (first + NORMAL_Y) * LANES, n[1] * flip * (1.0 / view.fy))
    store(lanes, (first + MAX_TILT) * LANES, max_tilt)

    u_length, v_length = s_u * growth / distance, s_v * growth / distance
    m0, m1 = (e_u[0] - rx * e_u[2]) * u_length * view.fx, (e_v[0] - rx * e_v[2]) * v_length * view.fx
    m3, m4 = (e_u[1] - ry * e_u[2]) * u_length * view.fy, (e_v[1] - ry * e_v[2]) * v_length * view.fy
    visible = one
    if perspective > 0:
        # Where the ellipse would be far too large: one around a box, as far as that is in the picture.
        dot = math.sqrt(bound * view.blur)
        a_z, b_z = s_u * e_u[2], s_v * e_v[2]
        low, high = visible_slopes(tx, tz, s_u * e_u[0], s_v * e_v[0], a_z, b_z, bound)
        x_half = half_box(low, high, view.fx, view.cx, view.width, rx * view.fx + view.cx, dot)
        low, high = visible_slopes(ty, tz, s_u * e_u[1], s_v * e_v[1], a_z, b_z, bound)
        y_half = half_box(low, high, view.fy, view.cy, view.height, ry * view.fy + view.cy, dot)
        strong = keep_if_at_least(one, growth, fill(growth, STRONG))
        visible = one - strong * keep_if_below(one, min(x_half, y_half), zero)
        boxed = strong * keep_if_below(one, 2.0 * x_half * y_half, abs(m0 * m4 - m1 * m3) * bound)
        # By the plain bound, with which tiles take M·Mᵀ: a larger one would lose them the box's edges.
        to_m = boxed * math.sqrt(2.0 / max(plain, fill(tx, LEAST_BOUND)))
        solid = one - boxed
        m0, m1, m3, m4 = solid * m0 + to_m * x_half, solid * m1, solid * m3, solid * m4 + to_m * y_half
    longest = max(max(abs(m0), abs(m1)), max(abs(m3), abs(m4)))  # noqa: PLW3301 vectors come in twos
    fits = keep_if_at_least(one, fill(longest, WIDEST), longest)
    wide = (one - fits) * WIDEST
    return visible, (fits * m0 + wide, fits * m1, zero, fits * m3, fits * m4 + wide, zero)


@inline
def surfel_exponent(u, v, tilt, slope, max_tilt, screen):
    """(u/slope)² + (v/slope)² of pixels whose rays meet the plane, at most `screen`: vectors."""
    slope = keep_if_at_least(slope, slope, fill(slope, DISC_LEAST_SLOPE))  # guard: least slope
    slope = keep_if_at_least(slope, max_tilt, tilt)  # guard: near plane
    # A slope of 0 makes these infinite, or NaN at the mean: minimum gives its second argument then.
    inverse = divide(fill(slope, 1.0), slope)
    return minimum(fma(u, u, v * v) * (inverse * inverse), screen)


@inline
def exponent_and_depth(surfels, splat, dx, dy, depth):
    """`surfel_exponent` of one splat at one pixel, float64, and the depth where the pixel's ray meets the
    plane: where the dot counts instead, `depth`, that of the mean."""
    row = surfels.rows[splat]
    normal_ray = np.float64(row[NORMAL_RAY])
    screen = surfels.sharpness * (dx * dx + dy * dy)
    tilt = row[NORMAL_X] * dx + row[NORMAL_Y] * dy
    slope = normal_ray + surfels.perspective * tilt
    if not (slope >= DISC_LEAST_SLOPE and tilt <= row[MAX_TILT]):
        return screen, depth
    u, v = (row[UX] * dx + row[UY] * dy) / slope, (row[VX] * dx + row[VY] * dy) / slope
    on_plane = u * u + v * v
    if not on_plane < screen:
        return screen, depth
    return on_plane, depth * normal_ray / slope if surfels.perspective > 0 else depth - tilt / normal_ray
