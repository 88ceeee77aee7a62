"""State of the screen tools: names, strokes under way, and measured distances. No ImGui in here."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from splatview.edit.operations import Select
from splatview.edit.selectors import Brush, Lasso, Polygon, Rectangle
from splatview.scene import Camera

ToolName = Literal["none", "rectangle", "lasso", "polygon", "brush", "flood", "colour", "measure", "ground"]
"""Use of the left mouse button on the picture; "none" is navigation."""

Depth = Literal["through", "front"]
"""Whether screen tools take what is behind the surface too."""

Mode = Literal["set", "add", "remove", "intersect"]
"""Combination of a new selection with the one before."""

Point = tuple[float, float]
"""px from the picture's top left corner."""

Place = tuple[float, float, float]
"""World units."""


LEAST_STEP = 2.0
"""px between points of a path: finer says nothing more."""

CLICK = 3.0
"""px: a drag that stays within is a click."""

DRAGGED: tuple[ToolName, ...] = ("rectangle", "lasso", "brush")
CLICKED: tuple[ToolName, ...] = ("flood", "colour", "measure", "ground")


def mode_of(*, shift: bool, ctrl: bool) -> Mode:
    """Mode of a selection by the held keys: Shift adds, Ctrl removes, both keep the common part."""
    if shift and ctrl:
        return "intersect"
    return "add" if shift else "remove" if ctrl else "set"


@dataclass(kw_only=True)
class Stroke:
    """One selection in the making."""

    tool: Literal["rectangle", "lasso", "brush", "polygon"]
    mode: Mode
    radius: float
    """px, of a brush."""
    points: list[Point] = field(default_factory=list)
    """px from the picture's corner."""

    def to(self, x: float, y: float) -> None:
        """The mouse came to (x, y) with its button held."""
        if not self.points:
            self.points.append((x, y))
        elif self.tool == "rectangle":
            self.points[1:] = [(x, y)]
        elif self._far_from(self.points[-1], x, y, LEAST_STEP):
            self.points.append((x, y))

    def corner(self, x: float, y: float) -> bool:
        """A click while drawing a polygon; returns whether it closes it: a click on the first corner."""
        if len(self.points) >= 3 and not self._far_from(self.points[0], x, y, 3 * CLICK):
            return True
        self.points.append((x, y))
        return False

    @staticmethod
    def _far_from(point: Point, x: float, y: float, distance: float) -> bool:
        return (point[0] - x) ** 2 + (point[1] - y) ** 2 >= distance * distance

    @property
    def is_click(self) -> bool:
        """Whether the mouse hardly moved: with a rectangle or lasso that selects nothing."""
        return all(not self._far_from(self.points[0], x, y, CLICK) for x, y in self.points)

    def operation(self, camera: Camera, depth: Depth) -> Select | None:
        """The selection of what `camera`, of the picture's size, sees there; None where there is nothing."""
        if not self.points:
            return None
        points = tuple(self.points)
        if self.tool == "brush":
            by = Brush(camera=camera, depth=depth, points=points, radius=self.radius)
        elif self.is_click or len(points) < 2:
            return None
        elif self.tool == "rectangle":
            (x0, y0), (x1, y1) = points[0], points[-1]
            by = Rectangle(camera=camera, depth=depth, x0=x0, y0=y0, x1=x1, y1=y1)
        elif len(points) < 3:
            return None
        elif self.tool == "lasso":
            by = Lasso(camera=camera, depth=depth, points=points)
        else:
            by = Polygon(camera=camera, depth=depth, points=points)
        return Select(by=by, mode=self.mode)


@dataclass(frozen=True, kw_only=True)
class Measured:
    """A distance between two picked points."""

    start: Place
    end: Place

    @property
    def length(self) -> float:
        """World units."""
        return math.dist(self.start, self.end)
