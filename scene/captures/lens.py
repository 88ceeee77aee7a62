"""Lens distortion: where the lens puts the ray that a pinhole would put at (u, v).

Coordinates are those of the plane one unit in front of the eye: u = x/z, v = y/z; the pixel is
(fx·u' + cx, fy·v' + cy) with (u', v') = distort(u, v). The models and the order of their parameters are
COLMAP's (its documentation, "Camera Models"), but for RADIAL4 (k1 k2 k3 k4 p1 p2), which nerfstudio and
Metashape use. The formulas are those of Brown (1966), of Kannala and Brandt (2006) for fisheyes, of
Devernay and Faugeras (2001) for FOV, and of Weng et al. (1992) for thin prisms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..files.colmap import ColmapCamera

Points = np.ndarray
"""(..., 2) float64, u and v."""

NEWTON_STEPS = 30
NEWTON_TOLERANCE = 1e-13
NEWTON_DELTA = 1e-6
"""Half the step of the central differences."""

FOLD_DIRECTIONS = 16
FOLD_STEPS = 400
"""Sampling of the radius beyond which a polynomial turns back on itself."""

MIN_RADIUS = 1e-8
"""Of a ray from the axis: below it sin, tan and the angle itself are the same number."""


def distort(points: Points, lens: ColmapCamera) -> Points:
    """(..., 2) rays of a pinhole -> (..., 2) where the lens puts them, float64."""
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        return _MODELS[lens.model](np.asarray(points, dtype=np.float64), lens.distortion)


def undistort(points: Points, lens: ColmapCamera) -> Points:
    """The inverse of `distort` by Newton's method; NaN where no ray within the fold goes there."""
    target = np.asarray(points, dtype=np.float64)
    rays = target.copy()
    along_u, along_v = np.array([NEWTON_DELTA, 0]), np.array([0, NEWTON_DELTA])
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(NEWTON_STEPS):
            error = distort(rays, lens) - target
            du = (distort(rays + along_u, lens) - distort(rays - along_u, lens)) / (2 * NEWTON_DELTA)
            dv = (distort(rays + along_v, lens) - distort(rays - along_v, lens)) / (2 * NEWTON_DELTA)
            det = du[..., 0] * dv[..., 1] - du[..., 1] * dv[..., 0]
            move = np.stack(
                [
                    (error[..., 0] * dv[..., 1] - error[..., 1] * dv[..., 0]) / det,
                    (error[..., 1] * du[..., 0] - error[..., 0] * du[..., 1]) / det,
                ],
                axis=-1,
            )
            # A fisheye's edge is far out on the plane: steps are cut so that none overshoots to infinity.
            limit = 0.5 * (1 + np.linalg.norm(rays, axis=-1, keepdims=True))
            length = np.linalg.norm(move, axis=-1, keepdims=True)
            rays -= move * np.minimum(1, limit / np.maximum(length, 1e-300))
            if not (np.abs(error) > NEWTON_TOLERANCE).any():
                break
        wrong = ~(
            np.abs(distort(rays, lens) - target).max(axis=-1) <= 1e-9 * (1 + np.abs(target).max(axis=-1))
        )
        wrong |= ~(np.linalg.norm(rays, axis=-1) < fold_radius(lens, 1e3))
    rays[wrong] = np.nan
    return rays


def fold_radius(lens: ColmapCamera, reach: float) -> float:
    """The radius, up to `reach`, within which the lens keeps rays in order; inf where it does to `reach`.

    Polynomials fitted to a photo turn back outside it, and would show parts of the photo again there.
    """
    if not any(lens.distortion):
        return np.inf
    angle = np.linspace(0, 2 * np.pi, FOLD_DIRECTIONS, endpoint=False)
    # By angle from the axis: even steps of u crowd where a fisheye has nothing.
    radius = np.tan(np.linspace(0, np.arctan(reach), FOLD_STEPS + 1))
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    outward = (distort(radius[:, None, None] * direction, lens) * direction).sum(axis=-1)
    # Along a fisheye's edge rays crowd, so that rounding alone could seem to turn them back.
    folds = ~(np.diff(outward, axis=0) > -1e-12).all(axis=1)
    return float(radius[folds.argmax()]) if folds.any() else np.inf


