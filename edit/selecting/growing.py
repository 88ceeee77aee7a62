"""Selections made larger and smaller, by distance or by neighbours.

Both growings go by a symmetric relation, and shrinking is growing what is not selected; hence
shrink(grow(s)) holds s, and s holds grow(shrink(s)).
"""

from __future__ import annotations

import numpy as np

from ...scene import Gaussians
from ...scene.edits import SceneEdits, shown
from ..loops.cells import within
from ..loops.places import positions_of
from ..loops.tree import nearest
from ..watch import UNWATCHED, Watch
from .checks import above_zero, whole


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
