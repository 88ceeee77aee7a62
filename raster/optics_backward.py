"""The chain rule of `optics`: from gradients by the footprint to gradients by the splat's place.

With D (2, 3) = dL/dJ, J = diag(f)·C·[1/z, 0, -u/z; 0, 1/z, -v/z], C (2, 2) the derivative of the lens at the
clamped slopes (u, v), 1 for a pinhole, all of it goes through E = Cᵀ·diag(f)·D, and what C itself changes
along u and v.
"""

from __future__ import annotations

from ..scene.lens_formula import lens_bending, lens_jacobian
from .compiling import inline
from .optics import clamped, magnified
from .simd import fill, keep_if_at_least


@inline
def if_within(value, x, least, most):
    """`value` where least <= x <= most, else 0."""
    return keep_if_at_least(keep_if_at_least(value, x, fill(x, least)), fill(x, most), x)


@inline
def point_gradient(view, optics, x, y, z, d_x2, d_y2, d_j):
    """From dL/d(mean in the image) and D, row by row: dL/dt (3) of the camera point t = (x, y, z), and what
    turning the camera changes besides, dL/d(turn) (3): see `raster.gradients`."""
    return _point_gradient(optics.lens, optics.parallel, view, x, y, z, d_x2, d_y2, d_j)


@inline
def _point_gradient(lens, parallel, view, x, y, z, d_x2, d_y2, d_j):
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
