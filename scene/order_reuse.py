"""When an order by depth is made anew, where it may be older than the picture: `RenderSettings.resort_*`.

A camera at rest has the order of its own view, always: the frame after one that did not move is sorted.
"""

from __future__ import annotations

import math
from collections.abc import Hashable

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.image_model import RenderSettings


class ResortPolicy:
    """Follows the frames of one renderer."""

    def __init__(self) -> None:
        self.stale = False
        """Whether the latest frame has the order of an earlier view."""
        self._key: Hashable = None
        self._sorted: Camera | None = None
        self._latest: Camera | None = None
        self._since = 0

    def forget(self) -> None:
        """The next frame is sorted."""
        self._sorted = None

    def due(
        self,
        camera: Camera,
        settings: RenderSettings,
        *,
        key: Hashable,
        centre: np.ndarray,
        radius: float,
    ) -> bool:
        """Whether the frame that comes is to be sorted; it is taken to be drawn so.

        `key`: what besides the camera an order depends on. `centre` (3,), `radius`: of the scene.
        """
        rests = self._latest is not None and self._latest.same_view(camera)
        self._since += 1
        due = (
            self._sorted is None
            or key != self._key
            or rests
            or self._is_old(camera, self._sorted, settings, centre, radius)
        )
        self._latest = camera
        if due:
            self._key, self._sorted, self._since = key, camera, 0
        self.stale = not due
        return due

    def _is_old(
        self, camera: Camera, before: Camera, settings: RenderSettings, centre: np.ndarray, radius: float
    ) -> bool:
        if settings.resort_degrees > 0:
            # A hair less, so that a path in steps of whole degrees is not at the mercy of rounding.
            return view_change(before, camera, centre, radius) >= settings.resort_degrees - 1e-6
        return self._since >= settings.resort_frames


def keeps_order(settings: RenderSettings) -> bool:
    """Whether an order may be older than its picture."""
    return settings.resort_frames > 1 or settings.resort_degrees > 0


def view_change(before: Camera, now: Camera, centre: np.ndarray, radius: float) -> float:
    """Degrees by which a camera has changed: those of its turn, or those by which its eye's way appears from
    the scene, whichever are more. NaN counts as all around."""
    R = now.R_camera_world @ before.R_camera_world.T
    turn = math.degrees(math.acos(min(max((float(np.trace(R)) - 1) / 2, -1.0), 1.0)))
    way = float(np.linalg.norm(now.eye - before.eye))
    distance = max(float(np.linalg.norm(before.eye - centre)), radius)
    seen = math.degrees(math.atan2(way, distance)) if way > 0 else 0.0
    degrees = max(turn, seen)
    return degrees if degrees >= 0 else 360.0
