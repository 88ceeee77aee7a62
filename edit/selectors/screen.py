"""Regions of a picture: rectangle, polygon, lasso and brush, through everything or the front surface only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from splatview.edit.kernels.compiling import in_pieces
from splatview.edit.kernels.marks import image_points, places_of
from splatview.edit.kernels.polygon import in_polygon, in_rectangle, in_stroke, make_polygon, make_stroke
from splatview.edit.selectors.base import above_zero, choice, finite, pixels, store
from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import SceneEdits
from splatview.scene.image_model import NEAR
from splatview.scene.progress import NO_PROGRESS, Progress

DEPTHS = ("through", "front")

Pixels = tuple[tuple[float, float], ...]
Bounds = tuple[float, float, float, float]
"""Least x and y, greatest x and y, px."""

Inside = Callable[[np.ndarray, np.ndarray], None]
"""Test of points (P, 2) float64 that sets (P,) bool."""


@dataclass(frozen=True, kw_only=True)
class ScreenRegion:
    """Splats in a region of the view of `camera`, in pixels from the picture's top left corner.

    "through" are those whose projected mean is in the region, however deep, behind the near plane; "front"
    are those that dominate a pixel whose centre is in it. A region may extend beyond the picture.
    """

    camera: Camera
    depth: Literal["through", "front"] = "through"

    def __post_init__(self) -> None:
        if not isinstance(self.camera, Camera):
            raise ValueError(f"camera must be a camera, got {self.camera!r}")
        choice("depth", self.depth, DEPTHS)

    def region(self) -> tuple[Bounds, Inside]:
        """Bounds of the region, and a test of points, which may be anywhere or NaN."""
        raise TypeError(f"{type(self).__name__} is no region")

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        bounds, inside = self.region()
        if self.depth == "front":
            return self._front(bounds, inside, gaussians, edits, tools)
        mask = np.empty(len(gaussians), bool)
        places = places_of(gaussians, edits)

        def work(start: int, stop: int) -> None:
            inside(image_points(start, stop, places, self.camera, NEAR), mask[start:stop])

        in_pieces(len(mask), work, progress=progress)
        return mask

    def _front(
        self, bounds: Bounds, inside: Inside, gaussians: Gaussians, edits: SceneEdits, tools: Tools
    ) -> np.ndarray:
        mask = np.zeros(len(gaussians), bool)
        width, height = self.camera.width, self.camera.height
        left, right = (int(np.clip(np.floor(x), 0, width - 1)) for x in bounds[::2])
        top, bottom = (int(np.clip(np.floor(y), 0, height - 1)) for y in bounds[1::2])
        x, y = np.meshgrid(np.arange(left, right + 1) + 0.5, np.arange(top, bottom + 1) + 0.5)
        hits = np.empty(x.size, bool)
        inside(np.stack([x.ravel(), y.ravel()], axis=1), hits)
        if hits.any():
            ids = tools.dominant_splats(gaussians, self.camera, edits)
            indices = ids[top : bottom + 1, left : right + 1].ravel()[hits]
            mask[indices[indices >= 0]] = True
        return mask


@dataclass(frozen=True, kw_only=True)
class Rectangle(ScreenRegion):
    """The area between two opposite corners, whichever they are, borders included."""

    x0: float
    y0: float
    x1: float
    y1: float

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("x0", "y0", "x1", "y1"):
            store(self, **{name: finite(name, getattr(self, name))})

    def region(self) -> tuple[Bounds, Inside]:
        (left, right), (top, bottom) = sorted((self.x0, self.x1)), sorted((self.y0, self.y1))
        bounds = (float(left), float(top), float(right), float(bottom))
        corners = np.array(bounds)
        return bounds, lambda points, inside: in_rectangle(points, corners, inside)


@dataclass(frozen=True, kw_only=True)
class Polygon(ScreenRegion):
    """The area between points joined by straight lines, the last to the first; all that a self-crossing
    outline goes around is inside."""

    points: Pixels
    """[x, y] each, at least 3."""

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, points=pixels("points", self.points, 3))

    def region(self) -> tuple[Bounds, Inside]:
        polygon = make_polygon(np.array(self.points))
        bounds = _bounds(polygon.points)
        corners = np.array(bounds)
        return bounds, lambda points, inside: in_polygon(points, corners, polygon, inside)


@dataclass(frozen=True, kw_only=True)
class Lasso(Polygon):
    """A polygon drawn by hand: its points are the mouse's path."""


@dataclass(frozen=True, kw_only=True)
class Brush(ScreenRegion):
    """The area under a round brush's stroke."""

    points: Pixels
    """[x, y] each, at least 1: the path of its centre."""
    radius: float
    """Above 0, px."""

    def __post_init__(self) -> None:
        super().__post_init__()
        store(self, points=pixels("points", self.points, 1), radius=above_zero("radius", self.radius))

    def region(self) -> tuple[Bounds, Inside]:
        stroke = make_stroke(np.array(self.points), self.radius)
        left, top, right, bottom = _bounds(stroke.points)
        r = self.radius
        bounds = (left - r, top - r, right + r, bottom + r)
        return bounds, lambda points, inside: in_stroke(points, stroke, inside)


def _bounds(points: np.ndarray) -> Bounds:
    (left, top), (right, bottom) = points.min(axis=0), points.max(axis=0)
    return (float(left), float(top), float(right), float(bottom))
