"""Turntable: the eye circles the target, the horizon stays level."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .rotations import about, orthonormal, unit
from .view import View

POLE_MARGIN = math.radians(0.5)
"""How near the eye may come to straight above: at the pole itself left and right have no meaning."""


def orbit(view: View, azimuth: float, elevation: float) -> View:
    """The view after the eye has gone `azimuth` radians around the up axis and `elevation` upwards.

    Distance and target stay. A positive azimuth moves the eye to its left, so the scene turns to the
    right, as if dragged; the elevation stops short of the poles.
    """
    R = view.R_camera_world @ about(view.up, azimuth)
    forward = R[2]
    cosine = float(np.clip(forward @ view.up, -1, 1))
    angle = math.acos(cosine)
    side = np.cross(forward, view.up)
    # At a pole (an axis view from above) the picture's own right takes the place of the horizon.
    side = unit(side) if np.linalg.norm(side) > 1e-9 else R[0]
    lowest, highest = min(angle, POLE_MARGIN), max(angle, math.pi - POLE_MARGIN)
    raised = min(max(angle + elevation, lowest), highest)
    # The eye goes up as the viewing direction goes down, away from the up axis.
    R = R @ about(side, angle - raised).T
    return replace(view, R_camera_world=orthonormal(R))
