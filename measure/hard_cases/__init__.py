"""Hard cases: scenes that break renderers, and what must happen to each.

Each module is a theme. Where a case was seen in another project, its sentence names the place.
"""

from __future__ import annotations

from splatview.measure.hard_cases import (
    colours,
    depth_order,
    far_away,
    invalid_values,
    near_plane,
    opacities,
    pictures,
    rays,
    shapes,
    surfels,
)
from splatview.measure.hard_cases.case import HardCase
from splatview.scene import InputError

CASES: tuple[HardCase, ...] = (
    *shapes.CASES,
    *surfels.CASES,
    *near_plane.CASES,
    *opacities.CASES,
    *colours.CASES,
    *invalid_values.CASES,
    *depth_order.CASES,
    *far_away.CASES,
    *pictures.CASES,
    *rays.CASES,
)


def find_case(name: str) -> HardCase:
    """The case called `name`. Raises InputError where there is none, naming those that sound alike."""
    for case in CASES:
        if case.name == name:
            return case
    words = name.lower().split()
    alike = [case.name for case in CASES if any(word in case.name.lower() for word in words)]
    hint = f"do you mean {', '.join(map(repr, alike[:6]))}?" if alike else "see splatview stability --list"
    raise InputError(f"there is no case {name!r}; {hint}")
