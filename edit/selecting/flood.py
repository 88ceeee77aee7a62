"""The magic wand: what hangs together with a splat and has about its colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Camera, Gaussians, InputError
from ...scene.edits import SceneEdits, shown
from ..loops.cells import components
from ..loops.places import positions_of
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .adjusted import base_colours
from .checks import above_zero, at_least, store, whole
from .colour import TOLERANCE, similar
from .spacing import typical_spacing

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
    splat = int(tools.front(gaussians, camera, edits)[int(y), int(x)])
    return splat if splat >= 0 else None
