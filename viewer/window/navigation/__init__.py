"""Navigation as plain mathematics: every function takes a `View` and returns a new one. No GL, no ImGui."""

from .fly import look, move
from .framing import AXIS_NAMES, axis_view, focus, frame, level, with_up
from .moves import dolly, pan
from .orbit import orbit
from .picking import Pick, pick
from .trackball import trackball
from .transition import Transition
from .view import Lens, View, view_from_camera

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
