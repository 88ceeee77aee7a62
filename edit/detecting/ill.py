"""What `scene.health` finds in the file: splats that cannot be drawn, and copies of others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits, shown
from ...scene.health import Finding, check
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .detector import Detector


@dataclass(frozen=True)
class HealthDetector(Detector):
    """Scores are 1 where a finding concerns the splat and 0 elsewhere; of the file, whatever was edited."""

    unit: ClassVar[str] = "yes or no"
    threshold: ClassVar[float] = 0.5
    slider: ClassVar[tuple[float, float]] = (0.5, 1.0)
    log: ClassVar[bool] = False

    def wanted(self, finding: Finding) -> bool:
        raise TypeError(f"{type(self).__name__} wants nothing")

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
        scores = np.zeros(len(gaussians), np.float32)
        for finding in check(gaussians):
            if self.wanted(finding):
                scores[finding.indices] = 1
        scores[~shown(gaussians, edits)] = np.nan
        watch.step(1.0)
        return scores

    def meaning(self, threshold: float) -> str:
        return self.label.lower()


@dataclass(frozen=True)
class Undrawable(HealthDetector):
    label: ClassVar[str] = "Broken splats"
    what: ClassVar[str] = "NaN, infinite or zero where no picture can come of it, or opacity below 1/255."

    def wanted(self, finding: Finding) -> bool:
        return finding.culled


@dataclass(frozen=True)
class Duplicates(HealthDetector):
    label: ClassVar[str] = "Duplicates"
    what: ClassVar[str] = "Splats that equal an earlier one in every value; only the copies are meant."

    def wanted(self, finding: Finding) -> bool:
        return finding.name == "duplicates"
