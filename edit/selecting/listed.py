"""Splats named one by one, by their health, or all of them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from ...scene import Gaussians, InputError
from ...scene.edits import SceneEdits
from ...scene.health import check
from ..tools import Tools
from ..watch import UNWATCHED, Watch
from .checks import choice, store, whole


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
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
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
    """The names that `IllSplats` knows."""
    none = Gaussians(
        means=np.zeros((0, 3), np.float32),
        quats=np.zeros((0, 4), np.float32),
        log_scales=np.zeros((0, 3), np.float32),
        opacity_logits=np.zeros(0, np.float32),
        sh=np.zeros((0, 1, 3), np.float32),
    )
    return tuple(finding.name for finding in check(none))


@dataclass(frozen=True, kw_only=True)
class IllSplats:
    """Splats that a finding of `scene.health` concerns, by what the file holds, whatever was edited."""

    finding: str

    def __post_init__(self) -> None:
        choice("finding", self.finding, health_findings())

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        mask = np.zeros(len(gaussians), bool)
        watch.step(0.0)
        for finding in check(gaussians):
            if finding.name == self.finding:
                mask[finding.indices] = True
        return mask


@dataclass(frozen=True, kw_only=True)
class Everything:
    """All splats."""

    def mask(
        self, gaussians: Gaussians, edits: SceneEdits, tools: Tools, *, watch: Watch = UNWATCHED
    ) -> np.ndarray:
        return np.ones(len(gaussians), bool)
