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
    where it is not before the eye."""
    x, y, z = (camera.R_camera_world @ (np.asarray(point, np.float64) - camera.eye)).tolist()
    if not z >= NEAR:
        return None
    at = ImVec2(corner.x + camera.fx * x / z + camera.cx, corner.y + camera.fy * y / z + camera.cy)
    return at if math.isfinite(at.x + at.y) else None
