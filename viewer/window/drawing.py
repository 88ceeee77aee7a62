"""Points of the scene in the window's own coordinates."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from imgui_bundle import ImVec2

from ...scene import Camera
from ...scene.image_model import NEAR


def point_on_picture(camera: Camera, corner: ImVec2, point: Sequence[float]) -> ImVec2 | None:
    """Where `camera`, of the picture's size, sees `point`, the picture's top left being at `corner`; None
    where it is not before the eye, or beyond what the lens shows."""
    t = camera.R_camera_world @ (np.asarray(point, np.float64) - camera.eye)
    if not t[2] >= NEAR:
        return None
    x, y = camera.image_points(t).tolist()
    at = ImVec2(corner.x + x, corner.y + y)
    return at if math.isfinite(at.x + at.y) else None
