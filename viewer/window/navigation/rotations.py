"""Rotation matrices by axis and angle, and the way between two of them. All (3, 3) float64."""

from __future__ import annotations

import math

import numpy as np


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation by `angle` radians about the unit `axis` (3,), right-handed (Rodrigues' formula)."""
    x, y, z = axis
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)


def orthonormal(R: np.ndarray) -> np.ndarray:
    """The rotation nearest to `R`: a thousand small turns must not shear the view."""
    u, _, vt = np.linalg.svd(R)
    return u @ vt


def axis_angle(R: np.ndarray) -> tuple[np.ndarray, float]:
    """The unit axis (3,) and the angle in [0, π] of `R`; any axis where the angle is 0."""
    # The axis is the eigenvector of the symmetric part's largest eigenvalue, which holds at 180° too,
    # where the antisymmetric part that textbooks use vanishes.
    axis = np.linalg.eigh((R + R.T) / 2)[1][:, -1]
    sine_axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2
    sine = float(axis @ sine_axis)
    if sine < 0:
        axis, sine = -axis, -sine
    return axis, math.atan2(sine, (float(np.trace(R)) - 1) / 2)


def between(start: np.ndarray, end: np.ndarray, share: float) -> np.ndarray:
    """The rotation at `share` (0 to 1) of the shortest turn from `start` to `end`."""
    axis, angle = axis_angle(end @ start.T)
    return orthonormal(about(axis, angle * share) @ start)


def unit(vector: np.ndarray) -> np.ndarray:
    """`vector` (3,) at length 1.

    Raises:
        ValueError: its length is zero or not finite.
    """
    length = np.linalg.norm(vector)
    if not (0 < length < math.inf):
        raise ValueError(f"no direction in {vector}")
    return np.asarray(vector, dtype=np.float64) / length
