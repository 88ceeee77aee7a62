"""Crop boxes and spheres: objects of the scene that decide what is shown, without touching a splat."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .adjustment import IDENTITY_ROTATION, Four, Vector
from .projection import rotation_matrices

CROP_ROW = 16
"""Numbers in a row of `crop_rows`."""


@dataclass(frozen=True, kw_only=True)
class Crop:
    """A box or an ellipsoid, and whether it keeps what is inside or removes it.

    Raises:
        ValueError: a number makes no sense; the message names it.
    """

    name: str = "crop"
    shape: Literal["box", "sphere"] = "box"
    centre: Vector = (0.0, 0.0, 0.0)
    """World units."""
    half_extents: Vector = (1.0, 1.0, 1.0)
    """Above 0, world units, along its own axes; for a sphere its radii."""
    rotation: Four = IDENTITY_ROTATION
    """wxyz of length 1, from its own axes to the world's."""
    keep: Literal["inside", "outside"] = "inside"
    enabled: bool = True

    def __post_init__(self) -> None:
        if self.shape not in ("box", "sphere"):
            raise ValueError(f"shape must be box or sphere, got {self.shape!r}")
        if self.keep not in ("inside", "outside"):
            raise ValueError(f"keep must be inside or outside, got {self.keep!r}")
        for name, length in (("centre", 3), ("half_extents", 3), ("rotation", 4)):
            values = np.array(getattr(self, name), np.float64)
            if values.shape != (length,) or not np.isfinite(values).all():
                raise ValueError(f"{name} must be {length} finite numbers, got {getattr(self, name)}")
        if not min(self.half_extents) > 0:
            raise ValueError(f"half_extents must be above 0, got {self.half_extents}")
        # Not by its norm alone: squares of large numbers overflow.
        if not (max(map(abs, self.rotation)) <= 2 and abs(float(np.linalg.norm(self.rotation)) - 1) <= 1e-6):
            raise ValueError(f"rotation must be a quaternion of length 1, got {self.rotation}")

    @property
    def unit_from_world(self) -> np.ndarray:
        """(3, 4) float64: takes world points to axes in which the shape has half extents of 1."""
        R_world_own = rotation_matrices(np.array([self.rotation], np.float64))[0]
        linear = R_world_own.T / np.array(self.half_extents)[:, None]
        return np.hstack([linear, -(linear @ np.array(self.centre, np.float64))[:, None]])

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of `points` (N, 3) are inside, the surface included: (N,) bool. NaN is not."""
        unit = self.unit_from_world
        with np.errstate(invalid="ignore", over="ignore"):
            own = points.astype(np.float64) @ unit[:, :3].T + unit[:, 3]
            if self.shape == "box":
                return np.abs(own).max(axis=1, initial=0.0) <= 1
            return np.einsum("ni,ni->n", own, own) <= 1


def cropped_in(crops: tuple[Crop, ...], points: np.ndarray) -> np.ndarray:
    """Which of `points` (N, 3) the crops in force leave: (N,) bool.

    What is in any crop that keeps its inside stays (all, if there is none), but for what is in one
    that keeps its outside.
    """
    kept = np.ones(len(points), bool)
    insides = [crop for crop in crops if crop.enabled and crop.keep == "inside"]
    if insides:
        kept = np.logical_or.reduce([crop.contains(points) for crop in insides])
    for crop in crops:
        if crop.enabled and crop.keep == "outside":
            kept &= ~crop.contains(points)
    return kept


def crop_rows(crops: tuple[Crop, ...], centre: np.ndarray | None = None) -> np.ndarray:
    """The crops in force as renderers read them: (C, CROP_ROW) float64.

    Columns 0 to 11: `unit_from_world`, 3x4 by rows, of points relative to `centre` (3,); 12: 1 for a
    sphere, 0 for a box; 13: 1 where the inside is kept, 0 where the outside is; the rest is 0.
    """
    origin = np.zeros(3) if centre is None else np.asarray(centre, np.float64)
    enabled = [crop for crop in crops if crop.enabled]
    rows = np.zeros((len(enabled), CROP_ROW))
    for row, crop in zip(rows, enabled, strict=True):
        unit = crop.unit_from_world
        row[:12] = np.hstack([unit[:, :3], (unit[:, 3] + unit[:, :3] @ origin)[:, None]]).ravel()
        row[12] = crop.shape == "sphere"
        row[13] = crop.keep == "inside"
    return rows
