"""What all ways of selecting have in common."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from splatview.edit.tools import Tools
from splatview.scene import Gaussians
from splatview.scene.edits import SceneEdits
from splatview.scene.progress import NO_PROGRESS, Progress


class Selector(Protocol):
    """A frozen dataclass whose fields are numbers, texts, lists of them and cameras: a line of a recipe.

    Its constructor raises ValueError that names the field where one cannot be used.
    """

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        """Which splats are meant: (N,) bool, of all, whether shown, hidden or deleted.

        Raises:
            InputError: the selector does not fit the scene, or wants a renderer that there is not.
            Cancelled: nobody waits for it any more.
        """
        ...


# ---- What the fields of a selector or detector may hold. Raises ValueError that names the field.


def store(selector: object, **values: Any) -> None:
    """Sets fields of a frozen dataclass that is being made: numbers become floats, lists tuples."""
    for name, value in values.items():
        object.__setattr__(selector, name, value)


LARGEST = 1e100
"""Of any number: what is made of it by products and squares stays finite."""

MOST_POINTS = 1 << 20
"""Of a polygon or a stroke; a day of drawing makes fewer."""


def finite(name: str, value: Any) -> float:
    """A finite number as a float."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < math.inf:
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{name} must be within ±{LARGEST:g}, got {value!r}")
    return float(value)


def above_zero(name: str, value: Any) -> float:
    if not finite(name, value) > 0:
        raise ValueError(f"{name} must be above 0, got {value!r}")
    return float(value)


def at_least(name: str, value: Any, least: float) -> float:
    if not finite(name, value) >= least:
        raise ValueError(f"{name} must be at least {least:g}, got {value!r}")
    return float(value)


def whole(name: str, value: Any, least: int) -> int:
    """A whole number of at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int) or not value >= least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return value


def choice(name: str, value: Any, choices: Iterable[str]) -> str:
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(choices)}, got {value!r}")
    return value


def numbers(name: str, value: Any, length: int) -> tuple[float, ...]:
    """`length` finite numbers, of a list or a tuple."""
    if not isinstance(value, (list, tuple)) or len(value) != length:
        raise ValueError(f"{name} must be {length} finite numbers, got {value!r}")
    return tuple(finite(f"{name}[{i}]", item) for i, item in enumerate(value))


def vector(name: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers."""
    x, y, z = numbers(name, value, 3)
    return (x, y, z)


def pixels(name: str, value: Any, least: int) -> tuple[tuple[float, float], ...]:
    """At least so many points of a picture."""
    if not isinstance(value, (list, tuple)) or not least <= len(value) <= MOST_POINTS:
        raise ValueError(f"{name} must be a list of at least {least} points [x, y]")
    points = []
    for i, item in enumerate(value):
        x, y = numbers(f"{name}[{i}]", item, 2)
        points.append((x, y))
    return tuple(points)
