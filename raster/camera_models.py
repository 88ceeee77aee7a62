"""Camera models, forward and backward: pinhole, lens, and parallel rays.

The kernels take an `Optics` beside the `View`. Which of its fields are None is part of their type, so numba
compiles one variant per camera model, and that for pinholes has no instruction of the others.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.extending import register_jitable

from splatview.raster.compiling import inline
from splatview.raster.exponentials import emit_polynomial
from splatview.raster.simd import Vector, fill, intrinsic, keep_if_at_least, keep_if_below
from splatview.scene import Camera
from splatview.scene import lens_formula as formula
from splatview.scene.lens_formula import (
    LEAST_RADIUS_SQUARED,
    LEAST_RHO_SQUARED,
    LensForm,
    lens_bending,
    lens_jacobian,
    lens_point,
)

for _function in (
    formula.multiplied,
    formula.added,
    formula.stretch,
    formula.skew,
    formula.skew_jacobian,
    formula.skew_bending,
    lens_point,
    lens_jacobian,
    lens_bending,
):
    register_jitable(error_model="numpy", fastmath={"contract"})(_function)


class Optics(NamedTuple):
    """All None for a pinhole; at most one is not. Functions take them one by one, as numba drops branches by
    arguments that are None, but not by their attributes."""

    lens: LensForm | None = None
    parallel: bool | None = None
    """True where rays are parallel."""


PINHOLE = Optics()


def make_optics(camera: Camera) -> Optics:
    return Optics(
        lens=None if camera.lens is None else camera.lens.form,
        parallel=True if camera.orthographic else None,
    )


LEAST_BEND, MOST_BEND = math.tan(math.pi / 8), math.tan(3 * math.pi / 8)
"""Between them the angle is taken from 45 degrees on, above from 90 downwards."""


def _atan_coefficients(degree: int) -> list[float]:
    """Polynomial of atan(x) / x by x² on [0, LEAST_BEND²], lowest power first."""

    def quotient(squared: np.ndarray) -> np.ndarray:
        return np.arctan(np.sqrt(squared)) / np.sqrt(squared)

    polynomial = np.polynomial.Chebyshev.interpolate(quotient, degree, [0, LEAST_BEND**2])
    return polynomial.convert(kind=np.polynomial.Polynomial).coef.tolist()


@intrinsic
def _atan_quotient(typingctx: Any, squared: Any) -> Any:
    """atan(x) / x of float64 lanes x² in [0, LEAST_BEND²], to 1e-15."""
    if not (isinstance(squared, Vector) and squared.element == types.float64):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return emit_polynomial(builder, squared, args[0], _atan_coefficients(12))

    return squared(squared), codegen


@inline
def atan_lanes(x):
    """atan of float64 lanes that are at least 0, to 2e-15; NaN for NaN."""
    low, high, one = fill(x, LEAST_BEND), fill(x, MOST_BEND), fill(x, 1.0)
    # atan(x) = 45° + atan((x - 1) / (x + 1)) = 90° - atan(1 / x)
    above = keep_if_at_least(one, x, low)
    far = keep_if_at_least(one, x, high)
    middle = above - far
    top = keep_if_below(x, x, low) + middle * keep_if_below(x - one, x, high) - far
    bottom = keep_if_below(one, x, low) + middle * keep_if_below(x + one, x, high)
    y = top / (bottom + keep_if_at_least(x, x, high))
    return (middle + 2 * far) * (math.pi / 4) + y * _atan_quotient(y * y)


@inline
def magnified(form, u, v):
    """r, g and g_r of `scene.lens_formula` at rays (u, v)."""
    rr = max(u * u + v * v, LEAST_RADIUS_SQUARED)
    r = math.sqrt(rr)
    g = g_r = fill(u, 1.0)
    if form.slope > 0:
        g = atan_lanes(form.slope * r) / (form.unit * r)
        g_r = form.slope / (form.unit + form.unit * form.slope * form.slope * rr)
    elif form.alpha > 0:
        rho = math.sqrt(max(1.0 + form.beta * rr, LEAST_RHO_SQUARED))
        g = 1.0 / (1.0 - form.alpha + form.alpha * rho)
        g_r = g * g * (1.0 - form.alpha + form.alpha / rho)
    return r, g, g_r


@inline
def clamped(view, x_by_z, y_by_z):
    """The slopes that the Jacobian is taken at."""
    # guard: slope clamp := return x_by_z, y_by_z
    return min(max(x_by_z, view.min_u), view.max_u), min(max(y_by_z, view.min_v), view.max_v)


@inline
def image_point(lens, parallel, view, tx, ty, tz):
    """Image of a camera point, px."""
    if parallel is not None:
        return tx * view.fx + view.cx, ty * view.fy + view.cy
    nearness = 1.0 / tz
    u, v = tx * nearness, ty * nearness
    if lens is not None:
        _, g, _ = magnified(lens, u, v)
        u, v = lens_point(lens, u, v, g)
    return u * view.fx + view.cx, v * view.fy + view.cy


@inline
def within_lens(lens, drawn, tx, ty, tz):
    """`drawn`, and 0 for camera points outside the lens's field of view."""
    if lens is None:
        return drawn
    # Without dividing: where z is 0 that would be NaN.
    # guard: fold of the lens := return drawn
    return keep_if_below(drawn, tx * tx + ty * ty, tz * tz * lens.valid_radius_squared)


