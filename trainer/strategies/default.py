"""Classic density control: clone the small, split the large, prune the faint, dim all now and then.

Source: Kerbl et al. 2023, section 5.2, and the constants of its code; gradients added up by absolute
value after Ye et al. 2024 (AbsGS).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from splatview.raster import Parameters
from splatview.raster.compiling import kernel
from splatview.scene.projection import rotation_matrices
from splatview.trainer.strategies.ops import (
    PAPER_ITERATIONS,
    DensitySettings,
    State,
    Strategy,
    append,
    invalid_splats,
    keep,
    may_grow,
    opacities_of,
)

if TYPE_CHECKING:
    from splatview.trainer.adam import SelectiveAdam
    from splatview.trainer.functional import Visibility
    from splatview.trainer.splats import Splats

KEEP, CLONE, SPLIT, PRUNE = range(4)

SPLIT_SHRINK = 1.6
"""The two halves of a split splat are smaller by this."""

RESET_OPACITY = 0.01
"""What a reset leaves of an opacity at most."""


@dataclass(frozen=True, kw_only=True)
class Thresholds:
    """Where a splat is split, cloned or pruned."""

    gradient: float = 2e-4
    """Mean norm of dL/d(mean in the image), the image being 2 wide and 2 high."""
    absolute_gradient: float = 4e-4
    """The same where gradients are added up over pixels by absolute value (Ye et al. 2024)."""
    scale: float = 0.01
    """Times the extent: splats larger than this are split, others cloned."""
    opacity: float = 0.005
    """Splats fainter than this are pruned."""
    largest_scale: float = 0.1
    """Times the extent: after the first reset, splats larger than this are pruned."""
    reset_every: float = 3000 / PAPER_ITERATIONS
    """Share of the run."""


def decide(
    gradients: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    *,
    gradient_threshold: float,
    scale_threshold: float,
    opacity_threshold: float,
) -> np.ndarray:
    """KEEP, CLONE, SPLIT or PRUNE for each splat, (N,) int8.

    gradients (N,): mean norms; scales (N,): largest standard deviations, world units; opacities (N,).
    A splat with a value that is NaN is pruned.
    """
    actions = np.full(len(gradients), KEEP, np.int8)
    steep = gradients > gradient_threshold
    actions[steep] = np.where(scales[steep] > scale_threshold, SPLIT, CLONE)
    healthy = (opacities >= opacity_threshold) & (scales < np.inf) & (gradients < np.inf)
    actions[~healthy] = PRUNE
    return actions


@dataclass(frozen=True, kw_only=True)
class DefaultSettings(DensitySettings):
    """Settings of the classic strategy."""

    absolute_gradient: bool = False
    """classic: add up a splat's gradient over pixels by absolute value (Ye et al. 2024, AbsGS)."""


