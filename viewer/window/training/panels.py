"""The panels that a window with a training has besides the usual ones."""

from __future__ import annotations

from collections.abc import Callable

from ..core import Core
from . import compare, controls, curves, photo_list

STRIP = "Strip"
"""The dock under the picture."""

PANELS: tuple[tuple[str, str, Callable[[Core], None]], ...] = (
    ("Training", "Upper", controls.show),
    ("Photos", "Lower", photo_list.show),
    ("Curves", STRIP, curves.show),
    ("Compare", STRIP, compare.show),
)
"""Name, dock and contents of each."""

FIRST = ("Training", "Photos", "Curves")
"""What is in front of each dock when the window opens for the first time."""
