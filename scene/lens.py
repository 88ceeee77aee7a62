"""Lenses that are no pinholes: where they put the ray that a pinhole would put at (u, v).

Coordinates are those of the plane one unit in front of the eye: u = x/z, v = y/z; the pixel is
(fx·u' + cx, fy·v' + cy) with (u', v') = distort(u, v). The models and the order of their parameters are
COLMAP's (its documentation, "Camera Models"), but for RADIAL4 (k1 k2 k3 k4 p1 p2), which nerfstudio and
Metashape use. The formulas are those of Brown (1966), of Kannala and Brandt (2006) for fisheyes, of
Devernay and Faugeras (2001) for FOV, of Weng et al. (1992) for thin prisms, of Khomutenko et al. (2016) for
EUCM, and of Fitzgibbon (2001) for division, which is EUCM with alpha = 1/2 and beta = -4·k; `lens_formula`
is all of them in one.

Only what lies before the eye is seen, z > 0: of a fisheye of 180 degrees or more, what is within
FISHEYE_REACH.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from splatview.scene.lens_formula import (
    LEAST_RADIUS_SQUARED,
    LEAST_RHO_SQUARED,
    LensForm,
    lens_jacobian,
    lens_point,
)

Points = np.ndarray
"""(..., 2), u and v."""

COUNTS = {
    "SIMPLE_PINHOLE": 0,
    "PINHOLE": 0,
    "SIMPLE_RADIAL": 1,
    "RADIAL": 2,
    "OPENCV": 4,
    "OPENCV_FISHEYE": 4,
    "FULL_OPENCV": 8,
    "RADIAL4": 6,
    "FOV": 1,
    "SIMPLE_RADIAL_FISHEYE": 1,
    "RADIAL_FISHEYE": 2,
    "THIN_PRISM_FISHEYE": 8,
    "RAD_TAN_THIN_PRISM_FISHEYE": 12,
    "SIMPLE_DIVISION": 1,
    "DIVISION": 1,
    "SIMPLE_FISHEYE": 0,
    "FISHEYE": 0,
    "EUCM": 2,
}
"""Parameters of each model beside focal lengths and principal point."""

FISHEYE_RADIUS = 1e3
"""Largest r of a ray that a fisheye shows, 89.94 degrees from the axis: beyond it float32 has no digits left
in the plane one unit ahead, where all of this is computed."""

LEAST_OMEGA = 1e-6
"""Angle of a FOV lens, radians, below which it is a pinhole to the last digit."""

NEWTON_STEPS = 30
NEWTON_TOLERANCE = 1e-13

FOLD_DIRECTIONS, FOLD_STEPS = 32, 400
"""Sampling of where a polynomial turns back on itself; bisection does the rest."""

BORDER_SAMPLES = 48
"""A side of the picture, for what of the plane it sees. The extremes of smooth curves between two samples
are beyond theirs by less than a thousandth."""


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Raises ValueError: an unknown model, a wrong number of parameters, or some that are not finite."""

    model: str
    """COLMAP's name."""
    parameters: tuple[float, ...] = ()
    """The distortion in the order of the model, without focal lengths and principal point."""

    def __post_init__(self) -> None:
        if self.model not in COUNTS:
            raise ValueError(f"unknown lens model {self.model!r}; there are {', '.join(COUNTS)}")
        if len(self.parameters) != COUNTS[self.model]:
            raise ValueError(
                f"a {self.model} lens has {COUNTS[self.model]} parameters, got {len(self.parameters)}"
            )
        if not all(map(math.isfinite, self.parameters)):
            raise ValueError(f"the parameters of a {self.model} lens must be finite")
        if self.model == "FOV" and not abs(self.parameters[0]) < math.pi:
            raise ValueError(f"the angle of a FOV lens must be below pi, got {self.parameters[0]}")
        if self.model == "EUCM":
            alpha, beta = self.parameters
            if not (0 <= alpha <= 1 and beta > 0):
                raise ValueError(
                    f"alpha of an EUCM lens must be from 0 to 1, and beta above 0, got {alpha} and {beta}"
                )

    @cached_property
    def is_pinhole(self) -> bool:
        """Whether it changes nothing. A fisheye without distortion changes a lot."""
        form = _form_of(self)
        return not form.slope and not form.alpha * form.beta and not _has_distortion(form)

    @cached_property
    def form(self) -> LensForm:
        """The numbers of `lens_formula`."""
        return _form_of(self)._replace(valid_radius_squared=self.valid_radius**2)

    @cached_property
    def valid_radius(self) -> float:
        """The radius r within which the lens keeps rays in order; inf where it always does.

        Polynomials fitted to a photo turn back outside it, and would show parts of the scene again there.
        """
        return _valid_radius(_form_of(self))

    def __str__(self) -> str:
        return f"{self.model}: {', '.join(f'{value:.4g}' for value in self.parameters)}"


