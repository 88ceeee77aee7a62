"""Base of selectors, attributes and detectors, and checks of their fields."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import SceneEdits
from splatview.scene.health import Finding, check
from splatview.scene.progress import NO_PROGRESS, Progress


class Selector(Protocol):
    """A frozen dataclass whose fields, numbers, texts, lists of them and cameras, are those of a recipe's
    step.

    Its constructor raises ValueError that names a field with an unusable value.
    """

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        """Splats hit: (N,) bool, of all, whether shown, hidden or deleted.

        Raises:
            InputError: the selector does not fit the scene, or needs a renderer where there is none.
            Cancelled: nobody waits for it any more.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Query:
    """An edited scene to compute one number per splat of, and the parameters of the computation."""

    gaussians: Gaussians
    edits: SceneEdits
    tools: Tools
    cameras: Sequence[Camera] = ()
    """Views for contributions; none: sample views."""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Origin of distances, world units."""
    progress: Progress = NO_PROGRESS


def finding_mask(gaussians: Gaussians, matches: Callable[[Finding], bool]) -> np.ndarray:
    """Splats concerned by the findings of `scene.health` that `matches` accepts: (N,) bool."""
    mask = np.zeros(len(gaussians), bool)
    for finding in check(gaussians):
        if matches(finding):
            mask[finding.indices] = True
    return mask


def store(selector: object, **values: Any) -> None:
    """Sets fields of a frozen dataclass during its construction."""
    for name, value in values.items():
        object.__setattr__(selector, name, value)


LARGEST = 1e100
"""Largest number allowed: products and squares of it stay finite."""

MOST_POINTS = 1 << 20
"""Most points of a polygon or a stroke; a day of drawing makes fewer."""


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
    """A list or tuple of `length` finite numbers as a tuple of floats."""
    if not isinstance(value, (list, tuple)) or len(value) != length:
        raise ValueError(f"{name} must be {length} finite numbers, got {value!r}")
    return tuple(finite(f"{name}[{i}]", item) for i, item in enumerate(value))


def vector(name: str, value: Any) -> tuple[float, float, float]:
    """Three finite numbers."""
    x, y, z = numbers(name, value, 3)
    return (x, y, z)


def pixels(name: str, value: Any, least: int) -> tuple[tuple[float, float], ...]:
    """A list of at least `least` points [x, y], px, as a tuple."""
    if not isinstance(value, (list, tuple)) or not least <= len(value) <= MOST_POINTS:
        raise ValueError(f"{name} must be a list of at least {least} points [x, y]")
    points = []
    for i, item in enumerate(value):
        x, y = numbers(f"{name}[{i}]", item, 2)
        points.append((x, y))
    return tuple(points)
