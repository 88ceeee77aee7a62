"""Moves that all navigation modes share: pan and dolly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .view import View

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
