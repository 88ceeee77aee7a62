"""Regions of space: spheres and oriented boxes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Gaussians
from ...scene.adjustment import IDENTITY_ROTATION, Four, Vector
from ...scene.crop import Crop
from ...scene.edits import SceneEdits
from ..loops.pieces import in_pieces
from ..loops.places import in_volume, places_of
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .checks import above_zero, numbers, store, vector


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """Splats whose mean is in a ball, its surface included."""

    centre: Vector
    """World units."""
    radius: float
    """Above 0, world units."""

    def __post_init__(self) -> None:
        store(self, centre=vector("centre", self.centre), radius=above_zero("radius", self.radius))

    @property
    def shape(self) -> Crop:
        """The same as a crop, for drawing it and for cropping by it."""
        return Crop(shape="sphere", centre=self.centre, half_extents=(self.radius, self.radius, self.radius))

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        return _inside(self.shape, gaussians, edits, watch)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Splats whose mean is in a box that may be turned, its surface included."""

    centre: Vector
    """World units."""
    half_extents: Vector
    """Above 0, world units, along its own axes."""
    rotation: Four = IDENTITY_ROTATION
    """wxyz of length 1, from its own axes to the world's."""

    def __post_init__(self) -> None:
        store(
            self,
            centre=vector("centre", self.centre),
            half_extents=vector("half_extents", self.half_extents),
            rotation=numbers("rotation", self.rotation, 4),
        )
        _ = self.shape  # which checks the rest

    @property
    def shape(self) -> Crop:
        """The same as a crop, for drawing it and for cropping by it."""
        return Crop(shape="box", centre=self.centre, half_extents=self.half_extents, rotation=self.rotation)

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        return _inside(self.shape, gaussians, edits, watch)


def _inside(shape: Crop, gaussians: Gaussians, edits: SceneEdits, watch: Watch) -> np.ndarray:
    mask = np.empty(len(gaussians), bool)
    places, unit = places_of(gaussians, edits), np.ascontiguousarray(shape.unit_from_world)
    ellipsoid = shape.shape == "sphere"

    def work(start: int, stop: int) -> None:
        in_volume(start, stop, places, unit, ellipsoid, mask)

    in_pieces(len(mask), work, watch=watch)
    return mask
