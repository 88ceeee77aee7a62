"""What all detectors have in common: a score a splat, a threshold, and what these mean."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits
from ..tools import Tools
from ..watch import UNWATCHED, Watch


class Detector:
    """Frozen dataclasses: their fields are a line of a recipe, what follows here is for the interface."""

    label: ClassVar[str]
    what: ClassVar[str]
    """One sentence for a tooltip."""
    unit: ClassVar[str]
    """Of scores and threshold."""
    threshold: ClassVar[float]
    """A sensible one to begin with."""
    slider: ClassVar[tuple[float, float]]
    """From everything that one might want gone to nothing."""
    log: ClassVar[bool] = True
    """Whether the slider's scale is logarithmic."""
    renders: ClassVar[bool] = False
    """Whether it takes pictures, of the cameras that it is given."""

    def scores(
        self,
        gaussians: Gaussians,
        edits: SceneEdits,
        tools: Tools,
        cameras: Sequence[Camera] = (),
        *,
        watch: Watch = UNWATCHED,
    ) -> np.ndarray:
        """(N,) float32: the greater the worse; NaN for splats that are not shown.

        `cameras`, if any, are the views that count; where none are given and some are wanted, sample
        views are made. Raises Cancelled.
        """
        raise TypeError(f"{type(self).__name__} has no scores")

    def mask(self, scores: np.ndarray, threshold: float) -> np.ndarray:
        """Which splats score above `threshold`: (N,) bool."""
        return scores > np.float32(threshold)

    def meaning(self, threshold: float) -> str:
        """What the threshold says, in words: "below 2 % opacity"."""
        return f"over {threshold:.3g} {self.unit}"
