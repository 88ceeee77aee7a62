"""Detectors of splats that one would rather be without: a score per splat, and a threshold above which it
goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from splatview.edit.kernels.grid import linked
from splatview.edit.kernels.kdtree import nearest
from splatview.edit.kernels.marks import positions_of, shown_positions
from splatview.edit.sample_views import sample_cameras
from splatview.edit.selectors.attributes import attribute_values, log_scales, opacities
from splatview.edit.selectors.base import Query, above_zero, choice, finding_mask, whole
from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import SceneEdits, shown
from splatview.scene.framing import robust_bounds
from splatview.scene.health import Finding
from splatview.scene.progress import NO_PROGRESS, Progress


class Detector:
    """Base of all detectors: frozen dataclasses whose fields are those of a recipe's step; the class
    variables are for the interface."""

    label: ClassVar[str]
    what: ClassVar[str]
    """One sentence for a tooltip."""
    unit: ClassVar[str]
    """Unit of scores and threshold."""
    threshold: ClassVar[float]
    """A sensible threshold to begin with."""
    slider: ClassVar[tuple[float, float]]
    """Range of sensible thresholds, from nearly all splats deleted to none."""
    log: ClassVar[bool] = True
    """Whether the slider's scale is logarithmic."""
    renders: ClassVar[bool] = False
    """Whether it renders the views of the given cameras."""

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

        `cameras` are the views that count; none: sample views, for detectors that render. Raises Cancelled.
        """
        progress.step(0.0)
        query = Query(gaussians=gaussians, edits=edits, tools=tools, cameras=cameras, progress=progress)
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
            scores = self._scores(query).astype(np.float32)
        scores[~shown(gaussians, edits)] = np.nan
        progress.step(1.0)
        return scores

    def _scores(self, query: Query) -> np.ndarray:
        """(N,) of any float type, and any values for splats that are not shown."""
        raise TypeError(f"{type(self).__name__} has no scores")

    def mask(self, scores: np.ndarray, threshold: float) -> np.ndarray:
        """Splats that score above `threshold`: (N,) bool."""
        return scores > np.float32(threshold)

    def meaning(self, threshold: float) -> str:
        """The threshold in words: "below 2 % opacity"."""
        return f"over {threshold:.3g} {self.unit}"


@dataclass(frozen=True, eq=False, kw_only=True)
class Neighbourhood:
    """Nearest neighbours of the M shown splats with finite positions."""

    count: int
    """N, splats of the scene."""
    indices: np.ndarray
    """(M,) int64, ascending."""
    neighbours: np.ndarray
    """(M, k) int32, places in `indices`, nearest first; -1: none left."""
    distances: np.ndarray
    """(M, k) float64, world units."""
    extents: np.ndarray
    """(M,) float64, world units: the middle of a splat's three standard deviations, its apparent width; that
    of a needle is small and that of a disc large."""
    typical: float
    """Median distance to the furthest of the k neighbours, above 0, world units."""

    @classmethod
    def of(cls, query: Query, k: int) -> Neighbourhood:
        indices, positions = shown_positions(query.gaussians, query.edits)
        neighbours, distances = nearest(positions, k, query.progress)
        scales = log_scales(query.gaussians, query.edits)[indices]
        sizes = np.exp(np.sort(scales, axis=1)[:, 1].astype(np.float64))
        furthest = distances[:, -1]
        usable = furthest[(furthest > 0) & np.isfinite(furthest)]
        return cls(
            count=len(query.gaussians),
            indices=indices,
            neighbours=neighbours,
            distances=distances,
            extents=np.nan_to_num(sizes, nan=0.0, posinf=np.finfo(np.float64).max),
            typical=float(np.median(usable)) if len(usable) else 1.0,
        )

    def spread(self, scores: np.ndarray) -> np.ndarray:
        """Scores (M,) as those of the scene, (N,) float32, NaN for all others."""
        result = np.full(self.count, np.nan, np.float32)
        result[self.indices] = scores
        return result


NEIGHBOURS = 8
"""Neighbours of a splat: enough that a surface hangs together and its median is not swayed by one giant, few
enough that a floater's fellows are not all of them."""

