"""Selectors by position in space, by index or health finding, and of all splats."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from splatview.edit.kernels.compiling import in_pieces
from splatview.edit.kernels.marks import in_volume, places_of
from splatview.edit.selectors.base import above_zero, choice, finding_mask, numbers, store, vector, whole
from splatview.edit.tools import Tools
from splatview.scene import Gaussians, InputError
from splatview.scene.edits import IDENTITY_ROTATION, Crop, Four, SceneEdits, Vector
from splatview.scene.health import check
from splatview.scene.progress import NO_PROGRESS, Progress


@dataclass(frozen=True, kw_only=True)
class Sphere:
    """Splats with their mean in a ball, its surface included."""

    centre: Vector
    """World units."""
    radius: float
    """Above 0, world units."""

    def __post_init__(self) -> None:
        store(self, centre=vector("centre", self.centre), radius=above_zero("radius", self.radius))

    @property
    def shape(self) -> Crop:
        """The same region as a crop."""
        return Crop(shape="sphere", centre=self.centre, half_extents=(self.radius, self.radius, self.radius))

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        return _inside(self.shape, gaussians, edits, progress)


@dataclass(frozen=True, kw_only=True)
class Box:
    """Splats with their mean in a box of any orientation, its surface included."""

    centre: Vector
    """World units."""
    half_extents: Vector
    """Above 0, world units, along its own axes."""
    rotation: Four = IDENTITY_ROTATION
    """wxyz of length 1, from its own axes to the world's."""

    def __post_init__(self) -> None:
        store(
            self,
            centre=vector("centre", self.centre),
            half_extents=vector("half_extents", self.half_extents),
            rotation=numbers("rotation", self.rotation, 4),
        )
        _ = self.shape  # which checks the rest

    @property
    def shape(self) -> Crop:
        """The same region as a crop."""
        return Crop(shape="box", centre=self.centre, half_extents=self.half_extents, rotation=self.rotation)

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        return _inside(self.shape, gaussians, edits, progress)


def _inside(shape: Crop, gaussians: Gaussians, edits: SceneEdits, progress: Progress) -> np.ndarray:
    mask = np.empty(len(gaussians), bool)
    places, unit = places_of(gaussians, edits), np.ascontiguousarray(shape.unit_from_world)
    ellipsoid = shape.shape == "sphere"

    def work(start: int, stop: int) -> None:
        in_volume(start, stop, places, unit, ellipsoid, mask)

    in_pieces(len(mask), work, progress=progress)
    return mask


@dataclass(frozen=True, kw_only=True)
class IndexRuns:
    """Splats by their places in the file."""

    runs: tuple[tuple[int, int], ...]
    """[start, count] each; they may overlap."""

    def __post_init__(self) -> None:
        if not isinstance(self.runs, (list, tuple)):
            raise ValueError(f"runs must be a list of [start, count], got {self.runs!r}")
        runs = []
        for i, run in enumerate(self.runs):
            if not isinstance(run, (list, tuple)) or len(run) != 2:
                raise ValueError(f"runs[{i}] must be [start, count], got {run!r}")
            runs.append((whole(f"runs[{i}] start", run[0], 0), whole(f"runs[{i}] count", run[1], 0)))
        store(self, runs=tuple(runs))

    @classmethod
    def of(cls, mask: np.ndarray) -> IndexRuns:
        """The runs of `mask` (N,) bool."""
        edges = np.flatnonzero(np.diff(mask.astype(np.int8), prepend=0, append=0)).tolist()
        return cls(
            runs=tuple((start, stop - start) for start, stop in zip(edges[::2], edges[1::2], strict=True))
        )

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        mask = np.zeros(len(gaussians), bool)
        for i, (start, count) in enumerate(self.runs):
            if not start + count <= len(mask):
                raise InputError(
                    f"runs[{i}] ends at splat {start + count}, but the scene has {len(mask)}; "
                    "it was made for another scene"
                )
            mask[start : start + count] = True
        return mask


@cache
def health_findings() -> tuple[str, ...]:
    """Names of the findings of `scene.health`."""
    none = Gaussians(
        means=np.zeros((0, 3), np.float32),
        quats=np.zeros((0, 4), np.float32),
        log_scales=np.zeros((0, 3), np.float32),
        opacity_logits=np.zeros(0, np.float32),
        sh=np.zeros((0, 1, 3), np.float32),
    )
    return tuple(finding.name for finding in check(none))


@dataclass(frozen=True, kw_only=True)
class InvalidSplats:
    """Splats that a finding of `scene.health` concerns, by what the file holds, whatever was edited."""

    finding: str

    def __post_init__(self) -> None:
        choice("finding", self.finding, health_findings())

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        progress.step(0.0)
        return finding_mask(gaussians, lambda finding: finding.name == self.finding)


@dataclass(frozen=True, kw_only=True)
class Everything:
    """All splats."""

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        return np.ones(len(gaussians), bool)
