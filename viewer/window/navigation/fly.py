"""Fly: the eye moves and looks around; the target is carried along ahead of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .orbit import orbit
from .view import View


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
