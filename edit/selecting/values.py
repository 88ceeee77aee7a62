"""A range of an attribute, as one drags it on a histogram."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Camera, Gaussians
from ...scene.edits import SceneEdits
from ..loops.measures import within_range
from ..loops.pieces import in_pieces
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .attributes import ATTRIBUTES, attribute_values
from .checks import choice, finite, store, vector


@dataclass(frozen=True, kw_only=True)
class AttributeRange:
    """Splats with low <= value <= high; those whose value is NaN are in no range."""

    attribute: str
    """A name in ATTRIBUTES."""
    low: float | None = None
    """None: no lower end."""
    high: float | None = None
    """None: no upper end."""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """World units: where "distance" is measured from."""
    cameras: tuple[Camera, ...] = ()
    """The views that "contribution" is measured in; none: sample views."""

    def __post_init__(self) -> None:
        choice("attribute", self.attribute, ATTRIBUTES)
        low = None if self.low is None else finite("low", self.low)
        high = None if self.high is None else finite("high", self.high)
        if low is not None and high is not None and not low <= high:
            raise ValueError(f"low must not be above high, got {self.low} and {self.high}")
        store(self, low=low, high=high, point=vector("point", self.point))
        if not all(isinstance(camera, Camera) for camera in self.cameras):
            raise ValueError("cameras must be a list of cameras")
        store(self, cameras=tuple(self.cameras))

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        watch.step(0.0)
        values = attribute_values(
            self.attribute, gaussians, edits, tools, cameras=self.cameras, point=self.point
        )
        mask = self.of(values)
        watch.step(1.0)
        return mask

    def of(self, values: np.ndarray) -> np.ndarray:
        """As `mask`, where the `values` (N,) float32 are known already: while a range is being dragged."""
        low = -np.inf if self.low is None else self.low
        high = np.inf if self.high is None else self.high
        mask = np.empty(len(values), bool)
        in_pieces(len(values), lambda start, stop: within_range(start, stop, values, low, high, mask))
        return mask