@inline
def image_axes(lens, parallel, view, tx, ty, tz):
    """P = J·W, the projection's derivative at a camera point by world position: (2, 3), row by row."""
    r = view.rotation
    if parallel is not None:
        return (
            fill(tx, view.fx * r[0, 0]),
            fill(tx, view.fx * r[0, 1]),
            fill(tx, view.fx * r[0, 2]),
            fill(tx, view.fy * r[1, 0]),
            fill(tx, view.fy * r[1, 1]),
            fill(tx, view.fy * r[1, 2]),
        )
    nearness = 1.0 / tz
    u, v = clamped(view, tx * nearness, ty * nearness)
    # Rows of the pinhole's own, for a focal length of 1.
    x0, x1, x2 = r[0, 0] - u * r[2, 0], r[0, 1] - u * r[2, 1], r[0, 2] - u * r[2, 2]
    y0, y1, y2 = r[1, 0] - v * r[2, 0], r[1, 1] - v * r[2, 1], r[1, 2] - v * r[2, 2]
    fx, fy = view.fx * nearness, view.fy * nearness
    if lens is None:
        return fx * x0, fx * x1, fx * x2, fy * y0, fy * y1, fy * y2
    bent = lens_jacobian(lens, u, v, *magnified(lens, u, v))
    xx, xy, yx, yy = fx * bent[0], fx * bent[1], fy * bent[2], fy * bent[3]
    return (
        xx * x0 + xy * y0,
        xx * x1 + xy * y1,
        xx * x2 + xy * y2,
        yx * x0 + yy * y0,
        yx * x1 + yy * y1,
        yx * x2 + yy * y2,
    )


@inline
def viewing_direction(parallel, view, ox, oy, oz):
    """The unit viewing direction, world axes, of a point at an offset from the eye, and its rate of change
    with the point: the inverse distance, or 0 where rays are parallel."""
    if parallel is not None:
        r = view.rotation
        return fill(ox, r[2, 0]), fill(ox, r[2, 1]), fill(ox, r[2, 2]), fill(ox, 0.0)
    away = 1.0 / math.sqrt(ox * ox + oy * oy + oz * oz)
    return ox * away, oy * away, oz * away, away


# The chain rule: with D (2, 3) = dL/dJ, J = diag(f)·C·[1/z, 0, -u/z; 0, 1/z, -v/z], C (2, 2) the derivative
# of the lens at the clamped slopes (u, v), 1 for a pinhole, all of it goes through E = Cᵀ·diag(f)·D, and what
# C itself changes along u and v.