WIDTHS = 3.0
"""Radius of a splat in standard deviations: in a coarse background, far apart is near."""


@dataclass(frozen=True)
class IsolatedClusters(Detector):
    """A cluster's mass is the sum of its opacities. Two neighbours are linked where they are no further apart
    than `reach` typical distances, or than each of them is wide."""

    label: ClassVar[str] = "Floaters"
    what: ClassVar[str] = "Small groups of splats with nothing around them."
    unit: ClassVar[str] = "times lighter than the main cluster"
    threshold: ClassVar[float] = 3000.0
    slider: ClassVar[tuple[float, float]] = (10.0, 1e6)

    reach: float = 3.0
    """Above 0: in units of the median distance to the eighth neighbour."""

    def __post_init__(self) -> None:
        above_zero("reach", self.reach)

    def _scores(self, query: Query) -> np.ndarray:
        near = Neighbourhood.of(query, NEIGHBOURS)
        radii = np.maximum(self.reach * near.typical, WIDTHS * near.extents)
        labels = linked(near.neighbours, near.distances, radii)
        opacity = opacities(query.gaussians, query.edits)[near.indices]
        mass = np.nan_to_num(opacity.astype(np.float64))
        masses = np.bincount(labels, weights=mass, minlength=len(labels))
        return near.spread(masses.max(initial=0.0) / masses[labels])

    def meaning(self, threshold: float) -> str:
        return f"clusters with less than 1/{threshold:,.0f} of the main one's mass"


@dataclass(frozen=True)
class SparseSplats(Detector):
    """Distance to the k-th neighbour, relative to that of the median splat, or to the splat's own width where
    that is more: a coarse sky is no floater."""

    label: ClassVar[str] = "Low density"
    what: ClassVar[str] = "Splats with few others around them, such as haze."
    unit: ClassVar[str] = "times the usual distance"
    threshold: ClassVar[float] = 4.0
    slider: ClassVar[tuple[float, float]] = (1.0, 1000.0)

    neighbours: int = NEIGHBOURS
    """At least 1: k."""

    def __post_init__(self) -> None:
        whole("neighbours", self.neighbours, 1)

    def _scores(self, query: Query) -> np.ndarray:
        near = Neighbourhood.of(query, self.neighbours)
        return near.spread(near.distances[:, -1] / np.maximum(near.typical, WIDTHS * near.extents))

    def meaning(self, threshold: float) -> str:
        return f"the {self.neighbours}th neighbour is over {threshold:.3g} times as far as usual"


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

    def _scores(self, query: Query) -> np.ndarray:
        # Growing or shrinking a splat leaves the ratio as it is.
        name = "anisotropy" if self.discs else "elongation"
        return attribute_values(name, query.gaussians, query.edits, query.tools)

    def meaning(self, threshold: float) -> str:
        return f"over {threshold:.3g} times as long as {'thin' if self.discs else 'wide'}"


SCENE_SHARE = 0.01
"""Share of the scene's radius at which a giant scores 1, so that one slider serves both comparisons."""


