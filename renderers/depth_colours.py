"""The depths that the colours of the mode "depth" span, which follow the scene's extent and its edits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.scene import Camera, Gaussians
from splatview.scene.edits import PALETTE_SHIFT, SceneEdits, adjusted_points

SAMPLE = 100_000
"""Splats that are looked at, at least, where there are so many."""

DEPTH_SPAN = 1.6
"""Depth colours span so many scene radii (half the splats lie within one) on either side of the median."""


def sample_step(count: int) -> int:
    """Every so-manieth splat is enough to place `count` of them."""
    return max(1, count // SAMPLE)


@dataclass(frozen=True, eq=False)
class Middle:
    """Where most of a scene is."""

    median: np.ndarray
    """(3,) float64: median of the finite means, world units."""
    radius: float
    """World units: half the splats lie within it of `median`; 0 where all are in one place."""

    @classmethod
    def of(cls, means: np.ndarray) -> Middle | None:
        """Of splats at `means` (N, 3); None where none is finite."""
        with np.errstate(invalid="ignore", over="ignore"):
            sample = means[:: sample_step(len(means))].astype(np.float64)
            sample = sample[np.isfinite(sample).all(axis=1)]
            if not len(sample):
                return None
            median = np.median(sample, axis=0)
            return cls(median, float(np.median(np.linalg.norm(sample - median, axis=1))))


def depth_range(median: np.ndarray, radius: float, camera: Camera) -> tuple[float, float]:
    """Depths, world units, of the colour map's ends: from the scene's extent, so that they never jump."""
    middle = float(camera.forward @ (median - camera.eye))
    nearest = max(middle - DEPTH_SPAN * radius, 0.0)
    return nearest, max(middle + DEPTH_SPAN * radius, nearest + radius)


class DepthColours:
    """Where the scene drawn last is, found anew where the scene or the places of its splats have changed."""

    def __init__(self) -> None:
        self._known: tuple[tuple[object, ...], Gaussians, tuple[np.ndarray, float]] | None = None

    def range(self, gaussians: Gaussians, edits: SceneEdits | None, camera: Camera) -> tuple[float, float]:
        """`depth_range` of the scene with its edits; hidden splats count too."""
        key: tuple[object, ...] = ()
        moves = edits is not None and edits.adjusts and any(each.moves for each in edits.palette)
        if edits is not None and moves:
            key = (edits.palette, edits.marks_version)
        known = self._known
        if known is None or known[1] is not gaussians or known[0] != key:
            means = gaussians.means
            if edits is not None and moves:
                step = sample_step(len(means))
                # Marks may be newer than the palette.
                most = (len(edits.palette) << PALETTE_SHIFT) - 1
                means = adjusted_points(means[::step], np.minimum(edits.marks[::step], most), edits.palette)
            found = Middle.of(means)
            placed = (np.zeros(3), 1.0) if found is None else (found.median, found.radius or 1.0)
            known = self._known = key, gaussians, placed
        return depth_range(*known[2], camera)

    def latest_range(self, camera: Camera) -> tuple[float, float] | None:
        """The same of the scene drawn last, from `camera`; None before any."""
        known = self._known
        return None if known is None else depth_range(*known[2], camera)