@inline
def if_within(value, x, least, most):
    """`value` where least <= x <= most, else 0."""
    return keep_if_at_least(keep_if_at_least(value, x, fill(x, least)), fill(x, most), x)


@inline
def point_gradient(lens, parallel, view, x, y, z, d_x2, d_y2, d_j):
    """From dL/d(mean in the image) and D, row by row: dL/dt (3) of the camera point t = (x, y, z), and what
    turning the camera changes besides, dL/d(turn) (3): see `raster.gradients`."""
    fx, fy = view.fx, view.fy
    if parallel is not None:
        # J = [fx, 0, 0; 0, fy, 0] for all points.
        tx, ty, tz = fx * d_x2, fy * d_y2, fill(x, 0.0)
        return (
            tx,
            ty,
            tz,
            y * tz - z * ty - fy * d_j[5],
            z * tx - x * tz + fx * d_j[2],
            x * ty - y * tx + fy * d_j[3] - fx * d_j[1],
        )
    nearness = 1.0 / z
    x_by_z, y_by_z = x * nearness, y * nearness
    u, v = clamped(view, x_by_z, y_by_z)
    d_u2, d_v2 = fx * d_x2, fy * d_y2
    e = fx * d_j[0], fx * d_j[1], fx * d_j[2], fy * d_j[3], fy * d_j[4], fy * d_j[5]
    bend_u = bend_v = fill(x, 0.0)
    if lens is not None:
        at_mean = lens_jacobian(lens, x_by_z, y_by_z, *magnified(lens, x_by_z, y_by_z))
        d_u2, d_v2 = at_mean[0] * d_u2 + at_mean[2] * d_v2, at_mean[1] * d_u2 + at_mean[3] * d_v2
        r, g, g_r = magnified(lens, u, v)
        # dL/dC
        c = (
            (e[0] - u * e[2]) * nearness,
            (e[1] - v * e[2]) * nearness,
            (e[3] - u * e[5]) * nearness,
            (e[4] - v * e[5]) * nearness,
        )
        one, zero = fill(x, 1.0), fill(x, 0.0)
        along_u = lens_bending(lens, u, v, r, g, g_r, one, zero)
        along_v = lens_bending(lens, u, v, r, g, g_r, zero, one)
        bend_u = c[0] * along_u[0] + c[1] * along_u[1] + c[2] * along_u[2] + c[3] * along_u[3]
        bend_v = c[0] * along_v[0] + c[1] * along_v[1] + c[2] * along_v[2] + c[3] * along_v[3]
        bent = lens_jacobian(lens, u, v, r, g, g_r)
        e = (
            bent[0] * e[0] + bent[2] * e[3],
            bent[0] * e[1] + bent[2] * e[4],
            bent[0] * e[2] + bent[2] * e[5],
            bent[1] * e[0] + bent[3] * e[3],
            bent[1] * e[1] + bent[3] * e[4],
            bent[1] * e[2] + bent[3] * e[5],
        )
    # The mean.
    tx, ty = nearness * d_u2, nearness * d_v2
    tz = -(x_by_z * tx + y_by_z * ty)
    # J; u and v follow x/z and y/z where they are not clamped.
    e0, e1, e2 = nearness * e[0], nearness * e[1], nearness * e[2]
    e3, e4, e5 = nearness * e[3], nearness * e[4], nearness * e[5]
    tz = tz - (e0 + e4 - u * e2 - v * e5) * nearness
    d_u = if_within(bend_u - e2, x_by_z, view.min_u, view.max_u)
    d_v = if_within(bend_v - e5, y_by_z, view.min_v, view.max_v)
    tx, ty = tx + d_u * nearness, ty + d_v * nearness
    tz = tz - (d_u * u + d_v * v) * nearness
    # Jᵀ·D; its antisymmetric part turns.
    return (
        tx,
        ty,
        tz,
        y * tz - z * ty - u * e1 - v * e4 - e5,
        z * tx - x * tz + e2 + u * e0 + v * e3,
        x * ty - y * tx + e3 - e1,
    )
