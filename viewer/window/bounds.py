"""Where the splats are that the user sees, as edits have left them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ...scene.edits import SELECTED, SceneEdits, bake, shown
from ...scene.framing import SAMPLE, bulk

if TYPE_CHECKING:
    from .core import Core


def bounds(core: Core, *, selected: bool = False) -> tuple[np.ndarray, float] | None:
    """Centre (3,) float64 and radius > 0, world, of the bulk of all splats that are shown, or of the selected
    ones. None where there are none."""
    scene, edits = core.scene, core.edits
    if scene is None or (selected and edits is None):
        return None
    if edits is None:
        return scene.centre, scene.radius
    gaussians = scene.gaussians
    kept = shown(gaussians, edits)
    if selected:
        kept &= (edits.marks & SELECTED) != 0
    indices = np.flatnonzero(kept)
    if not len(indices):
        return None
    indices = indices[:: -(-len(indices) // SAMPLE)]
    sample = replace(gaussians, sh=gaussians.sh[:, :1], extras={}).take(indices)
    return bulk(bake(sample, SceneEdits(marks=edits.marks[indices], palette=edits.palette)))
