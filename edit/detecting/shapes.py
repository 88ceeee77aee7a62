"""Splats of a bad shape: needles and giants."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits, shown
from ...scene.framing import robust_bounds
from ..loops.places import positions_of
from ..selecting.adjusted import log_scales
from ..selecting.attributes import attribute_values
from ..selecting.checks import choice
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .detector import Detector
from .neighbourhood import neighbourhood

LEAST_NEIGHBOURS = 8
"""Whose median is not yet swayed by one other giant beside it."""

SCENE_SHARE = 0.01
"""Against the scene a splat scores 1 at this share of its radius, so that one slider serves both ways."""


def _hide(scores: np.ndarray, gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    return np.where(shown(gaussians, edits), scores, np.float32(np.nan)).astype(np.float32)


@dataclass(frozen=True)
class Needles(Detector):
    """Longest over middle axis: round discs, which surfaces are made of, are no needles."""

    label: ClassVar[str] = "Needles"
    what: ClassVar[str] = "Long thin splats, which show as spikes from beside."
    unit: ClassVar[str] = "times longer than wide"
    threshold: ClassVar[float] = 30.0
    slider: ClassVar[tuple[float, float]] = (2.0, 1e4)

    discs: bool = False
    """Longest over shortest axis instead, so that discs count too."""

    def __post_init__(self) -> None:
        if not isinstance(self.discs, bool):
            raise ValueError(f"discs must be true or false, got {self.discs!r}")

    def scores(
        self,
        gaussians: Gaussians,
        edits: SceneEdits,
        tools: Tools,
        cameras: Sequence[Camera] = (),
        *,
        watch: Watch = UNWATCHED,
    ) -> np.ndarray:
        watch.step(0.0)
        # Growing or shrinking a splat leaves the ratio as it is.
        name = "anisotropy" if self.discs else "elongation"
        ratios = attribute_values(name, gaussians, edits, tools)
        return _hide(ratios, gaussians, edits)

    def meaning(self, threshold: float) -> str:
        return f"over {threshold:.3g} times as long as {'thin' if self.discs else 'wide'}"


@dataclass(frozen=True)
class Giants(Detector):
    """The largest standard deviation over the median of that of the neighbours, or the scene's radius."""

    label: ClassVar[str] = "Giants"
    what: ClassVar[str] = "Splats far larger than those around them, which veil the scene."
    unit: ClassVar[str] = "times as large"
    threshold: ClassVar[float] = 20.0
    slider: ClassVar[tuple[float, float]] = (2.0, 1000.0)

    against: Literal["neighbours", "scene"] = "neighbours"
    """What sizes are compared with; of the "scene" a hundredth of its radius."""

    def __post_init__(self) -> None:
        choice("against", self.against, ("neighbours", "scene"))

    def scores(
        self,
        gaussians: Gaussians,
        edits: SceneEdits,
        tools: Tools,
        cameras: Sequence[Camera] = (),
        *,
        watch: Watch = UNWATCHED,
    ) -> np.ndarray:
        watch.step(0.0)
        largest = log_scales(gaussians, edits).max(axis=1)
        if self.against == "scene":
            _, radius = robust_bounds(positions_of(gaussians, edits)[shown(gaussians, edits)])
            with np.errstate(over="ignore"):
                return _hide(np.exp(largest) / (SCENE_SHARE * radius), gaussians, edits)
        near = neighbourhood(gaussians, edits, LEAST_NEIGHBOURS, watch)
        own = largest[near.indices].astype(np.float64)
        others = np.where(near.neighbours >= 0, own[near.neighbours], np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            return near.spread(np.exp(own - np.median(others, axis=1)))

    def meaning(self, threshold: float) -> str:
        if self.against == "scene":
            return f"over {threshold * SCENE_SHARE:.3g} times the scene's radius"
        return f"over {threshold:.3g} times as large as their neighbours"
