"""What all strategies of density control share: settings, life cycle and operations on splats."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, TypeVar

import numpy as np

from splatview.raster import Parameters, available_threads
from splatview.raster.compiling import SPLATS_PER_TASK, even_ranges, kernel, run
from splatview.scene.edits import Crop
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.scene.image_model import MIN_QUAT_COMPONENT
from splatview.scene.projection import FLOAT32_MAX, sigmoid

if TYPE_CHECKING:  # settings of strategies are read where torch is missing
    from splatview.trainer.adam import SelectiveAdam
    from splatview.trainer.functional import Visibility
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


State = dict[str, Any]
"""What a strategy notes from step to step: numbers and numpy arrays by name, those of N rows a row for each
splat. Plain data, which checkpoints can hold."""

Settings = TypeVar("Settings", bound=DensitySettings)


class Strategy(ABC, Generic[Settings]):
    """What decides where splats are born and die, in the life cycle of gsplat's strategies:

        state = strategy.initialize_state(splats, extent=extent, focal=focal)
        for step in range(1, steps + 1):
            image, info = rasterize(*splats.parameters(), camera)
            progress = (step - 1) / steps
            strategy.step_pre_backward(splats, optimizer, state, step, info, progress=progress)
            loss_of(image).backward()
            optimizer.step(info.pieces)
            strategy.step_post_backward(splats, optimizer, state, step, info, progress=progress)
            optimizer.zero_grad()

    A strategy itself notes nothing: its `state` does. `progress` is the share of the run that was over when
    the step began, 0 to 1, by which settings are stated. A step on several pictures calls
    `step_pre_backward` for each of them, and `step_post_backward` once, with a `Visibility` of them all.
    """

    by_view: ClassVar[bool] = False
    """Whether it notes gradients by means in the image, see `rasterize`."""

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        """May be replaced between steps."""

    def initialize_state(self, splats: Splats, *, extent: float, focal: float = math.inf) -> State:
        """The state of a run that begins with `splats`. `extent`: radius of the scene, world units; `focal`:
        of the photos, px."""
        return {"extent": extent, "focal": focal, "refined_at": 0, "refined_progress": 0.0}

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
        """Between drawing and differentiating: asks the picture for what shall be noted of it."""

    def step_post_backward(
        self,
        splats: Splats,
        optimizer: SelectiveAdam,
        state: State,
        step: int,
        info: Visibility,
        *,
        progress: float,
    ) -> None:
        """After the optimiser's step: refines the scene where that is due."""
        settings = self.settings
        if (
            settings.refine_from <= progress < settings.refine_until
            and progress - state["refined_progress"] >= settings.refine_every
            and step - state["refined_at"] >= settings.least_refine_steps
        ):
            rng = np.random.default_rng([settings.seed, step, 1])
            self.refine(splats, optimizer, state, progress, rng)
            state["refined_at"], state["refined_progress"] = step, progress

    @abstractmethod
    def refine(
        self,
        splats: Splats,
        optimizer: SelectiveAdam,
        state: State,
        progress: float,
        rng: np.random.Generator,
    ) -> None:
        """Adds, moves and takes out splats, at a share of the run."""

    def sums(self, state: State) -> list[np.ndarray]:
        """Arrays of the state to which pictures add in `backward`; several processes add theirs up."""
        return []


def keep(splats: Splats, optimizer: SelectiveAdam, state: State, which: np.ndarray) -> None:
    """Only the splats at `which` (integers or a mask), with their averages and their rows of the state."""
    count, groups = len(splats), (splats.arrays, optimizer.first, optimizer.second)
    parameters, first, second = (Parameters(*(array[which] for array in group)) for group in groups)
    splats.replace(parameters, splats.ids[which])
    optimizer.replace(splats, first, second)
    for name, value in state.items():
        if isinstance(value, np.ndarray) and len(value) == count:
            state[name] = value[which]


def append(splats: Splats, optimizer: SelectiveAdam, state: State, new: Parameters) -> None:
    """New splats behind the others; their averages and their rows of the state are 0.

    Dropped, where splats are shared: squared gradients that go on from those of the splat a copy was made of,
    in whole or by a tenth of them, so that a copy's first hundred steps are no longer than others. A minute
    of split 0, one run each (capped.json): `mug` 29.73, 29.16 and 29.70 dB, `miku` 30.50, 29.63 and 30.07,
    `skull RGBA 100` 32.83, 32.15 and 32.61; `gum` 24.90, 24.80 and 25.21, the first with
    a photo left out.

    Dropped: to sort splats along a Z-curve after every 300 or 500 steps. A picture and its gradients of
    35,000 splats that `banana` trained take 7 % less in that order, of 100,000 synthetic ones 5 %; but 2,000
    steps from the start took 43.1 and 43.6 s without, 43.8 and 44.7 s with it.
    """
    count, added = len(splats), len(new.means)
    zeros = Parameters(*(np.zeros_like(array) for array in new))
    parameters, first, second = (
        Parameters(*(np.concatenate(pair) for pair in zip(group, more, strict=True)))
        for group, more in (
            (splats.arrays, new),
            (optimizer.first, zeros),
            (optimizer.second, zeros),
        )
    )
    splats.replace(parameters, np.concatenate([splats.ids, splats.new_ids(added)]))
    optimizer.replace(splats, first, second)
    for name, value in state.items():
        if isinstance(value, np.ndarray) and len(value) == count:
            state[name] = np.concatenate([value, np.zeros((added, *value.shape[1:]), value.dtype)])


def raise_sh_degree(splats: Splats, optimizer: SelectiveAdam, degree: int) -> None:
    """Coefficients up to `degree`, if they are not there yet; new ones and their averages are 0."""
    missing = SH_COEFFICIENTS[degree] - splats.sh.shape[1]
    if missing <= 0:
        return
    parameters, first, second = (
        group._replace(sh=np.pad(group.sh, ((0, 0), (0, missing), (0, 0))))
        for group in (splats.arrays, optimizer.first, optimizer.second)
    )
    splats.replace(parameters, splats.ids)
    optimizer.replace(splats, first, second)


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


def may_grow(state: State, no_growth: Sequence[Crop], means: np.ndarray) -> np.ndarray:
    """Which splats at `means` (N, 3) may be multiplied: (N,) bool; those in regions without growth and those
    of the sky may not."""
    grown = ~inside_any(no_growth, means)
    return grown & (state["sky"] == 0) if "sky" in state else grown


def inside_any(regions: Sequence[Crop], means: np.ndarray) -> np.ndarray:
    """Which of `means` (N, 3) are inside a region that is switched on, whatever it keeps: (N,) bool."""
    inside = np.zeros(len(means), np.bool_)
    for region in regions:
        if region.enabled:
            inside |= region.contains(means)
    return inside
