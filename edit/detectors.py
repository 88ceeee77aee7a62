"""What all detectors have in common: a score a splat, a threshold, and what these mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from splatview.edit.kernels.grid import linked
from splatview.edit.kernels.kdtree import nearest
from splatview.edit.kernels.marks import positions_of
from splatview.edit.sample_views import sample_cameras
from splatview.edit.selectors.attributes import attribute_values, log_scales, opacities
from splatview.edit.selectors.base import above_zero, choice, whole
from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import SceneEdits, shown
from splatview.scene.framing import robust_bounds
from splatview.scene.health import Finding, check
from splatview.scene.progress import NO_PROGRESS, Progress


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
        progress: Progress = NO_PROGRESS,
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


# ---- Who is next to whom among the splats that are shown: what floaters and giants are found by.


@dataclass(frozen=True, eq=False, kw_only=True)
class Neighbourhood:
    """Of the M splats that are shown and somewhere."""

    count: int
    """N of the scene."""
    indices: np.ndarray
    """(M,) int64, ascending."""
    neighbours: np.ndarray
    """(M, k) int32, places in `indices`, nearest first; -1: there are no more."""
    distances: np.ndarray
    """(M, k) float64, world units."""
    extents: np.ndarray
    """(M,) float64, world units: the middle of a splat's three standard deviations, that is how wide it
    looks; a needle looks thin and a disc broad."""
    typical: float
    """Median distance to the furthest of the k neighbours, above 0."""

    def spread(self, scores: np.ndarray) -> np.ndarray:
        """Scores (M,) as those of the scene, (N,) float32, NaN for all others."""
        result = np.full(self.count, np.nan, np.float32)
        with np.errstate(over="ignore"):
            result[self.indices] = scores
        return result


def neighbourhood(
    gaussians: Gaussians, edits: SceneEdits, k: int, progress: Progress = NO_PROGRESS
) -> Neighbourhood:
    """The `k` nearest neighbours of all that is shown. Raises Cancelled."""
    positions = positions_of(gaussians, edits)
    indices = np.flatnonzero(shown(gaussians, edits) & np.isfinite(positions).all(axis=1))
    neighbours, distances = nearest(positions[indices], k, progress)
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(np.sort(log_scales(gaussians, edits)[indices], axis=1)[:, 1].astype(np.float64))
    furthest = distances[:, -1]
    usable = furthest[(furthest > 0) & np.isfinite(furthest)]
    typical = float(np.median(usable)) if len(usable) else 1.0
    return Neighbourhood(
        count=len(gaussians),
        indices=indices,
        neighbours=neighbours,
        distances=distances,
        extents=np.nan_to_num(sizes, nan=0.0, posinf=np.finfo(np.float64).max),
        typical=typical,
    )


# ---- Floaters: what hangs in the air, found as small clusters apart and as splats far from any other.


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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        near = neighbourhood(gaussians, edits, NEIGHBOURS, progress)
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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        near = neighbourhood(gaussians, edits, self.neighbours, progress)
        with np.errstate(over="ignore", invalid="ignore"):
            usual = np.maximum(near.typical, WIDTHS * near.extents)
            return near.spread(near.distances[:, -1] / usual)

    def meaning(self, threshold: float) -> str:
        return f"the {self.neighbours}th neighbour is over {threshold:.3g} times as far as usual"


# ---- Splats of a bad shape: needles and giants.


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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        progress.step(0.0)
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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        progress.step(0.0)
        largest = log_scales(gaussians, edits).max(axis=1)
        if self.against == "scene":
            _, radius = robust_bounds(positions_of(gaussians, edits)[shown(gaussians, edits)])
            with np.errstate(over="ignore"):
                return _hide(np.exp(largest) / (SCENE_SHARE * radius), gaussians, edits)
        near = neighbourhood(gaussians, edits, LEAST_NEIGHBOURS, progress)
        own = largest[near.indices].astype(np.float64)
        others = np.where(near.neighbours >= 0, own[near.neighbours], np.nan)
        with np.errstate(over="ignore", invalid="ignore"):
            return near.spread(np.exp(own - np.median(others, axis=1)))

    def meaning(self, threshold: float) -> str:
        if self.against == "scene":
            return f"over {threshold * SCENE_SHARE:.3g} times the scene's radius"
        return f"over {threshold:.3g} times as large as their neighbours"


# ---- Splats that hardly show: faint ones, and those that no camera sees.


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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        progress.step(0.0)
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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        cameras = list(cameras) or sample_cameras(gaussians, edits)
        total = contributions(gaussians, edits, tools, cameras, progress=progress)
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
    progress: Progress = NO_PROGRESS,
) -> np.ndarray:
    """(N,) float64: the sum of the contributions to all `cameras`, view by view. Raises Cancelled."""
    total = np.zeros(len(gaussians))
    for i, camera in enumerate(cameras):
        progress.step(i / len(cameras))
        total += tools.contributions(gaussians, [camera], edits)
    progress.step(1.0)
    return total


# ---- What `scene.health` finds in the file: splats that cannot be drawn, and copies of others.


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
        progress: Progress = NO_PROGRESS,
    ) -> np.ndarray:
        progress.step(0.0)
        scores = np.zeros(len(gaussians), np.float32)
        for finding in check(gaussians):
            if self.wanted(finding):
                scores[finding.indices] = 1
        scores[~shown(gaussians, edits)] = np.nan
        progress.step(1.0)
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


# ---- Finding the splats that one would rather be without, each kind by a score and a threshold.


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
