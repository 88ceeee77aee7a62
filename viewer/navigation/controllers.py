"""Moves of a view: by the mouse (orbit, look, trackball, pan, dolly), by keys, and to views with a name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pyrr import matrix33

from splatview.scene.image_model import NEAR
from splatview.viewer.navigation.view import Lens, View, look_from, orthonormal, unit

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


FRAME_MARGIN = 1.1
"""How much wider than the scene's sphere the picture is."""

AXIS_NAMES = ("+X", "-X", "+Y", "-Y", "+Z", "-Z")


def axis(name: str) -> np.ndarray:
    """(3,) float64 of a name in `AXIS_NAMES`."""
    direction = np.zeros(3)
    direction["XYZ".index(name[1])] = 1.0 if name[0] == "+" else -1.0
    return direction


def plain_lens(view: View) -> Lens:
    """Its angle and its kind of rays, without what only a photo's has."""
    return Lens(fov_y=view.lens.fov_y, orthographic=view.lens.orthographic)


def frame(view: View, centre: np.ndarray, radius: float, *, aspect: float = 1.0) -> View:
    """The view in its direction that has the sphere (centre (3,), radius > 0, world) in full.

    `aspect` is the picture's width over its height. A photo's shifted lens is centred again.
    """
    half = math.radians(view.lens.fov_y) / 2
    half_x = math.atan(math.tan(half) * aspect)
    distance = FRAME_MARGIN * radius / math.sin(min(half, half_x))
    return replace(
        view,
        target=np.asarray(centre, dtype=np.float64),
        # A scene of millimetres must not end up before the near plane.
        distance=max(distance, radius + 2 * NEAR),
        lens=plain_lens(view),
    )


def focus(view: View, point: np.ndarray) -> View:
    """Puts `point` (3,) world into the centre, as far away as it is, without turning the eye. Where rays are
    parallel how far it is makes no difference, and the scale stays."""
    depth = float((point - view.eye) @ view.forward)
    if view.lens.orthographic:
        depth = view.distance
    return replace(
        view,
        target=np.asarray(point, dtype=np.float64),
        distance=max(depth, MIN_DISTANCE),
        lens=plain_lens(view),
    )


def axis_view(view: View, name: str) -> View:
    """Looks at the target from the side that `name` (one of `AXIS_NAMES`) says, at the same distance.

    From above and below the next axis is upwards in the picture, as in a plan.
    """
    outwards = axis(name)
    upwards = view.up
    if abs(float(outwards @ upwards)) > 0.99:
        upwards = np.roll(np.abs(np.round(upwards)), 1)
        if not np.any(upwards):  # an oblique up axis: no world axis is better than another
            upwards = view.R_camera_world[1]
    found = look_from(view.target + view.distance * outwards, view.target, upwards)
    return replace(view, R_camera_world=found.R_camera_world, lens=plain_lens(view))


def level(view: View) -> View:
    """The same eye and target with the horizon level."""
    return replace(look_from(view.eye, view.target, view.up, view.lens), distance=view.distance)


def with_up(view: View, up: np.ndarray) -> View:
    """The same eye and target, level about the new axis `up` (3,)."""
    return level(replace(view, up=unit(up)))