def _has_distortion(form: LensForm) -> bool:
    """Whether there is more to it than a bend: steps 2 and 3 of `lens_formula`."""
    return any(form[LensForm._fields.index("n1") : LensForm._fields.index("valid_radius_squared")])


def _form_of(lens: Lens) -> LensForm:
    """All but the reach, which is inf."""
    k = lens.parameters
    fisheye = {"slope": 1.0}
    changes: dict[str, Any] = {}
    match lens.model:
        case "SIMPLE_RADIAL" | "RADIAL":
            changes = _stretched(k)
        case "OPENCV":
            changes = {**_stretched(k[:2]), "p1": k[2], "p2": k[3]}
        case "RADIAL4":
            changes = {**_stretched(k[:4]), "p1": k[4], "p2": k[5]}
        case "FULL_OPENCV":
            changes = {**_stretched((k[0], k[1], k[4])), "p1": k[2], "p2": k[3]}
            changes |= {"d1": k[5], "d2": k[6], "d3": k[7]}
        case "OPENCV_FISHEYE" | "SIMPLE_RADIAL_FISHEYE" | "RADIAL_FISHEYE" | "SIMPLE_FISHEYE" | "FISHEYE":
            changes = {**fisheye, **_stretched(k)}
        case "FOV":
            omega = abs(k[0])
            if omega > LEAST_OMEGA:
                changes = {"slope": 2 * math.tan(omega / 2), "unit": omega}
        case "THIN_PRISM_FISHEYE":
            changes = {**fisheye, **_stretched((k[0], k[1], k[4], k[5]))}
            changes |= {"p1": k[2], "p2": k[3], "s1": k[6], "s3": k[7]}
        case "RAD_TAN_THIN_PRISM_FISHEYE":
            # Here the first of the pair goes with u; in the models above the second does.
            changes = {**fisheye, **_stretched(k[:6]), "p2": k[6], "p1": k[7], "skew_last": True}
            changes |= {"s1": k[8], "s2": k[9], "s3": k[10], "s4": k[11]}
        case "SIMPLE_DIVISION" | "DIVISION":
            changes = {"alpha": 0.5, "beta": -4 * k[0]}
        case "EUCM":
            changes = {"alpha": k[0], "beta": k[1]}
    numbers: dict[str, Any] = dict.fromkeys(LensForm._fields, 0.0)
    numbers |= {"unit": 1.0, "valid_radius_squared": math.inf, "skew_last": False}
    return LensForm(**{**numbers, **changes})


def _stretched(coefficients: tuple[float, ...]) -> dict[str, Any]:
    return {f"n{power}": value for power, value in enumerate(coefficients, start=1)}


