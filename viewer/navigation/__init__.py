"""Navigation as plain mathematics: every function takes a `View` and returns a new one. No GL, no ImGui."""

from splatview.viewer.navigation.controllers import (
    AXIS_NAMES,
    axis_view,
    dolly,
    focus,
    frame,
    level,
    look,
    move,
    orbit,
    pan,
    trackball,
    with_up,
)
from splatview.viewer.navigation.picking import Pick, pick
from splatview.viewer.navigation.view import Lens, Transition, View, view_from_camera

__all__ = [
    "AXIS_NAMES",
    "Lens",
    "Pick",
    "Transition",
    "View",
    "axis_view",
    "dolly",
    "focus",
    "frame",
    "level",
    "look",
    "move",
    "orbit",
    "pan",
    "pick",
    "trackball",
    "view_from_camera",
    "with_up",
]
