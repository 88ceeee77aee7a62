"""State of the tools and panels of editing: names, strokes, distances, values of forms. No ImGui in here."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from splatview.edit.impact import Impact
from splatview.edit.operations import Select
from splatview.edit.operations.appearance import Grade, How
from splatview.edit.operations.base import Scope
from splatview.edit.selectors import Brush, Lasso, Polygon, Rectangle
from splatview.edit.selectors.attributes import Histogram
from splatview.scene import Camera
from splatview.scene.edits import Crop
from splatview.viewer.editing.job import Job
from splatview.viewer.navigation import View

# fmt: off
ToolName = Literal[
    "none",
    "rectangle", "brush", "lasso", "polygon", "flood", "colour",
    "move", "rotate", "scale", "crop_box", "crop_sphere",
    "measure", "ground",
]
# fmt: on
"""Use of the left mouse button on the picture; "none" is navigation."""

Depth = Literal["through", "front"]
"""Whether screen tools take what is behind the surface too."""

Mode = Literal["set", "add", "remove", "intersect"]
"""Combination of a new selection with the one before."""

Subject = Literal[Scope, "file"]
"""What a transform is of: the scope of an operation, or the active file."""

Point = tuple[float, float]
"""px from the picture's top left corner."""

Place = tuple[float, float, float]
"""World units."""

LEAST_STEP = 2.0
"""px between points of a path: finer says nothing more."""

CLICK = 3.0
"""px: a drag that stays within is a click."""

SELECTING: tuple[ToolName, ...] = ("rectangle", "brush", "lasso", "polygon", "flood", "colour")
"""Tools that select splats."""

TRANSFORMING: tuple[ToolName, ...] = ("move", "rotate", "scale")
"""Tools with handles that transform splats."""

CROPPING: tuple[ToolName, ...] = ("crop_box", "crop_sphere")
"""Tools with handles on a crop."""

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


Euler = tuple[float, float, float]
"""Degrees about the axes x, y, z, turned in this order about axes that stay."""


@dataclass(kw_only=True)
class MoveForm:
    """Values of the Transform section; the neutral ones change nothing."""

    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World units."""
    rotation: Euler = (0.0, 0.0, 0.0)
    scale: float = 1.0
    dragged: bool = False
    """Whether the handles on the picture are being dragged."""
    scale_before: float = 1.0
    """The scale as that drag began."""


@dataclass(kw_only=True)
class LookForm:
    """Values of the Colour & opacity section."""

    opacity: float = 1.0
    """Factor on the opacities, or the opacity that all get."""
    size: float = 1.0
    """Factor on the sizes, or the size that all get, world units."""
    grade: Grade = field(default_factory=Grade)


@dataclass(kw_only=True)
class RangeForm:
    """Values of the selection by a range of an attribute."""

    attribute: str = "opacity"
    values: np.ndarray | None = None
    """(N,) float32: the attribute of every splat."""
    of: object = None
    """Attribute and versions of the document that `values` are of."""
    histogram: Histogram | None = None
    low: float = 0.0
    high: float = 1.0


@dataclass(kw_only=True)
class CleanForm:
    """Values of the Clean up section."""

    detector: str = "clusters"
    scores: np.ndarray | None = None
    """(N,) float32: score of every splat."""
    of: object = None
    """Detector and versions of the document that `scores` are of."""
    threshold: float = 0.0
    mask: np.ndarray | None = None
    """(N,) bool: splats above the threshold that may be deleted."""
    count: int = 0
    price: Impact | None = None
    """Impact of deleting `mask`; None: not measured."""
    counts: dict[str, tuple[object, int]] = field(default_factory=dict)
    """Number of splats that each detector finds at its usual threshold, after the versions that it is of."""
    masks: dict[str, tuple[object, np.ndarray]] = field(default_factory=dict)
    """(N,) bool each: those splats, likewise."""
    prices: dict[str, tuple[object, Impact]] = field(default_factory=dict)
    """Impact of deleting those, likewise."""
    measuring: Job | None = None
    """Work that counts and measures these."""
    measured: object = None
    """Versions of the document for which that has ended, whatever it came to."""
    calm_since: float = 0.0
    """Time at which something moved last, as `AppState.now`."""
    calm_view: View | None = None
    """View since then."""
    keep: int = 0
    """Number of splats that decimation leaves; 0: not filled in yet."""
    kept_price: tuple[object, Impact] | None = None
    """Impact of decimation, after the number of splats and the versions that it is of."""


class Face(NamedTuple):
    """A side of a box, or a pole of a sphere."""

    axis: int
    sign: int


@dataclass(frozen=True, kw_only=True)
class FaceDrag:
    """A face under the mouse's left button."""

    face: Face
    crop: Crop
    """As it was when the drag began."""
    start: float
    """World units along the face's axis, from the crop's centre, of the mouse when it began."""


@dataclass(kw_only=True)
class HealthForm:
    """Values of the health report."""

    prices: dict[str, Impact] = field(default_factory=dict)
    """Impact of the repair of each finding, by its name."""
    of: object = None
    """Versions of the document that `prices` are of."""


@dataclass(kw_only=True)
class Forms:
    """Values that are filled in on the editing panels until they are applied."""

    scope: Subject = "selection"
    move: MoveForm = field(default_factory=MoveForm)
    look: LookForm = field(default_factory=LookForm)
    how: How = "scale"
    """Whether opacities and sizes are multiplied or set."""
    range: RangeForm = field(default_factory=RangeForm)
    clean: CleanForm = field(default_factory=CleanForm)
    health: HealthForm = field(default_factory=HealthForm)
    file: int = -1
    """Index of the file whose row is active; -1: none."""
    file_angles: Euler = (0.0, 0.0, 0.0)
    """Its rotation as it was typed, of the angles that mean the same."""
    crop: int = -1
    """Index of the crop with the handles; -1: none."""
    crop_handles: int = 0
    """Kind of the handles: an index of `editing.gizmos.KINDS`."""
    crop_dragged: bool = False
    """Whether the handles are being dragged."""
    face_under: Face | None = None
    """Face of the chosen crop whose dot is under the mouse."""
    face_drag: FaceDrag | None = None
    """... and the one that the mouse drags."""
    section: str = "Select"
    """Title of the section of the Edit page that is open; "" for none."""
    open_section: str = ""
    """Title of the section that the Edit page is to open, once."""
    drawn: set[str] = field(default_factory=set)
    """Titles of the sections that have been drawn in this frame."""
    sections: frozenset[str] = frozenset()
    """Titles of the sections that are open: those drawn in the last frame."""
    previewing: str = ""
    """The section whose preview is in force; "" for none."""