def magnifications(form: LensForm, rr: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """r, g and g_r of `lens_formula` at r² = `rr`, in the dtype of `rr`."""
    rr = np.maximum(rr, rr.dtype.type(LEAST_RADIUS_SQUARED))
    r = np.sqrt(rr)
    if form.slope:
        angle = np.arctan(form.slope * r)
        return r, angle / (form.unit * r), form.slope / (form.unit * (1 + form.slope**2 * rr))
    if form.alpha:
        rho = np.sqrt(np.maximum(1 + form.beta * rr, rr.dtype.type(LEAST_RHO_SQUARED)))
        g = 1 / (1 - form.alpha + form.alpha * rho)
        return r, g, g * g * (1 - form.alpha + form.alpha / rho)
    return r, np.ones_like(r), np.ones_like(r)


def distort(points: Points, lens: Lens) -> Points:
    """(..., 2) rays of a pinhole -> (..., 2) where the lens puts them, float32 or float64 as they are."""
    return _distorted(points, lens.form)


def distortion_jacobians(points: Points, lens: Lens) -> np.ndarray:
    """(..., 2) -> (..., 2, 2), the derivative of `distort`."""
    return _jacobians(points, lens.form)


def _distorted(points: Points, form: LensForm) -> Points:
    u, v = points[..., 0], points[..., 1]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        _, g, _ = magnifications(form, u * u + v * v)
        return np.stack(lens_point(form, u, v, g), axis=-1)


def _jacobians(points: Points, form: LensForm) -> np.ndarray:
    u, v = points[..., 0], points[..., 1]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        entries = lens_jacobian(form, u, v, *magnifications(form, u * u + v * v))
    return np.stack(entries, axis=-1).reshape(*points.shape, 2)


def undistort(points: Points, lens: Lens) -> Points:
    """The inverse of `distort` by Newton's method, float64; NaN where no ray within the reach goes there."""
    target = np.asarray(points, dtype=np.float64)
    form = lens.form
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        rays = target.copy()
        if form.slope:
            # As if there were no more than the fisheye: its edge is far out on the plane.
            angle = np.linalg.norm(target, axis=-1, keepdims=True)
            rays *= np.tan(np.minimum(angle * form.unit, 1.5)) / (form.slope * np.maximum(angle, 1e-12))
        elif form.alpha:
            # The inverse itself; NaN or behind the eye where no ray goes there.
            squared = (target * target).sum(axis=-1, keepdims=True)
            rest = form.alpha * np.sqrt(1 - (2 * form.alpha - 1) * form.beta * squared) + 1 - form.alpha
            rays *= rest / (1 - form.alpha**2 * form.beta * squared)
        for _ in range(NEWTON_STEPS):
            error = distort(rays, lens) - target
            J = _jacobians(rays, form)
            det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
            move = np.stack(
                [
                    (error[..., 0] * J[..., 1, 1] - error[..., 1] * J[..., 0, 1]) / det,
                    (error[..., 1] * J[..., 0, 0] - error[..., 0] * J[..., 1, 0]) / det,
                ],
                axis=-1,
            )
            # Steps are cut so that none overshoots to infinity.
            limit = 0.5 * (1 + np.linalg.norm(rays, axis=-1, keepdims=True))
            length = np.linalg.norm(move, axis=-1, keepdims=True)
            rays -= move * np.minimum(1, limit / np.maximum(length, 1e-300))
            if not (np.abs(error) > NEWTON_TOLERANCE).any():
                break
        wrong = ~(
            np.abs(distort(rays, lens) - target).max(axis=-1) <= 1e-9 * (1 + np.abs(target).max(axis=-1))
        )
        wrong |= ~(np.linalg.norm(rays, axis=-1) < lens.valid_radius)
    rays[wrong] = np.nan
    return rays


@lru_cache(maxsize=256)
def _valid_radius(form: LensForm) -> float:
    """See `Lens.valid_radius`: the least r at which the determinant of the derivative is no longer above
    0."""
    most = math.inf
    if form.slope or form.alpha * form.beta > 0:
        most = FISHEYE_RADIUS
    elif form.alpha * form.beta < 0:
        most = math.sqrt((LEAST_RHO_SQUARED - 1) / form.beta)
    if not _has_distortion(form):
        return most
    angle = np.linspace(0, 2 * np.pi, FOLD_DIRECTIONS, endpoint=False)
    directions = np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def in_order(radius: np.ndarray) -> np.ndarray:
        points = radius[..., None] * directions
        J = _jacobians(points, form)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
            rr = radius * radius
            _, g, _ = magnifications(form, rr)
            divisor = 1 + g * g * rr * (form.d1 + g * g * rr * (form.d2 + g * g * rr * form.d3))
        return (det > 0) & (divisor > 0)

    # By angle from the axis: even steps of u crowd where a fisheye has nothing.
    radius = np.tan(np.linspace(0, math.atan(FISHEYE_RADIUS), FOLD_STEPS + 1))
    good = in_order(np.broadcast_to(radius[:, None], (len(radius), FOLD_DIRECTIONS)))
    first_bad = np.where(good.all(axis=0), len(radius), good.argmin(axis=0))
    if (first_bad == len(radius)).all():
        return most
    high = radius[np.minimum(first_bad, FOLD_STEPS)]
    low = radius[np.clip(first_bad - 1, 0, FOLD_STEPS)]
    for _ in range(48):
        middle = (low + high) / 2
        fine = in_order(middle)
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    return float(min(low[first_bad < len(radius)].min(), most))


@lru_cache(maxsize=256)
def slopes_through(
    lens: Lens, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> tuple[float, float, float, float]:
    """Least u, least v, greatest u, greatest v that a picture of width x height px sees through the lens.

    The extremes are on the picture's border. Where a part of the border sees nothing, as the corners of a
    fisheye's picture often do, the reach of the lens takes their place.
    """
    x, y = np.linspace(0, width, BORDER_SAMPLES), np.linspace(0, height, BORDER_SAMPLES)
    border = np.concatenate(
        [
            np.stack([x, np.zeros_like(x)], axis=1),
            np.stack([x, np.full_like(x, height)], axis=1),
            np.stack([np.zeros_like(y), y], axis=1),
            np.stack([np.full_like(y, width), y], axis=1),
        ]
    )
    rays = undistort((border - (cx, cy)) / (fx, fy), lens)
    seen = np.isfinite(rays).all(axis=1)
    if not seen.all():
        reach = min(lens.valid_radius, FISHEYE_RADIUS)
        rays = np.concatenate([rays[seen], [[-reach, -reach], [reach, reach]]])
    (u_min, v_min), (u_max, v_max) = rays.min(axis=0), rays.max(axis=0)
    return float(u_min), float(v_min), float(u_max), float(v_max)
