"""The eyedropper: splats of about one colour.

Colours are compared in Oklab, where equal distances look about equally different whatever the hue and
however dark; in plain RGB one tolerance takes all dark greens at once and splits one bright wall.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene import Gaussians
from ...scene.edits import SceneEdits
from ..loops.colours import LINEAR, oklab
from ..loops.measures import within_colour
from ..loops.pieces import in_pieces
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .adjusted import base_colours
from .checks import at_least, store, vector

TOLERANCE = 0.08
"""A shade of a colour, to the eye; black to white is 1."""


@dataclass(frozen=True, kw_only=True)
class SimilarColour:
    """Splats whose colour of the constant band, cut to what a display shows, is like `rgb`."""

    rgb: tuple[float, float, float]
    """Display colour, usually 0 to 1."""
    tolerance: float = TOLERANCE
    """At least 0: distance in Oklab, black to white being 1."""

    def __post_init__(self) -> None:
        store(self, rgb=vector("rgb", self.rgb), tolerance=at_least("tolerance", self.tolerance, 0))

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        return similar(base_colours(gaussians, edits), self.rgb, self.tolerance, watch)


def similar(
    colours: np.ndarray, rgb: tuple[float, float, float], tolerance: float, watch: Watch = UNWATCHED
) -> np.ndarray:
    """Which of `colours` (N, 3) float32 are within `tolerance` of `rgb`: (N,) bool; NaN is not."""
    seed = np.empty((1, 3), np.float32)
    oklab(0, 1, np.array([rgb], np.float32), LINEAR, seed)
    mask = np.empty(len(colours), bool)
    lab = np.empty((len(colours), 3), np.float32)

    def work(start: int, stop: int) -> None:
        oklab(start, stop, colours, LINEAR, lab)
        within_colour(start, stop, lab, seed[0], np.float32(tolerance), mask)

    in_pieces(len(colours), work, watch=watch)
    return mask
