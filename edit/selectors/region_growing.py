"""Selections grown and shrunk by distance or by neighbours, and the flood from one splat.

Nearness is symmetric, and shrinking is growing the complement; hence shrink(grow(s)) contains s, and s
contains grow(shrink(s)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.edit.kernels.grid import components, within
from splatview.edit.kernels.kdtree import nearest
from splatview.edit.kernels.marks import positions_of, shown_positions
from splatview.edit.selectors.attributes import TOLERANCE, base_colours, similar
from splatview.edit.selectors.base import above_zero, at_least, store, whole
from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import SceneEdits, shown
from splatview.scene.progress import NO_PROGRESS, Progress


def grow(
    mask: np.ndarray,
    gaussians: Gaussians,
    edits: SceneEdits,
    *,
    distance: float | None = None,
    neighbours: int | None = None,
    progress: Progress = NO_PROGRESS,
) -> np.ndarray:
    """`mask` (N,) bool and the splats near it: (N,) bool.

    Either `distance` in world units, above 0, or `neighbours`: then two splats are near where one is
    among so many nearest of the other. Splats that are not shown neither join nor pass anything on.

    Raises:
        ValueError: both are given or none, or the one given makes no sense.
        Cancelled: nobody waits for it any more.
    """
    if (distance is None) == (neighbours is None):
        raise ValueError("give either distance or neighbours")
    indices, positions = shown_positions(gaussians, edits)
    sources, result = mask[indices], mask.copy()
    if distance is not None:
        grown = within(positions, sources, above_zero("distance", distance), progress)
    else:
        near, _ = nearest(positions, whole("neighbours", neighbours, 1), progress)
        exists = near >= 0
        grown = sources | (sources[near] & exists).any(axis=1)
        grown[near[sources][exists[sources]]] = True
    result[indices] = grown
    return result


def shrink(
    mask: np.ndarray,
    gaussians: Gaussians,
    edits: SceneEdits,
    *,
    distance: float | None = None,
    neighbours: int | None = None,
    progress: Progress = NO_PROGRESS,
) -> np.ndarray:
    """`mask` (N,) bool without splats near one that is shown and not in it. See `grow`."""
    grown = grow(~mask, gaussians, edits, distance=distance, neighbours=neighbours, progress=progress)
    return mask & ~grown


SAMPLE = 100_000
"""Splats that the typical spacing is measured on: those of a slab through the middle of the scene."""


def typical_spacing(gaussians: Gaussians, edits: SceneEdits, *, progress: Progress = NO_PROGRESS) -> float:
    """Median distance from shown splats to their nearest others, world units; above 0. Raises Cancelled."""
    _, positions = shown_positions(gaussians, edits)
    if len(positions) > SAMPLE:
        spread = np.subtract(*np.percentile(positions[:: len(positions) // SAMPLE], [75, 25], axis=0))
        along = positions[:, int(np.argmax(spread))]
        middle = np.argpartition(np.abs(along - np.median(along)), SAMPLE)[:SAMPLE]
        positions = positions[middle]
    _, distances = nearest(positions, 1, progress)
    usable = distances[(distances > 0) & np.isfinite(distances)]
    return float(np.median(usable)) if len(usable) else 1.0


REACH = 4.0
"""Longest step of a flood in typical spacings: bridges the gaps of a surface, not those between objects."""


@dataclass(frozen=True, kw_only=True)
class Flood:
    """From splat `seed` on to whatever is near and like it in colour, and so on from there.

    Colours are compared with the seed's, not with the neighbour's, so a gradient does not carry the flood
    away. Hidden, deleted and cropped splats are ignored.
    """

    seed: int
    """Index of a splat: for a pixel, the one that `picked` finds there."""
    tolerance: float = TOLERANCE
    """At least 0: distance in Oklab, black to white being 1; 1 and more: any colour."""
    reach: float | None = None
    """Above 0, world units: the longest step. None: REACH times the scene's typical spacing."""
    limit: float | None = None
    """Above 0, world units: it never gets further from the seed. None: no limit."""

    def __post_init__(self) -> None:
        whole("seed", self.seed, 0)
        store(self, tolerance=at_least("tolerance", self.tolerance, 0))
        for name in ("reach", "limit"):
            if getattr(self, name) is not None:
                store(self, **{name: above_zero(name, getattr(self, name))})

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        count = len(gaussians)
        if not self.seed < count:
            raise InputError(f"seed is splat {self.seed}, but the scene has {count}")
        candidates = shown(gaussians, edits)
        if self.tolerance < 1:
            colours = base_colours(gaussians, edits)
            red, green, blue = (float(value) for value in colours[self.seed])
            candidates &= similar(colours, (red, green, blue), self.tolerance)
        positions = positions_of(gaussians, edits)
        candidates &= np.isfinite(positions).all(axis=1)
        if self.limit is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                away = positions - positions[self.seed]
                candidates &= np.einsum("ni,ni->n", away, away) <= self.limit * self.limit
        mask = np.zeros(count, bool)
        if not candidates[self.seed]:
            return mask
        reach = self.reach
        if reach is None:
            reach = REACH * typical_spacing(gaussians, edits, progress=progress.part(0.0, 0.3))
        indices = np.flatnonzero(candidates)
        labels = components(positions[indices], reach, progress.part(0.3, 1.0))
        mask[indices[labels == labels[np.searchsorted(indices, self.seed)]]] = True
        return mask


def picked(
    gaussians: Gaussians, edits: SceneEdits, tools: Tools, camera: Camera, x: float, y: float
) -> int | None:
    """The splat that dominates pixel (x, y) of the view of `camera`; None: there is none."""
    if not (0 <= x < camera.width and 0 <= y < camera.height):
        return None
    splat = int(tools.dominant_splats(gaussians, camera, edits)[int(y), int(x)])
    return splat if splat >= 0 else None
