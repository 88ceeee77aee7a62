"""The one formula that all lens models are cases of, with its first and second derivatives.

A ray of the pinhole at (u, v) = (x/z, y/z) goes to (u', v') in three steps:

1.  bend     a = g·(u, v), r = |(u, v)|: for fisheyes g = atan(slope·r) / (unit·r); for a unified camera
             g = 1 / (1 - alpha + alpha·rho), rho = sqrt(1 + beta·r²), which is 1 where alpha is 0;
2.  stretch  b = a·N(q)/D(q), q = |a|², N and D polynomials that begin with 1;
3.  skew     (u', v') = b + T(w): lenses that sit askew, and thin prisms, with w = a, or b where the model
             says so: T = (2·p1·x·y + p2·(3·x² + y²) + s1·q + s2·q²,
                           2·p2·x·y + p1·(x² + 3·y²) + s3·q + s4·q²), x, y = w, q = |w|².

Everything here is plain arithmetic, so that the same lines work on numbers, on arrays of numpy, on tensors
and in compiled kernels. Square root and arctangent differ between those: callers bring r and the two
magnifications of step 1, across the radius (g) and along it (g_r = dg·r/dr). 2x2 matrices are four numbers,
row by row.
"""

from __future__ import annotations

from typing import Any, NamedTuple

LEAST_RADIUS_SQUARED = 1e-16
"""What r² is at least taken as, so that nothing divides by 0: nearer to the axis sin, tan and the angle
itself are the same number."""

LEAST_RHO_SQUARED = 1e-5
"""What rho² is at least taken as. Where beta is below 0 it ends at 0, and g_r has a pole there; float32 has
rho² to 1e-7, so that g_r is right to 1 % up to here. Rays beyond are not seen: of what a division lens
shows, the last 0.3 % of the radius."""


class LensForm(NamedTuple):
    """The numbers of the formula, all float but the last."""

    slope: float
    """0 where the lens is no fisheye."""
    unit: float
    alpha: float
    """0 where the lens is no unified camera."""
    beta: float
    n1: float
    n2: float
    n3: float
    n4: float
    n5: float
    n6: float
    d1: float
    d2: float
    d3: float
    p1: float
    p2: float
    s1: float
    s2: float
    s3: float
    s4: float
    valid_radius_squared: float
    """r² from which on the lens no longer keeps rays in order; inf where it always does."""
    skew_last: bool
    """Whether w = b."""


def multiplied(a: Any, b: Any) -> Any:
    """The product of two 2x2 matrices."""
    return (
        a[0] * b[0] + a[1] * b[2],
        a[0] * b[1] + a[1] * b[3],
        a[2] * b[0] + a[3] * b[2],
        a[2] * b[1] + a[3] * b[3],
    )


def added(a: Any, b: Any) -> Any:
    """The sum of two 2x2 matrices."""
    return a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3]


def stretch(form: Any, q: Any) -> Any:
    """N/D at q, and its first and second derivative by q."""
    n = 1 + q * (form.n1 + q * (form.n2 + q * (form.n3 + q * (form.n4 + q * (form.n5 + q * form.n6)))))
    n_1 = form.n1 + q * (
        2 * form.n2 + q * (3 * form.n3 + q * (4 * form.n4 + q * (5 * form.n5 + q * (6 * form.n6))))
    )
    n_2 = 2 * form.n2 + q * (6 * form.n3 + q * (12 * form.n4 + q * (20 * form.n5 + q * (30 * form.n6))))
    inverse = 1 / (1 + q * (form.d1 + q * (form.d2 + q * form.d3)))
    d_1, d_2 = form.d1 + q * (2 * form.d2 + q * (3 * form.d3)), 2 * form.d2 + q * (6 * form.d3)
    ratio = n * inverse
    ratio_1 = (n_1 - ratio * d_1) * inverse
    return ratio, ratio_1, (n_2 - 2 * ratio_1 * d_1 - ratio * d_2) * inverse


def skew(form: Any, x: Any, y: Any) -> Any:
    """T at w = (x, y)."""
    q = x * x + y * y
    return (
        2 * form.p1 * x * y + form.p2 * (3 * x * x + y * y) + q * (form.s1 + form.s2 * q),
        2 * form.p2 * x * y + form.p1 * (x * x + 3 * y * y) + q * (form.s3 + form.s4 * q),
    )


def skew_jacobian(form: Any, x: Any, y: Any) -> Any:
    """dT/dw."""
    q = x * x + y * y
    prism_x, prism_y = 2 * (form.s1 + 2 * form.s2 * q), 2 * (form.s3 + 2 * form.s4 * q)
    return (
        2 * form.p1 * y + 6 * form.p2 * x + prism_x * x,
        2 * form.p1 * x + 2 * form.p2 * y + prism_x * y,
        2 * form.p2 * y + 2 * form.p1 * x + prism_y * x,
        2 * form.p2 * x + 6 * form.p1 * y + prism_y * y,
    )


