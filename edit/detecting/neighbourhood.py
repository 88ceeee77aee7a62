"""Who is next to whom among the splats that are shown: what floaters and giants are found by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Gaussians
from ...scene.edits import SceneEdits, shown
from ..loops.places import positions_of
from ..loops.tree import nearest
from ..selecting.adjusted import log_scales
from ..watch import UNWATCHED, Watch


@dataclass(frozen=True, eq=False, kw_only=True)
class Neighbourhood:
    """Of the M splats that are shown and somewhere."""

    count: int
    """N of the scene."""
    indices: np.ndarray
    """(M,) int64, ascending."""
    neighbours: np.ndarray
    """(M, k) int32, places in `indices`, nearest first; -1: there are no more."""
    distances: np.ndarray
    """(M, k) float64, world units."""
    extents: np.ndarray
    """(M,) float64, world units: the middle of a splat's three standard deviations, that is how wide it
    looks; a needle looks thin and a disc broad."""
    typical: float
    """Median distance to the furthest of the k neighbours, above 0."""

    def spread(self, scores: np.ndarray) -> np.ndarray:
        """Scores (M,) as those of the scene, (N,) float32, NaN for all others."""
        result = np.full(self.count, np.nan, np.float32)
        with np.errstate(over="ignore"):
            result[self.indices] = scores
        return result


def neighbourhood(gaussians: Gaussians, edits: SceneEdits, k: int, watch: Watch = UNWATCHED) -> Neighbourhood:
    """The `k` nearest neighbours of all that is shown. Raises Cancelled."""
    positions = positions_of(gaussians, edits)
    indices = np.flatnonzero(shown(gaussians, edits) & np.isfinite(positions).all(axis=1))
    neighbours, distances = nearest(positions[indices], k, watch)
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(np.sort(log_scales(gaussians, edits)[indices], axis=1)[:, 1].astype(np.float64))
    furthest = distances[:, -1]
    usable = furthest[(furthest > 0) & np.isfinite(furthest)]
    typical = float(np.median(usable)) if len(usable) else 1.0
    return Neighbourhood(
        count=len(gaussians),
        indices=indices,
        neighbours=neighbours,
        distances=distances,
        extents=np.nan_to_num(sizes, nan=0.0, posinf=np.finfo(np.float64).max),
        typical=typical,
    )
