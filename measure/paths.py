"""Pictures that depend on those before: by which path a view is reached when they are measured."""

from __future__ import annotations

import math

from ..scene import RenderSettings
from ..scene.resorting import keeps_order

PATH_TURN = 1.0
"""Degrees of a turn of the eye between two frames: at 60 frames a second, once round in six seconds."""


def path_to_view(settings: RenderSettings) -> tuple[float, ...]:
    """Degrees by which the frames of the path differ from the view, the view itself, 0, last.

    The first frame is sorted and none after it: so the view is drawn in the oldest order that the settings
    let happen on such a path. Only the view, where every frame has its own order.
    """
    if not keeps_order(settings):
        return (0.0,)
    frames = settings.resort_frames
    if settings.resort_degrees > 0:
        frames = max(math.ceil(settings.resort_degrees / PATH_TURN), 1)
    return tuple(-PATH_TURN * number for number in range(frames - 1, -1, -1))
