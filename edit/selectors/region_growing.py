"""Selections made larger and smaller, by distance or by neighbours.

Both growings go by a symmetric relation, and shrinking is growing what is not selected; hence
shrink(grow(s)) holds s, and s holds grow(shrink(s)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from splatview.edit.kernels.grid import components, within
from splatview.edit.kernels.kdtree import nearest
from splatview.edit.kernels.marks import positions_of
from splatview.edit.progress import UNWATCHED, Tools, Watch
from splatview.edit.selectors.attributes import TOLERANCE, base_colours, similar
from splatview.edit.selectors.base import above_zero, at_least, store, whole
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import SceneEdits, shown


def grow(
    mask: np.ndarray,
    gaussians: Gaussians,
    edits: SceneEdits,
    *,
    distance: float | None = None,
    neighbours: int | None = None,
    watch: Watch = UNWATCHED,
) -> np.ndarray:
    """`mask` (N,) bool and what is near it: (N,) bool.

    Either `distance` in world units, above 0, or `neighbours`: then two splats are near where one is
    among so many nearest of the other. Splats that are not shown neither join nor pass anything on.

    Raises:
        ValueError: both are given or none, or the one given makes no sense.
        Cancelled: the watch says so.
    """
    _check(distance, neighbours)
    result = mask.copy()
    indices, positions = _shown_places(gaussians, edits)
    result[indices] |= _reached(positions, mask[indices], distance, neighbours, watch)
    return result


def shrink(
    mask: np.ndarray,
    gaussians: Gaussians,
    edits: SceneEdits,
    *,
    distance: float | None = None,
    neighbours: int | None = None,
    watch: Watch = UNWATCHED,
) -> np.ndarray:
    """`mask` (N,) bool without what is near a splat that is shown and not in it. See `grow`."""
    _check(distance, neighbours)
    result = mask.copy()
    indices, positions = _shown_places(gaussians, edits)
    result[indices] &= ~_reached(positions, ~mask[indices], distance, neighbours, watch)
    return result


def _check(distance: float | None, neighbours: int | None) -> None:
    if (distance is None) == (neighbours is None):
        raise ValueError("give either distance or neighbours")
    if distance is not None:
        above_zero("distance", distance)
    if neighbours is not None:
        whole("neighbours", neighbours, 1)


def _shown_places(gaussians: Gaussians, edits: SceneEdits) -> tuple[np.ndarray, np.ndarray]:
    """Indices of shown splats that are somewhere, and their positions."""
    positions = positions_of(gaussians, edits)
    indices = np.flatnonzero(shown(gaussians, edits) & np.isfinite(positions).all(axis=1))
    return indices, positions[indices]


def _reached(
    positions: np.ndarray, sources: np.ndarray, distance: float | None, neighbours: int | None, watch: Watch
) -> np.ndarray:
    if distance is not None:
        return within(positions, sources, distance, watch)
    indices, _ = nearest(positions, neighbours or 1, watch)
    there = indices >= 0
    reached = sources | (sources[indices] & there).any(axis=1)
    reached[indices[sources][there[sources]]] = True
    return reached


# ---- How far apart the splats of a scene usually are: what "near" means in it.


SAMPLE = 100_000
"""Splats looked at, those nearest to each other: a slab of the scene as thick as gives so many."""


def typical_spacing(gaussians: Gaussians, edits: SceneEdits, *, watch: Watch = UNWATCHED) -> float:
    """Median distance between shown splats and their nearest others, world units; above 0.

    Of a scene of more than SAMPLE splats, those in a slab through its middle are looked at. Raises
    Cancelled.
    """
    positions = positions_of(gaussians, edits)[shown(gaussians, edits)]
    positions = positions[np.isfinite(positions).all(axis=1)]
    if len(positions) > SAMPLE:
        spread = np.subtract(*np.percentile(positions[:: len(positions) // SAMPLE], [75, 25], axis=0))
        along = positions[:, int(np.argmax(spread))]
        middle = np.argpartition(np.abs(along - np.median(along)), SAMPLE)[:SAMPLE]
        positions = positions[middle]
    _, distances = nearest(positions, 1, watch)
    usable = distances[(distances > 0) & np.isfinite(distances)]
    return float(np.median(usable)) if len(usable) else 1.0


# ---- The magic wand: what hangs together with a splat and has about its colour.


REACH = 4.0
"""In typical spacings: bridges the gaps of a surface, not those between things."""


@dataclass(frozen=True, kw_only=True)
class Flood:
    """From splat `seed` on to whatever is near and like it in colour, and so on from there.

    Colours are compared with the seed's, not with the neighbour's, so a gradient does not carry the flood
    away. Of splats that are hidden, deleted or cropped away it takes no notice.
    """

    seed: int
    """Index of a splat: for a picked pixel, what `picked` finds there."""
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
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
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
            reach = REACH * typical_spacing(gaussians, edits, watch=watch.part(0.0, 0.3))
        indices = np.flatnonzero(candidates)
        labels = components(positions[indices], reach, watch.part(0.3, 1.0))
        mask[indices[labels == labels[np.searchsorted(indices, self.seed)]]] = True
        return mask


def picked(
    gaussians: Gaussians, edits: SceneEdits, tools: Tools, camera: Camera, x: float, y: float
) -> int | None:
    """The splat that makes the visible surface at pixel (x, y) of what `camera` sees; None: there is none."""
    if not (0 <= x < camera.width and 0 <= y < camera.height):
        return None
    splat = int(tools.dominant_splats(gaussians, camera, edits)[int(y), int(x)])
    return splat if splat >= 0 else None
