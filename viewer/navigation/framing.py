"""Views that are asked for by name: everything, one point, along an axis, level."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from splatview.scene.image_model import NEAR
from splatview.viewer.navigation.controllers import MIN_DISTANCE
from splatview.viewer.navigation.view import Lens, View, look_from, unit

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
