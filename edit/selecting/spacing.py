"""How far apart the splats of a scene usually are: what "near" means in it."""

from __future__ import annotations

import numpy as np

from ...scene import Gaussians
from ...scene.edits import SceneEdits, shown
from ..loops.places import positions_of
from ..loops.tree import nearest
from ..watch import UNWATCHED, Watch

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
