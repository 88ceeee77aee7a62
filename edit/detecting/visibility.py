"""Splats that hardly show: faint ones, and those that no camera sees."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits, shown
from ..sample_views import sample_cameras
from ..selecting.adjusted import opacities
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .detector import Detector


@dataclass(frozen=True)
class FaintSplats(Detector):
    label: ClassVar[str] = "Faint splats"
    what: ClassVar[str] = "Splats of so little opacity that they cost time and show next to nothing."
    unit: ClassVar[str] = "1 / opacity"
    threshold: ClassVar[float] = 50.0
    slider: ClassVar[tuple[float, float]] = (2.0, 255.0)

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
        with np.errstate(divide="ignore"):
            scores = 1 / opacities(gaussians, edits)
        return np.where(shown(gaussians, edits), scores, np.float32(np.nan))

    def meaning(self, threshold: float) -> str:
        return f"opacity below {1 / threshold:.3g}"


@dataclass(frozen=True)
class UnseenSplats(Detector):
    """One over the contribution: the sum over all pixels of the views of alpha times the light that reaches
    the splat. What contributes nothing scores infinity, which is above every threshold."""

    label: ClassVar[str] = "Never seen"
    what: ClassVar[str] = "Splats that no view shows: hidden inside, behind, or beside all of them."
    unit: ClassVar[str] = "1 / px"
    threshold: ClassVar[float] = 100.0
    slider: ClassVar[tuple[float, float]] = (0.01, 1e4)
    renders: ClassVar[bool] = True

    def scores(
        self,
        gaussians: Gaussians,
        edits: SceneEdits,
        tools: Tools,
        cameras: Sequence[Camera] = (),
        *,
        watch: Watch = UNWATCHED,
    ) -> np.ndarray:
        cameras = list(cameras) or sample_cameras(gaussians, edits)
        total = contributions(gaussians, edits, tools, cameras, watch=watch)
        with np.errstate(divide="ignore", over="ignore"):
            scores = (1 / total).astype(np.float32)
        return np.where(shown(gaussians, edits), scores, np.float32(np.nan))

    def meaning(self, threshold: float) -> str:
        return f"makes less than {1 / threshold:.3g} pixels of all views together"


def contributions(
    gaussians: Gaussians,
    edits: SceneEdits,
    tools: Tools,
    cameras: Sequence[Camera],
    *,
    watch: Watch = UNWATCHED,
) -> np.ndarray:
    """(N,) float64: the sum of the contributions to all `cameras`, view by view. Raises Cancelled."""
    total = np.zeros(len(gaussians))
    for i, camera in enumerate(cameras):
        watch.step(i / len(cameras))
        total += tools.contributions(gaussians, [camera], edits)
    watch.step(1.0)
    return total
