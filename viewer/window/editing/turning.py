"""Rotations as people type them and as the scene keeps them. No ImGui in here."""

from __future__ import annotations

import math

import numpy as np

from ....scene.adjustment import Four, quat_product

Euler = tuple[float, float, float]
"""Degrees about the axes x, y, z, turned in this order about axes that stay."""


def quat_of(angles: Euler) -> Four:
    """wxyz of length 1."""
    quat = np.array([1.0, 0.0, 0.0, 0.0])
    for axis, degrees in enumerate(angles):
        turn = np.zeros(4)
        turn[0], turn[1 + axis] = math.cos(math.radians(degrees) / 2), math.sin(math.radians(degrees) / 2)
        quat = quat_product(turn, quat)
    w, x, y, z = quat.tolist()
    return (w, x, y, z)


def quat_from_matrix(R: np.ndarray) -> Four:
    """wxyz of length 1 of a rotation (3, 3), by the largest component so that no digits are lost."""
    w2 = 1 + R[0, 0] + R[1, 1] + R[2, 2]
    x2 = 1 + R[0, 0] - R[1, 1] - R[2, 2]
    y2 = 1 - R[0, 0] + R[1, 1] - R[2, 2]
    z2 = 1 - R[0, 0] - R[1, 1] + R[2, 2]
    products = np.array(
        [
            [w2, R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]],
            [R[2, 1] - R[1, 2], x2, R[1, 0] + R[0, 1], R[0, 2] + R[2, 0]],
            [R[0, 2] - R[2, 0], R[1, 0] + R[0, 1], y2, R[2, 1] + R[1, 2]],
            [R[1, 0] - R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2], z2],
        ]
    )
    row = products[int(np.argmax([w2, x2, y2, z2]))]
    w, x, y, z = (row / np.linalg.norm(row)).tolist()
    return (w, x, y, z)


def angles_of(quat: Four) -> Euler:
    """The angles that `quat_of` makes `quat` (wxyz, length 1) of; y within ±90°."""
    w, x, y, z = quat
    pitch = max(-1.0, min(1.0, 2 * (w * y - z * x)))
    if abs(pitch) > 1 - 1e-12:
        # Straight up or down: only the sum or difference of the other two counts.
        return (math.degrees(2 * math.atan2(x, w)), math.copysign(90.0, pitch), 0.0)
    return (
        math.degrees(math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))),
        math.degrees(math.asin(pitch)),
        math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))),
    )
