"""Flat splats: planar discs that each pixel's ray meets (image model, steps 2d to 4d).

With t the mean in camera axes, e_u, e_v and n the unit axes of a splat, s_u and s_v its larger scales, a ray
p·z meets the plane at z = n·t / n·p, and u = e_u·(p·z - t) / s_u loses its digits where the disc is small or
far away: both terms are as long as t. The ray through a pixel that is d px from the projected mean is
p = r + δ, r = t / t.z and δ = (d.x/fx, d.y/fy, 0), and with it the difference can be taken by hand:

    u = (t.z / s_u) · (e_v x r)·δ / (n·p),    v = (t.z / s_v) · (e_u x r)·δ / (n·p)

but for signs, which the squares do not see. Numerators are linear in d and 0 at the mean; the denominator
n·p = n·r + n·δ is linear too. So a pixel costs three dot products of two and a division. Parallel rays are
the same with r = p = (0, 0, 1), t.z / s = 1 / s and n·p = n.z for all pixels.

Float32 then has an error of some 3e-7 in the directions e and n, and of the rounding of the mean's pixel.
Both are harmless but where a plane is met at a flat angle and where a line is thinner than a pixel by far:
there the image model has its limits, DISC_LEAST_SLOPE and DISC_LEAST_WIDTH.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.errors import InputError
from splatview.scene.image_model import DISC_LEAST_SLOPE, DISC_LEAST_WIDTH, ImageModel

LEAST_SCALE = 2.0**-126
"""World units: scales below are equal when the plane's normal is chosen; float32 may hold them as 0."""

LEAST_NEAR = 1e-6
"""World units: a disc is never seen nearer, whatever the near plane, or it would be seen everywhere."""

WIDEST = 1e15
"""px: an ellipse about a disc that would be longer is a circle of this radius. Its square is finite in
float32, and no mean in front of the eye is seen as far from the picture."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Surfels:
    """How pixels meet the planes of V splats; d is px from the projected mean."""

    uv_rows: np.ndarray
    """(V, 2, 2) 1/px: u and v are rows·d / slope."""
    normal_dot: np.ndarray
    """(V,) n·p of the ray to the mean, at least 0."""
    normal_gradient: np.ndarray
    """(V, 2) 1/px: n·δ = leaning·d."""
    max_normal_change: np.ndarray
    """(V,) n·δ beyond which the plane is met nearer than the near plane."""
    perspective: bool
    """Rays come from the eye: slope = facing + n·δ. Parallel ones: slope = facing."""

    def take(self, which: np.ndarray) -> Surfels:
        """Those at `which` (integers or booleans)."""
        return Surfels(
            uv_rows=self.uv_rows[which],
            normal_dot=self.normal_dot[which],
            normal_gradient=self.normal_gradient[which],
            max_normal_change=self.max_normal_change[which],
            perspective=self.perspective,
        )


def check_surfels(camera: Camera, model: ImageModel) -> None:
    """Raises InputError where `model` has discs and `camera` a lens."""
    if model.footprint == "disc" and camera.lens is not None:
        raise InputError(
            f"camera {camera.name!r} has a lens, and discs are drawn without one: "
            "take the distortion out of its photo first, or use --footprint ellipsoid"
        )


def project_surfels(
    t: np.ndarray, axes: np.ndarray, scales: np.ndarray, reach: np.ndarray, camera: Camera, model: ImageModel
) -> tuple[Surfels, np.ndarray]:
    """Discs at camera points t (V, 3) in front of the eye, with unit axes (V, 3, 3), columns in camera axes,
    and scales (V, 3), world units. All have one dtype, float32 or float64, which the results have too.

    The second is M (V, 2, 3), px: the disc u² + v² <= reach (V,) is seen within the ellipse of M·Mᵀ with
    that reach about the projected mean.
    """
    dtype, z, near = t.dtype, t[:, 2], max(model.near, LEAST_NEAR)
    focal = np.array([camera.fx, camera.fy], dtype=dtype)
    normal = 2 - np.argmin(np.maximum(scales, dtype.type(LEAST_SCALE))[:, ::-1], axis=1)
    first, second = np.where(normal == 0, 1, 0), np.where(normal == 2, 1, 2)
    each = np.arange(len(t))
    e_u, e_v, n = axes[each, :, first], axes[each, :, second], axes[each, :, normal]
    if camera.orthographic:
        r = np.broadcast_to(np.array([0, 0, 1], dtype=dtype), t.shape)
        distance = np.ones_like(z)
    else:
        r, distance = t / z[:, None], z
    least = dtype.type(DISC_LEAST_WIDTH / camera.fx) * distance
    s_u, s_v = np.maximum(scales[each, first], least), np.maximum(scales[each, second], least)

    normal_dot = (n * r).sum(axis=1)
    turn = np.where(normal_dot < 0, dtype.type(-1), dtype.type(1))
    normal_dot, n = normal_dot * turn, n * turn[:, None]
    # Huge scales make numbers of no size at all, and of infinite ones: both are right.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        uv_rows = np.stack(
            [
                np.cross(e_v, r)[:, :2] * (distance / s_u)[:, None] / focal,
                np.cross(e_u, r)[:, :2] * (distance / s_v)[:, None] / focal,
            ],
            axis=1,
        )
        M = np.zeros((len(t), 2, 3), dtype=dtype)
        for column, (e, s) in enumerate(((e_u, s_u), (e_v, s_v))):
            M[:, :, column] = (e[:, :2] - r[:, :2] * e[:, 2:]) * (s / distance)[:, None] * focal
        if camera.orthographic:
            max_normal_change = normal_dot * (z - near)
        else:
            # Of what is nearer than the mean an affine picture is too small, by t.z over its depth.
            deepest = np.hypot(s_u * e_u[:, 2], s_v * e_v[:, 2])
            M *= (z / np.fmax(z - np.sqrt(reach) * deepest, near))[:, None, None]
            max_normal_change = normal_dot * (z / near - 1)
        widest = ~(np.abs(M).max(axis=(1, 2), initial=0) <= WIDEST)
        M[widest] = WIDEST * np.eye(2, 3)
    surfels = Surfels(
        uv_rows=uv_rows,
        normal_dot=normal_dot,
        normal_gradient=n[:, :2] / focal,
        max_normal_change=max_normal_change.astype(dtype),
        perspective=not camera.orthographic,
    )
    return surfels, M


def squared_distances(surfels: Surfels, which: np.ndarray, d: np.ndarray, blur: float) -> np.ndarray:
    """q (R, P) with exp(-q/2) = max(G_plane, G_screen), of discs `which` (R,) at d (R, P, 2) px from their
    means. Image model: step 4d."""
    x, y = d[..., 0], d[..., 1]
    (ux, uy), (vx, vy) = (surfels.uv_rows[which, i].T[:, :, None] for i in range(2))
    lean = surfels.normal_gradient[which, 0:1] * x + surfels.normal_gradient[which, 1:2] * y
    slope = surfels.normal_dot[which, None] + (lean if surfels.perspective else 0)
    met = (slope >= DISC_LEAST_SLOPE) & (lean <= surfels.max_normal_change[which, None])
    # Far outside a tiny splat squares overflow to inf: exp gives the right 0.
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        on_plane = ((ux * x + uy * y) / slope) ** 2 + ((vx * x + vy * y) / slope) ** 2
        squared = x * x + y * y
        on_screen = np.where(squared > 0, squared / d.dtype.type(blur), 0)
    return np.minimum(np.where(met, on_plane, np.inf), on_screen).astype(d.dtype)