class DefaultStrategy(Strategy[DefaultSettings]):
    """Adds up what pictures show of each splat, and refines the scene by it."""

    by_view: ClassVar[bool] = True

    def __init__(self, settings: DefaultSettings | None = None, thresholds: Thresholds | None = None) -> None:
        super().__init__(settings or DefaultSettings())
        self.thresholds = thresholds or Thresholds()

    def initialize_state(self, splats: Splats, *, extent: float, focal: float = math.inf) -> State:
        """In the state: "gradient_sums" (N,) float64, sums of the norms since the last refinement;
        "view_counts" (N,) int64, pictures that showed the splat since then; "resets", opacities reset."""
        state = super().initialize_state(splats, extent=extent, focal=focal)
        return state | {"resets": 0} | nothing_noted(len(splats))

    def step_pre_backward(
        self,
        splats: Splats,
        optimizer: SelectiveAdam,
        state: State,
        step: int,
        info: Visibility,
        *,
        progress: float,
    ) -> None:
        if progress < self.settings.refine_until:
            info.on_backward(lambda info: self.note(state, info))

    def note(self, state: State, info: Visibility) -> None:
        """Adds what a differentiated picture shows to the state."""
        source = info.abs_means2d if self.settings.absolute_gradient else info.means2d
        assert source is not None
        gradients, sums, counts = source.numpy(), state["gradient_sums"], state["view_counts"]
        for indices in info.pieces:
            add_norms(indices, gradients, info.width / 2, info.height / 2, sums, counts)

    def sums(self, state: State) -> list[np.ndarray]:
        return [state["gradient_sums"], state["view_counts"]]

    def refine(
        self,
        splats: Splats,
        optimizer: SelectiveAdam,
        state: State,
        progress: float,
        rng: np.random.Generator,
    ) -> None:
        """Clones, splits and prunes; forgets what was noted."""
        limits, parameters, extent = self.thresholds, splats.arrays, state["extent"]
        with np.errstate(over="ignore"):
            scales = np.exp(parameters.log_scales.max(axis=1))
        gradients = mean_gradients(state)
        actions = decide(
            gradients,
            scales,
            opacities_of(parameters),
            gradient_threshold=limits.absolute_gradient
            if self.settings.absolute_gradient
            else limits.gradient,
            scale_threshold=limits.scale * extent,
            opacity_threshold=limits.opacity,
        )
        if state["resets"] > 0:
            actions[~(scales <= limits.largest_scale * extent)] = PRUNE
        growing = (actions == CLONE) | (actions == SPLIT)
        actions[growing & ~may_grow(state, self.settings.no_growth, parameters.means)] = KEEP
        actions[invalid_splats(parameters)] = PRUNE
        if "sky" in state:
            actions[state["sky"] > 0] = KEEP
        if (actions == PRUNE).all():
            actions[:] = KEEP  # there would be nothing left to train
        self._respect_limit(actions, gradients)
        cloned = Parameters(*(array[actions == CLONE] for array in parameters))
        halves = split(Parameters(*(array[actions == SPLIT] for array in parameters)), rng)
        keep(splats, optimizer, state, (actions == KEEP) | (actions == CLONE))
        added = Parameters(*(np.concatenate(pair) for pair in zip(cloned, halves, strict=True)))
        append(splats, optimizer, state, added)
        if progress >= (state["resets"] + 1) * limits.reset_every and progress < self.settings.refine_until:
            state["resets"] = int(progress / limits.reset_every)
            reset_opacities(splats, optimizer)
        state.update(nothing_noted(len(splats)))

    def _respect_limit(self, actions: np.ndarray, gradients: np.ndarray) -> None:
        """Turns clones and splits beyond the room for new splats into keeps, those of the least gradients
        first."""
        growing = np.flatnonzero((actions == CLONE) | (actions == SPLIT))
        room = self.settings.max_splats - int((actions != PRUNE).sum())
        if len(growing) > room:
            by_gradient = np.argsort(-gradients[growing], kind="stable")
            actions[growing[by_gradient[max(room, 0) :]]] = KEEP


def nothing_noted(count: int) -> dict[str, np.ndarray]:
    """The arrays of a state after a refinement."""
    return {"gradient_sums": np.zeros(count), "view_counts": np.zeros(count, np.int64)}


def mean_gradients(state: State) -> np.ndarray:
    """(N,) float64: norms since the last refinement, over the pictures that showed the splat."""
    return state["gradient_sums"] / np.maximum(state["view_counts"], 1)


def split(parameters: Parameters, rng: np.random.Generator) -> Parameters:
    """Two splats for each, drawn from it as from a probability density, smaller by SPLIT_SHRINK."""
    twice = Parameters(*(np.concatenate([array, array]) for array in parameters))
    offsets = rng.standard_normal((len(twice.means), 3)) * np.exp(twice.log_scales.astype(np.float64))
    moved = twice.means + np.einsum("nij,nj->ni", rotation_matrices(twice.quats), offsets)
    return twice._replace(
        means=moved.astype(np.float32), log_scales=twice.log_scales - np.float32(math.log(SPLIT_SHRINK))
    )


def reset_opacities(splats: Splats, optimizer: SelectiveAdam) -> None:
    """Caps every opacity at RESET_OPACITY, in place, and forgets the averages of opacities."""
    logits = splats.arrays.opacity_logits
    np.minimum(logits, np.float32(math.log(RESET_OPACITY / (1 - RESET_OPACITY))), out=logits)
    optimizer.first.opacity_logits[:] = 0
    optimizer.second.opacity_logits[:] = 0


@kernel
def add_norms(indices, gradients, half_width, half_height, sums, counts):
    """sums[i] += the norm of gradients[i] in half images, counts[i] += 1, for the splats at `indices`."""
    for i in indices:
        x, y = gradients[i, 0] * half_width, gradients[i, 1] * half_height
        norm = np.sqrt(x * x + y * y)
        if norm <= 1e18:
            sums[i] += norm
        counts[i] += 1