@dataclass(frozen=True)
class Giants(Detector):
    """The largest standard deviation over the median of that of the neighbours, or over the scene's
    radius."""

    label: ClassVar[str] = "Giants"
    what: ClassVar[str] = "Splats far larger than those around them, which veil the scene."
    unit: ClassVar[str] = "times as large"
    threshold: ClassVar[float] = 20.0
    slider: ClassVar[tuple[float, float]] = (2.0, 1000.0)

    against: Literal["neighbours", "scene"] = "neighbours"
    """What sizes are compared with; of the "scene" a hundredth of its radius."""

    def __post_init__(self) -> None:
        choice("against", self.against, ("neighbours", "scene"))

    def _scores(self, query: Query) -> np.ndarray:
        gaussians, edits = query.gaussians, query.edits
        largest = log_scales(gaussians, edits).max(axis=1)
        if self.against == "scene":
            _, radius = robust_bounds(positions_of(gaussians, edits)[shown(gaussians, edits)])
            return np.exp(largest) / (SCENE_SHARE * radius)
        near = Neighbourhood.of(query, NEIGHBOURS)
        own = largest[near.indices].astype(np.float64)
        others = np.where(near.neighbours >= 0, own[near.neighbours], np.nan)
        return near.spread(np.exp(own - np.median(others, axis=1)))

    def meaning(self, threshold: float) -> str:
        if self.against == "scene":
            return f"over {threshold * SCENE_SHARE:.3g} times the scene's radius"
        return f"over {threshold:.3g} times as large as their neighbours"


@dataclass(frozen=True)
class FaintSplats(Detector):
    label: ClassVar[str] = "Faint splats"
    what: ClassVar[str] = "Splats of so little opacity that they cost time and show next to nothing."
    unit: ClassVar[str] = "1 / opacity"
    threshold: ClassVar[float] = 50.0
    slider: ClassVar[tuple[float, float]] = (2.0, 255.0)

    def _scores(self, query: Query) -> np.ndarray:
        return 1 / opacities(query.gaussians, query.edits)

    def meaning(self, threshold: float) -> str:
        return f"opacity below {1 / threshold:.3g}"


@dataclass(frozen=True)
class UnseenSplats(Detector):
    """One over the contribution, the sum of alpha times transmittance over all pixels of the views. A splat
    without contribution scores infinity, which is above every threshold."""

    label: ClassVar[str] = "Never seen"
    what: ClassVar[str] = "Splats that no view shows: hidden inside, behind, or beside all of them."
    unit: ClassVar[str] = "1 / px"
    threshold: ClassVar[float] = 100.0
    slider: ClassVar[tuple[float, float]] = (0.01, 1e4)
    renders: ClassVar[bool] = True

    def _scores(self, query: Query) -> np.ndarray:
        return 1 / contributions(
            query.gaussians, query.edits, query.tools, query.cameras, progress=query.progress
        )

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
    """(N,) float64: each splat's contributions to all `cameras`, added up view by view; without cameras, to
    sample views. Raises Cancelled."""
    cameras = cameras or sample_cameras(gaussians, edits)
    total = np.zeros(len(gaussians))
    for i, camera in enumerate(cameras):
        progress.step(i / len(cameras))
        total += tools.contributions(gaussians, [camera], edits)
    progress.step(1.0)
    return total


@dataclass(frozen=True)
class HealthDetector(Detector):
    """1 for splats concerned by a finding of `scene.health` in the file, whatever was edited, and 0 for
    others."""

    unit: ClassVar[str] = "yes or no"
    threshold: ClassVar[float] = 0.5
    slider: ClassVar[tuple[float, float]] = (0.5, 1.0)
    log: ClassVar[bool] = False

    def matches(self, finding: Finding) -> bool:
        raise TypeError(f"{type(self).__name__} matches nothing")

    def _scores(self, query: Query) -> np.ndarray:
        return finding_mask(query.gaussians, self.matches)

    def meaning(self, threshold: float) -> str:
        return self.label.lower()


@dataclass(frozen=True)
class Undrawable(HealthDetector):
    label: ClassVar[str] = "Broken splats"
    what: ClassVar[str] = "NaN, infinite or zero where no picture can come of it, or opacity below 1/255."

    def matches(self, finding: Finding) -> bool:
        return finding.culled


@dataclass(frozen=True)
class Duplicates(HealthDetector):
    label: ClassVar[str] = "Duplicates"
    what: ClassVar[str] = "Splats that equal an earlier one in every value; only the copies are meant."

    def matches(self, finding: Finding) -> bool:
        return finding.name == "duplicates"


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
"""Detectors by their names in recipes."""
