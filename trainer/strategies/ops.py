"""What all strategies of density control share: settings, life cycle and operations on splats."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from splatview.raster import Frame, Parameters, available_threads
from splatview.raster.compiling import SPLATS_PER_TASK, even_ranges, kernel, run
from splatview.raster.gradients import Gradients
from splatview.scene.edits import Crop
from splatview.scene.image_model import MIN_QUAT_COMPONENT
from splatview.scene.projection import FLOAT32_MAX, sigmoid
from splatview.trainer.adam import NO_REGULARISATION, Regularisation
from splatview.trainer.splats import Splats

PAPER_ITERATIONS = 30_000
"""Steps of the run that the paper's numbers are those of (Kerbl et al. 2023)."""


@dataclass(frozen=True, kw_only=True)
class DensitySettings:
    """Settings of density control that every strategy has."""

    seed: int = 0
    refine_from: float = 500 / PAPER_ITERATIONS
    """Share of the run."""
    refine_until: float = 15_000 / PAPER_ITERATIONS
    """Share of the run."""
    refine_every: float = 100 / PAPER_ITERATIONS
    """Share of the run."""
    least_refine_steps: int = 50
    """Steps between refinements at least: gradients are averaged over some photos even in short runs."""
    max_splats: int = 1_000_000
    """Density control adds no splats beyond this."""
    no_growth: tuple[Crop, ...] = ()
    """Where density control multiplies none: inside these shapes, those switched off aside. What they keep
    does not matter; halves of a large neighbour may still reach in."""


Settings = TypeVar("Settings", bound=DensitySettings)


@dataclass(eq=False)
class Strategy(ABC, Generic[Settings]):
    """What decides where splats are born and die. The base notes nothing and moves nothing."""

    settings: Settings
    extent: float
    """Radius of the scene, world units."""

    def begin(self, count: int) -> None:
        """The run begins with `count` splats."""

    def keep(self, kept: np.ndarray) -> None:
        """Only the splats that the mask (N,) names are left."""

    def observe(self, frame: Frame, gradients: Gradients, visible: list[np.ndarray]) -> None:
        """Takes note of one step; `visible` are the splats that reach into its photo."""

    @abstractmethod
    def refine(self, splats: Splats, progress: float, rng: np.random.Generator) -> Splats:
        """The scene with splats added, moved and taken out, at a share of the run."""

    def regularisation(self, progress: float, focal: float) -> Regularisation:
        """Losses on opacity and scale at a share of the run, for photos of this focal length in px."""
        return NO_REGULARISATION

    def after_step(
        self, splats: Splats, visible: list[np.ndarray], rate: float, iteration: int, threads: int
    ) -> None:
        """Moves splats, in place, after Adam has; `rate` is that of the means."""

    def totals(self) -> list[np.ndarray]:
        """What `observe` adds to, in place."""
        return []

    @abstractmethod
    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""

    @abstractmethod
    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where another's `state` was taken."""


def opacities_of(parameters: Parameters) -> np.ndarray:
    """(N,) float64."""
    with np.errstate(invalid="ignore"):  # NaN may be signalling
        return sigmoid(parameters.opacity_logits.astype(np.float64))


LARGEST_LOG_SCALE = math.log(FLOAT32_MAX)
"""exp of more is infinite."""


def invalid_splats(parameters: Parameters) -> np.ndarray:
    """(N,) bool: a value is not finite, a log-scale is beyond float32's exp, or the quaternion is zero.

    Training cannot move such a splat: no picture shows it, so no gradient reaches it; but by its opacity
    alone it would be chosen to be copied.
    """
    invalid = np.empty(len(parameters.means), np.bool_)
    threads = available_threads()
    run(
        find_invalid,
        even_ranges(len(invalid), threads, step=SPLATS_PER_TASK),
        (*parameters, invalid),
        threads,
    )
    return invalid


@kernel
def find_invalid(start, stop, means, quats, log_scales, opacity_logits, sh, invalid):
    for i in range(start, stop):
        # 0 where all are finite, else NaN.
        nothing = opacity_logits[i] * 0
        largest = np.float32(-np.inf)
        for k in range(3):
            nothing += means[i, k] * 0 + log_scales[i, k] * 0
            largest = max(largest, log_scales[i, k])
        longest = np.float32(0)
        for k in range(4):
            nothing += quats[i, k] * 0
            longest = max(longest, abs(quats[i, k]))
        for k in range(sh.shape[1]):
            for channel in range(3):
                nothing += sh[i, k, channel] * 0
        invalid[i] = not (nothing == 0 and longest >= MIN_QUAT_COMPONENT and largest <= LARGEST_LOG_SCALE)


def inside_any(regions: Sequence[Crop], means: np.ndarray) -> np.ndarray:
    """Which of `means` (N, 3) are inside a region that is switched on, whatever it keeps: (N,) bool."""
    inside = np.zeros(len(means), np.bool_)
    for region in regions:
        if region.enabled:
            inside |= region.contains(means)
    return inside


GONE = -30.0
"""Logit whose opacity no picture shows."""


def dropout(parameters: Parameters, share: float, rng: np.random.Generator) -> Parameters:
    """The splats with this share (below 1) of them, drawn by chance, made invisible; the rest is stronger.

    A step without some of the splats keeps the others from relying on them: where photos are few, splats that
    make one photo right by covering for one another's faults make every other view wrong. Source: Park et al.
    2025, DropGaussian. There the opacities of those left are divided by their share; here their logits are
    raised by its logarithm, which is the same where splats are faint, keeps opacities below 1, and leaves the
    derivative by a logit as it is.
    """
    with np.errstate(invalid="ignore"):  # NaN may be signalling
        logits = parameters.opacity_logits - np.float32(math.log1p(-share))
    logits[rng.random(len(logits), np.float32) < share] = GONE
    return parameters._replace(opacity_logits=logits)
