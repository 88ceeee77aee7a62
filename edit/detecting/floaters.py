"""Floaters: what hangs in the air, found as small clusters apart and as splats far from any other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits
from ..loops.links import linked
from ..selecting.adjusted import opacities
from ..selecting.checks import above_zero, whole
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .detector import Detector
from .neighbourhood import neighbourhood

NEIGHBOURS = 8
"""Enough that a surface hangs together and few enough that a floater's fellows are not all of them."""

WIDTHS = 3.0
"""Standard deviations up to which a splat reaches: where the background is coarse, far apart is near."""


@dataclass(frozen=True)
class IsolatedClusters(Detector):
    """A cluster's mass is the sum of its opacities. Two neighbours belong together where they are no
    further apart than `reach` typical distances, or than each of them is wide."""

    label: ClassVar[str] = "Isolated clusters"
    what: ClassVar[str] = "Small groups of splats with nothing around them."
    unit: ClassVar[str] = "times lighter than the main cluster"
    threshold: ClassVar[float] = 3000.0
    slider: ClassVar[tuple[float, float]] = (10.0, 1e6)

    reach: float = 3.0
    """Above 0: in units of the median distance to the eighth neighbour."""

    def __post_init__(self) -> None:
        above_zero("reach", self.reach)

    def scores(
        self,
        gaussians: Gaussians,
        edits: SceneEdits,
        tools: Tools,
        cameras: Sequence[Camera] = (),
        *,
        watch: Watch = UNWATCHED,
    ) -> np.ndarray:
        near = neighbourhood(gaussians, edits, NEIGHBOURS, watch)
        reaches = np.maximum(self.reach * near.typical, WIDTHS * near.extents)
        labels = linked(near.neighbours, near.distances, reaches)
        mass = np.nan_to_num(opacities(gaussians, edits)[near.indices].astype(np.float64))
        masses = np.bincount(labels, weights=mass, minlength=len(labels))
        with np.errstate(divide="ignore", invalid="ignore"):
            return near.spread(masses.max(initial=0.0) / masses[labels])

    def meaning(self, threshold: float) -> str:
        return f"clusters with less than 1/{threshold:,.0f} of the main one's mass"


@dataclass(frozen=True)
class SparseSplats(Detector):
    """The distance to the k-th neighbour, over that of the median splat, or over the splat's own width where
    that is more: a coarse sky is no floater."""

    label: ClassVar[str] = "Low density"
    what: ClassVar[str] = "Splats with few others around them."
    unit: ClassVar[str] = "times the usual distance"
    threshold: ClassVar[float] = 4.0
    slider: ClassVar[tuple[float, float]] = (1.0, 1000.0)

    neighbours: int = NEIGHBOURS
    """At least 1: k."""

    def __post_init__(self) -> None:
        whole("neighbours", self.neighbours, 1)

    def scores(
        self,
        gaussians: Gaussians,
        edits: SceneEdits,
        tools: Tools,
        cameras: Sequence[Camera] = (),
        *,
        watch: Watch = UNWATCHED,
    ) -> np.ndarray:
        near = neighbourhood(gaussians, edits, self.neighbours, watch)
        with np.errstate(over="ignore", invalid="ignore"):
            usual = np.maximum(near.typical, WIDTHS * near.extents)
            return near.spread(near.distances[:, -1] / usual)

    def meaning(self, threshold: float) -> str:
        return f"the {self.neighbours}th neighbour is over {threshold:.3g} times as far as usual"
