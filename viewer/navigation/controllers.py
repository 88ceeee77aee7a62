"""Turntable: the eye circles the target, the horizon stays level."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pyrr import matrix33

from splatview.viewer.navigation.view import View, orthonormal

POLE_MARGIN = math.radians(0.5)
"""How near the eye may come to straight above: at the pole itself left and right have no meaning."""


def orbit(view: View, azimuth: float, elevation: float) -> View:
    """The view after the eye has gone `azimuth` radians around the up axis and `elevation` upwards.

    Distance and target stay. A positive azimuth moves the eye to its left, so the scene turns to the
    right, as if dragged; the elevation stops short of the poles.
    """
    R = view.R_camera_world @ matrix33.create_from_axis_rotation(view.up, -azimuth)
    forward = R[2]
    cosine = float(np.clip(forward @ view.up, -1, 1))
    angle = math.acos(cosine)
    side = np.cross(forward, view.up)
    # At a pole (an axis view from above) the picture's own right takes the place of the horizon.
    side = side if np.linalg.norm(side) > 1e-9 else R[0]
    lowest, highest = min(angle, POLE_MARGIN), max(angle, math.pi - POLE_MARGIN)
    raised = min(max(angle + elevation, lowest), highest)
    # The eye goes up as the viewing direction goes down, away from the up axis.
    R = R @ matrix33.create_from_axis_rotation(side, angle - raised)
    return replace(view, R_camera_world=orthonormal(R))


# ---- Fly: the eye moves and looks around; the target is carried along ahead of it.


def look(view: View, yaw: float, pitch: float) -> View:
    """Turns the head where the eye is: `yaw` radians to the right, `pitch` upwards. The horizon stays level.

    It is `orbit` seen from the other end: there the target rests, here the eye does.
    """
    turned = orbit(view, yaw, -pitch)
    return replace(turned, target=view.eye + view.distance * turned.forward)


def move(view: View, step: Sequence[float]) -> View:
    """Moves eye and target by `step` = (right, up, forward) in the camera's axes, world units."""
    right, up, forward = step
    return replace(view, target=view.target + np.array([right, -up, forward]) @ view.R_camera_world)


# ---- Trackball: the scene turns under the mouse like a ball, with no up axis.


def trackball(view: View, start: tuple[float, float], end: tuple[float, float]) -> View:
    """Drags the ball about the target from `start` to `end`, mouse positions as `on_ball` takes them.

    The quaternion is end·conj(start) (Shoemake 1992), twice the angle between the points: a drag depends
    only on where it starts and ends, and dragging back undoes it.
    """
    a, b = on_ball(start), on_ball(end)
    turn = matrix33.create_from_quaternion(np.append(np.cross(a, b), a @ b))
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


# ---- Moves that all navigation modes share: pan and dolly.


MIN_DISTANCE = 1e-6
"""World units; nearer than this the picture no longer changes but float32 renderers suffer."""


def pan(view: View, dx: float, dy: float, *, height: int) -> View:
    """Slides the scene with the mouse: the target's plane moves by exactly (dx, dy) px of `height` px."""
    camera = view.camera(height, height)
    away = 1.0 if camera.orthographic else view.distance
    step = np.array([-dx / camera.fx, -dy / camera.fy, 0.0]) * away
    return replace(view, target=view.target + step @ view.R_camera_world)


def dolly(view: View, factor: float) -> View:
    """Brings the eye to `factor` (> 0) times its distance from the target; the target stays. Parallel rays
    are as far apart as suits the distance, so this scales their picture."""
    return replace(view, distance=max(view.distance * factor, MIN_DISTANCE))