def skew_bending(form: Any, x: Any, y: Any, dx: Any, dy: Any) -> Any:
    """The change of dT/dw along dw = (dx, dy)."""
    q, dq = x * x + y * y, 2 * (x * dx + y * dy)
    prism_x, prism_y = 2 * (form.s1 + 2 * form.s2 * q), 2 * (form.s3 + 2 * form.s4 * q)
    d_prism_x, d_prism_y = 4 * form.s2 * dq, 4 * form.s4 * dq
    return (
        2 * form.p1 * dy + 6 * form.p2 * dx + prism_x * dx + d_prism_x * x,
        2 * form.p1 * dx + 2 * form.p2 * dy + prism_x * dy + d_prism_x * y,
        2 * form.p2 * dy + 2 * form.p1 * dx + prism_y * dx + d_prism_y * x,
        2 * form.p2 * dx + 6 * form.p1 * dy + prism_y * dy + d_prism_y * y,
    )


def lens_point(form: Any, u: Any, v: Any, g: Any) -> Any:
    """(u', v')."""
    ax, ay = g * u, g * v
    ratio, _, _ = stretch(form, ax * ax + ay * ay)
    bx, by = ratio * ax, ratio * ay
    if form.skew_last:
        tx, ty = skew(form, bx, by)
    else:
        tx, ty = skew(form, ax, ay)
    return bx + tx, by + ty


def lens_jacobian(form: Any, u: Any, v: Any, r: Any, g: Any, g_r: Any) -> Any:
    """d(u', v') / d(u, v)."""
    nx, ny, along = u / r, v / r, g_r - g
    bend = (g + along * nx * nx, along * nx * ny, along * nx * ny, g + along * ny * ny)
    ax, ay = g * u, g * v
    ratio, ratio_1, _ = stretch(form, ax * ax + ay * ay)
    cross = 2 * ratio_1 * ax * ay
    grow = (ratio + 2 * ratio_1 * ax * ax, cross, cross, ratio + 2 * ratio_1 * ay * ay)
    if form.skew_last:
        t = skew_jacobian(form, ratio * ax, ratio * ay)
        return multiplied((1 + t[0], t[1], t[2], 1 + t[3]), multiplied(grow, bend))
    return multiplied(added(grow, skew_jacobian(form, ax, ay)), bend)


def lens_bending(form: Any, u: Any, v: Any, r: Any, g: Any, g_r: Any, du: Any, dv: Any) -> Any:
    """The change of `lens_jacobian` along (du, dv)."""
    # Step 1 and its change: with n = (u, v) / r, J = g·I + (g_r - g)·n·nᵀ.
    nx, ny, along = u / r, v / r, g_r - g
    bend = (g + along * nx * nx, along * nx * ny, along * nx * ny, g + along * ny * ny)
    dr = nx * du + ny * dv
    dg = along / r * dr
    if form.slope > 0:
        slope_squared = form.slope * form.slope
        d_along = -2 * slope_squared * r * g_r / (1 + slope_squared * r * r) * dr - dg
    else:
        # Of g_r = g²·(1 - alpha + alpha / rho); all 0 where g is 1.
        by_rho = (g_r - (1 - form.alpha) * g * g) * form.beta * r / (1 + form.beta * r * r)
        d_along = 2 * g_r / g * dg - by_rho * dr - dg
    turn_x, turn_y = along / r * (du - nx * dr), along / r * (dv - ny * dr)
    off = d_along * nx * ny + turn_x * ny + turn_y * nx
    d_bend = (
        dg + d_along * nx * nx + 2 * turn_x * nx,
        off,
        off,
        dg + d_along * ny * ny + 2 * turn_y * ny,
    )
    # Step 2.
    ax, ay = g * u, g * v
    dax, day = bend[0] * du + bend[1] * dv, bend[2] * du + bend[3] * dv
    ratio, ratio_1, ratio_2 = stretch(form, ax * ax + ay * ay)
    dq = 2 * (ax * dax + ay * day)
    cross = 2 * ratio_1 * ax * ay
    grow = (ratio + 2 * ratio_1 * ax * ax, cross, cross, ratio + 2 * ratio_1 * ay * ay)
    d_ratio, d_ratio_1 = ratio_1 * dq, ratio_2 * dq
    d_cross = 2 * (d_ratio_1 * ax * ay + ratio_1 * (dax * ay + ax * day))
    d_grow = (
        d_ratio + 2 * d_ratio_1 * ax * ax + 4 * ratio_1 * ax * dax,
        d_cross,
        d_cross,
        d_ratio + 2 * d_ratio_1 * ay * ay + 4 * ratio_1 * ay * day,
    )
    # Step 3, and the product rule.
    if form.skew_last:
        bx, by = ratio * ax, ratio * ay
        dbx, dby = grow[0] * dax + grow[1] * day, grow[2] * dax + grow[3] * day
        t = skew_jacobian(form, bx, by)
        shear = (1 + t[0], t[1], t[2], 1 + t[3])
        d_shear = skew_bending(form, bx, by, dbx, dby)
        d_both = added(multiplied(d_grow, bend), multiplied(grow, d_bend))
        return added(multiplied(d_shear, multiplied(grow, bend)), multiplied(shear, d_both))
    outer = added(grow, skew_jacobian(form, ax, ay))
    d_outer = added(d_grow, skew_bending(form, ax, ay, dax, day))
    return added(multiplied(d_outer, bend), multiplied(outer, d_bend))
