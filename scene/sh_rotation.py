"""Turning spherical harmonics with the splats that carry them."""

from __future__ import annotations

import numpy as np

from .gaussians import SH_COEFFICIENTS
from .sh import sh_basis

_DIRECTIONS = 64
"""More than enough to determine 16 coefficients, well spread: rounding stays at a few 1e-16."""


def sh_rotation(R: np.ndarray, degree: int) -> np.ndarray:
    """The matrix that turns coefficients by the rotation `R` (3, 3): ((degree + 1)²,) squared, float64.

    With c' = matrix @ c, SH(c', R·d) = SH(c, d) for every direction d. Found by asking just that at
    many directions, so it holds in whatever sign convention `sh_basis` has; bands do not mix.
    """
    i = np.arange(_DIRECTIONS) + 0.5
    z = 1 - 2 * i / _DIRECTIONS
    turn = np.pi * (1 + np.sqrt(5)) * i  # a Fibonacci sphere
    flat = np.sqrt(1 - z * z)
    directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    before = sh_basis(directions, degree)
    after = sh_basis(directions @ np.asarray(R, np.float64).T, degree)
    matrix = np.zeros((SH_COEFFICIENTS[degree], SH_COEFFICIENTS[degree]))
    matrix[0, 0] = 1.0
    for band in range(1, degree + 1):
        own = slice(SH_COEFFICIENTS[band - 1], SH_COEFFICIENTS[band])
        matrix[own, own] = np.linalg.lstsq(after[:, own], before[:, own], rcond=None)[0]
    return matrix