def _brown(points: Points, radial: np.ndarray, p1: float, p2: float) -> Points:
    """`radial` is the relative change of the radius; p1 and p2 are of a lens that sits askew."""
    u, v = points[..., 0], points[..., 1]
    rr = u * u + v * v
    return np.stack(
        [
            u + u * radial + 2 * p1 * u * v + p2 * (rr + 2 * u * u),
            v + v * radial + 2 * p2 * u * v + p1 * (rr + 2 * v * v),
        ],
        axis=-1,
    )


def _rr(points: Points) -> np.ndarray:
    return (points * points).sum(axis=-1)


def _series(rr: np.ndarray, coefficients) -> np.ndarray:
    """c0·rr + c1·rr² + ..."""
    total = np.zeros_like(rr)
    for coefficient in reversed(coefficients):
        total = (total + coefficient) * rr
    return total


def _pinhole(points: Points, k) -> Points:
    return points.copy()


def _radial(points: Points, k) -> Points:
    return points * (1 + _series(_rr(points), k))[..., None]


def _opencv(points: Points, k) -> Points:
    return _brown(points, _series(_rr(points), k[:2]), k[2], k[3])


def _radial4(points: Points, k) -> Points:
    return _brown(points, _series(_rr(points), k[:4]), k[4], k[5])


def _full_opencv(points: Points, k) -> Points:
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    rr = _rr(points)
    return _brown(points, (1 + _series(rr, (k1, k2, k3))) / (1 + _series(rr, (k4, k5, k6))) - 1, p1, p2)


def _by_angle(points: Points) -> Points:
    """The ideal fisheye: the distance from the centre is the angle from the axis, in radians."""
    radius = np.sqrt(_rr(points))
    scale = np.where(radius > MIN_RADIUS, np.arctan(radius) / np.maximum(radius, MIN_RADIUS), 1)
    return points * scale[..., None]


def _fisheye(points: Points, k) -> Points:
    return _radial(_by_angle(points), k)


def _fov(points: Points, k) -> Points:
    (omega,) = k
    if not abs(omega) > 1e-6:
        return points.copy()
    radius = np.sqrt(_rr(points))
    slope = 2 * np.tan(omega / 2)
    scale = np.where(
        radius > MIN_RADIUS,
        np.arctan(radius * slope) / (np.maximum(radius, MIN_RADIUS) * omega),
        slope / omega,
    )
    return points * scale[..., None]


def _thin_prism_fisheye(points: Points, k) -> Points:
    k1, k2, p1, p2, k3, k4, sx1, sy1 = k
    flat = _by_angle(points)
    rr = _rr(flat)
    return _brown(flat, _series(rr, (k1, k2, k3, k4)), p1, p2) + rr[..., None] * (sx1, sy1)


def _rad_tan_thin_prism_fisheye(points: Points, k) -> Points:
    flat = _radial(_by_angle(points), k[:6])
    p0, p1, s0, s1, s2, s3 = k[6:]
    rr = _rr(flat)
    prism = np.stack([_series(rr, (s0, s1)), _series(rr, (s2, s3))], axis=-1)
    # Here the first of the pair goes with u; in the models above the second does.
    return _brown(flat, np.zeros_like(rr), p1, p0) + prism


_MODELS: dict[str, Callable[[Points, tuple[float, ...]], Points]] = {
    "SIMPLE_PINHOLE": _pinhole,
    "PINHOLE": _pinhole,
    "SIMPLE_RADIAL": _radial,
    "RADIAL": _radial,
    "OPENCV": _opencv,
    "OPENCV_FISHEYE": _fisheye,
    "FULL_OPENCV": _full_opencv,
    "RADIAL4": _radial4,
    "FOV": _fov,
    "SIMPLE_RADIAL_FISHEYE": _fisheye,
    "RADIAL_FISHEYE": _fisheye,
    "THIN_PRISM_FISHEYE": _thin_prism_fisheye,
    "RAD_TAN_THIN_PRISM_FISHEYE": _rad_tan_thin_prism_fisheye,
}
