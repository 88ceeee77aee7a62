"""Trackball: the scene turns under the mouse like a ball, with no up axis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .rotations import orthonormal
from .view import View


def trackball(view: View, start: tuple[float, float], end: tuple[float, float]) -> View:
    """Drags the ball about the target from `start` to `end`, mouse positions as `on_ball` takes them.

    The quaternion is end·conj(start) (Shoemake 1992), twice the angle between the points: a drag depends
    only on where it starts and ends, and dragging back undoes it.
    """
    a, b = on_ball(start), on_ball(end)
    w, (x, y, z) = float(a @ b), np.cross(a, b)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return replace(view, R_camera_world=orthonormal(turn @ view.R_camera_world))


def on_ball(point: tuple[float, float]) -> np.ndarray:
    """The unit vector (3,) in camera axes of the ball's front under `point`.

    `point` is (right, down) from the picture's centre, 1 at the shorter edge; beyond the ball its rim.
    """
    x, y = point
    across = x * x + y * y
    if across >= 1:
        return np.array([x, y, 0.0]) / np.sqrt(across)
    return np.array([x, y, -np.sqrt(1 - across)])
