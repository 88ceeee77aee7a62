"""Finding the splats that one would rather be without, each kind by a score and a threshold."""

from __future__ import annotations

from ..sample_views import sample_cameras
from .detector import Detector
from .floaters import IsolatedClusters, SparseSplats
from .ill import Duplicates, Undrawable
from .shapes import Giants, Needles
from .visibility import FaintSplats, UnseenSplats, contributions

DETECTORS: dict[str, type[Detector]] = {
    "clusters": IsolatedClusters,
    "sparse": SparseSplats,
    "needles": Needles,
    "giants": Giants,
    "faint": FaintSplats,
    "unseen": UnseenSplats,
    "broken": Undrawable,
    "duplicates": Duplicates,
}
"""By the name that a recipe has."""

__all__ = [
    "DETECTORS",
    "Detector",
    "Duplicates",
    "FaintSplats",
    "Giants",
    "IsolatedClusters",
    "Needles",
    "SparseSplats",
    "Undrawable",
    "UnseenSplats",
    "contributions",
    "sample_cameras",
]
