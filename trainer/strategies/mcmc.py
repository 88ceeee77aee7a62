"""Density control as sampling: dead splats move to where the scene is, and faint ones wander.

Source: Kheradmand et al. 2024, 3D Gaussian Splatting as Markov Chain Monte Carlo, and the constants of
its code. Losses that the optimiser adds draw opacity and scale towards 0, so that what does not help
dies; a dead splat is put on a living one, both changed so that the picture stays; the number grows
towards a limit, as far as splats are opaque enough to be shared; and noise explores where they are nearly
transparent.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from splatview.raster import Parameters, available_threads
from splatview.raster.compiling import inline, kernel, run
from splatview.raster.project import rotation_matrix, sigmoid
from splatview.trainer.strategies.ops import (
    PAPER_ITERATIONS,
    DensitySettings,
    State,
    Strategy,
    append,
    invalid_splats,
    may_grow,
    opacities_of,
)

if TYPE_CHECKING:
    from splatview.trainer.adam import SelectiveAdam
    from splatview.trainer.functional import Visibility
    from splatview.trainer.splats import Splats

DEAD = 0.005
"""Splats no more opaque than this are moved. With 0.02 a minute of the bench at half its size scores 29.94
in place of 29.79 dB on `miku`, 28.55 and 28.50 on `banana`, 38.37 and 38.48 on `playbot RGBA 100`, 33.22
and 33.45 on `skull RGBA 100`; with 0.05 `banana` 26.89, `skull RGBA 100` 31.88. To move them until 0.8 of
the run, not until half of it, changes nothing: 29.78, 28.51, 38.51 and 33.54 dB."""

MOST_COPIES = 51
"""A splat is shared among at most so many."""

LEAST_SHARED = 0.04
"""Opacity that each copy of a shared splat has at least. Kheradmand et al. 2024 share as far as it takes, and
raise what is less than `DEAD` to that, so that the picture changes; such copies die, are moved onto others
and make these fainter in turn. Three minutes of the bench, one run each. Chosen, with no such limit, 0.01,
0.02, 0.04 and 0.08: `train front 30` 40.61, 43.2, 44.0, 45.12 and 45.56 dB (the first and the fourth with
exposures learnt; 0.04 without has 45.60), `biker front 24` 44.55, none, 44.56, 44.55 and 44.60 (38,302
splats are left without, 40,144 with 0.04, 35,075 with 0.08). Judged: see sharing.json."""

MOST_GROWTH = 2
"""The number of splats grows at most by this factor at once: in runs of a hundred steps, with one or two
refinements, many faint copies of each splat have no time left to become different."""

NOISE_SHARPNESS = 100.0
NOISE_MIDDLE = 0.995
"""Noise fades with opacity o as 1 / (1 + exp(-sharpness·(1 - o - middle)))."""

NOISE_EXTENT = 2.5
"""Extent at which noise is as large as in Kheradmand et al. 2024. There it is a splat's covariance, in
square units, times the rate of positions, in units, so that captures in millimetres had a million times
as much as those in metres: `banana` in units a thousand times as small scored 28.42 dB with 6,900 splats
that were left, in its own (an extent of 5.1) 28.76 with 17,700 (a minute at half the bench's size, a
third held out). Now it is alike in any unit. One run each, with this and as it was: `banana` 28.74 and
28.76, by another seed 28.73 and 28.87 (with 5 28.88, with 1 28.58), `skull RGBA 100` (an extent of 3.0)
33.48 and 33.39 (with 5 33.10), `miku` (6.0) 30.34 and 30.22, `guitar RGBA 24` (6.4) 38.68 and 38.93; with
5 `miku 12 near` (1.9) 28.93 and 29.16."""

LEAST_NOISE = 1e-4
"""Below this share of its full size noise is left out."""

MOST_SHAKEN = math.log(0.1 / 0.9)
"""Opacity logit, that of an opacity of 0.1, beyond which noise is less than that."""

LEAST_REG = 0.01
"""Kheradmand et al. 2024."""

LEAST_COUNTED = 0.1
"""Of `max_splats`, that the regularisers' means are over at least. A mean over few splats presses on each the
harder: `train front 30` of the bench, lights on black, begins at 83 points, which it faded one and all,
and a run without a living splat is over. One run each, a third held out, half the bench's size but for the
first. Chosen, with 0, 0.1, 0.3 and 1: there 27.8 (as empty), 34.5, 34.0 and 33.5 dB at full size, 35.3,
36.9, 36.7 and 34.9 at half, 33.4, 39.6 and 37.3 there by another seed; `banana` 28.76, 28.76, 28.68 and
28.63. Judged, with 0 and 0.1, by captures of which 50 points are left: `banana` 25.54 and 26.75 dB, `miku
12 near` 26.59 and 27.40, `guitar RGBA 24` 38.75 and 38.93, `biker front 24` 42.09 and 42.42."""

SMALLEST_REGULARISED = 0.1
"""Pixels, seen from as far as the scene is: thinner splats are not drawn to be thinner still."""


def need_of_reg(photo_loss: float, full: float) -> float:
    """How far regularisers that stand for missing photos are needed, 0 to 1, at a running mean of the photo
    loss; 1 where there is none yet, or `full` is 0."""
    return photo_loss / full if 0 < photo_loss < full else 1.0


EASE_POWER, LEAST_EASED = 8, 1 / 3
"""How steeply the weight of opacity falls with the median opacity below `full_reg_opacity`, and how far: so
that it comes to rest where the median is a little below. See `recipe.FULL_REG_OPACITY`."""


def ease_of_faint(median_opacity: float, full: float) -> float:
    """Factor of the weight of opacity where half of the splats are fainter than `median_opacity`, see
    `MCMCSettings.full_reg_opacity`; 1 where that is not known, or `full` is 0."""
    if not 0 <= median_opacity < full:
        return 1.0
    return max((median_opacity / full) ** EASE_POWER, LEAST_EASED)


def eased(weight: float, need: float) -> float:
    """A regulariser's weight by need, but not below `LEAST_REG` or the weight itself, the lesser of both."""
    return max(need * weight, min(weight, LEAST_REG))


@dataclass(frozen=True, kw_only=True)
class MCMCSettings(DensitySettings):
    """Settings of the sampling strategy."""

    grow_for: float = 12_000 / PAPER_ITERATIONS
    """mcmc: share of the run, from `refine_from` on, in which the number grows to `max_splats`. What
    opacities had no room for is made up for until `refine_until`: until 0.7, in place of 0.5, `trex` has
    28.17 dB in place of 28.31 after a minute, `playbot RGBA 18` 31.21 of 31.19, `skater` 30.44 of 30.24
    after three."""
    noise: float = 5e5
    """mcmc: noise on positions, in units of their rate. See `NOISE_EXTENT`."""
    opacity_reg: float = LEAST_REG
    """mcmc: weight of the mean opacity in the loss. See `automatic_regularisation` and `LEAST_COUNTED`."""
    scale_reg: float = LEAST_REG
    """mcmc: weight of the mean scale, world units over the extent, in the loss."""
    full_reg_loss: float = 0.0
    """Photo loss from which on both weights are full, as dropout and the limit to needles are with every
    strategy; below they are less in proportion, but not below `LEAST_REG`. 0: always full. See
    `recipe.FULL_REG_LOSS`."""
    full_reg_opacity: float = 0.0
    """mcmc: median opacity from which on the weight of opacity is full; while half of the splats are fainter,
    it is less. 0: always full. See `recipe.FULL_REG_OPACITY`."""
    reg_end: float = 0.1
    """mcmc: factor of both weights at the end of the run, reached exponentially. Adam moves what only a
    regulariser moves at full speed: at constant strength a run of 67,000 steps on 13 photos ended with a
    median opacity of 0.01 and half of the splats thinner than a thousandth of a pixel, 1.4 dB below one of
    4,000 steps."""


class MCMCStrategy(Strategy[MCMCSettings]):
    """Moves the dead to the living, and adds copies of the living."""

    def __init__(self, settings: MCMCSettings | None = None) -> None:
        super().__init__(settings or MCMCSettings())

    def initialize_state(self, splats: Splats, *, extent: float, focal: float = math.inf) -> State:
        """In the state: "initial_count", splats at the start of the run, from which the number grows."""
        state = super().initialize_state(splats, extent=extent, focal=focal)
        return state | {"initial_count": len(splats)}

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
        """Sets the weights of the regularisers in the optimiser's next step."""
        settings, extent = self.settings, state["extent"]
        counted = max(len(splats), LEAST_COUNTED * settings.max_splats)
        factor = settings.reg_end**progress * len(splats) / counted
        needed = need_of_reg(state.get("photo_loss", 0.0), settings.full_reg_loss)
        weight = eased(settings.opacity_reg, needed)
        weight *= ease_of_faint(state.get("median_opacity", math.inf), settings.full_reg_opacity)
        optimizer.set_options("opacity_logits", reg=factor * weight)
        optimizer.set_options(
            "log_scales",
            reg=factor * eased(settings.scale_reg, needed) / extent,
            least=SMALLEST_REGULARISED * extent / state["focal"],
        )

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
        """Adds noise to the positions of splats just moved, and refines where that is due."""
        means, quats, log_scales, opacity_logits, _ = splats.arrays
        seed = np.uint64(mixed(self.settings.seed * 0x9E3779B97F4A7C15 + step))
        amount = self.settings.noise * optimizer.rates.means * (NOISE_EXTENT / state["extent"]) ** 2
        run(
            shake,
            [(indices,) for indices in info.pieces if len(indices)],
            (means, quats, log_scales, opacity_logits, amount, seed),
            optimizer.threads or available_threads(),
        )
        super().step_post_backward(splats, optimizer, state, step, info, progress=progress)

    def refine(
        self,
        splats: Splats,
        optimizer: SelectiveAdam,
        state: State,
        progress: float,
        rng: np.random.Generator,
    ) -> None:
        """Moves the dead, and adds splats up to the number due at this share of the run."""
        parameters = splats.arrays
        opacities = opacities_of(parameters)
        living = (opacities > DEAD) & ~invalid_splats(parameters)
        if living.any():
            state["median_opacity"] = float(np.median(opacities[living]))
        dead = np.flatnonzero(~living)
        # In regions without growth splats may die and move away, but nothing comes.
        growing = may_grow(state, self.settings.no_growth, parameters.means)
        alive = np.flatnonzero(living & growing)
        if len(alive) == 0:
            return
        if len(dead):
            sources, copies = self._draw(parameters, opacities, alive, len(dead), rng)
            dead = dead[: len(sources)]  # for others there is no room: they are tried again
            for array, values in zip(parameters, copies, strict=True):
                array[sources] = values
                array[dead] = values
            splats.renumber(dead)
            for group in (optimizer.first, optimizer.second):
                for array in group:
                    array[sources] = 0
                    array[dead] = 0
        due = self.count_at(progress, state["initial_count"])
        missing = min(due, MOST_GROWTH * len(splats)) - len(splats)
        if missing > 0:
            opacities = opacities_of(parameters)
            growing = may_grow(state, self.settings.no_growth, parameters.means)
            sources, copies = self._draw(parameters, opacities, np.flatnonzero(growing), missing, rng)
            for array, values in zip(parameters, copies, strict=True):
                array[sources] = values
            append(splats, optimizer, state, copies)

    def count_at(self, progress: float, initial: int) -> int:
        """Splats due at a share of a run that began with `initial`: even growth by factors, to the limit when
        growth ends."""
        settings = self.settings
        begin, end = settings.refine_from, settings.refine_from + settings.grow_for
        share = min(max((progress - begin) / max(end - begin, 1e-9), 0.0), 1.0)
        limit = max(settings.max_splats, initial)
        return round(initial * (limit / initial) ** share)

    def _draw(
        self,
        parameters: Parameters,
        opacities: np.ndarray,
        candidates: np.ndarray,
        count: int,
        rng: np.random.Generator,
    ) -> tuple[np.ndarray, Parameters]:
        """Draws `count` candidates by opacity, and leaves out for what they have no room: indices (K,), and
        what each and its copies become. See `room`.

        Dropped, a minute of the bench at half its size on `banana` and `biker front 24`, which score 28.71
        and 42.86 dB: to draw by error, as the rms gradient of the colour (27.05, 42.82), that times the
        opacity (28.27, 42.73), or the mean's gradient in the image times the opacity (28.78, 42.83) or times
        the size (28.59, 42.79).

        Dropped too: by opacity times how wrong photos are under the splat, the median of eight photos drawn
        for each refinement (after FastGS, Ren et al. 2025): `banana` 28.79 and 28.47 dB in place of 28.62
        and 28.51 (two seeds), `miku` 30.08 in place of 29.96, `skull RGBA 100` 33.56 in place of 33.54, for
        8 % more time than the bench counts; judged by `train front 30`, 33.8 in place of 38.7 and 36.6, and
        33.5 where the factor is held between a half and two.
        """
        weights = opacities[candidates]
        drawn = candidates[rng.choice(len(candidates), size=count, p=weights / weights.sum())]
        drawn = drawn[occurrences(drawn) < room(opacities[drawn])]
        copies = np.minimum(np.bincount(drawn, minlength=len(opacities))[drawn] + 1, MOST_COPIES)
        opacity, shrink = shared(opacities[drawn], copies)
        opacity = np.minimum(opacity, 1 - 1e-6)
        return drawn, Parameters(
            means=parameters.means[drawn],
            quats=parameters.quats[drawn],
            log_scales=parameters.log_scales[drawn] + np.log(shrink).astype(np.float32)[:, None],
            opacity_logits=np.log(opacity / (1 - opacity)).astype(np.float32),
            sh=parameters.sh[drawn],
        )


def room(opacities: np.ndarray) -> np.ndarray:
    """How many copies splats of these opacities (N,) can have beside themselves, so that none has less than
    `LEAST_SHARED`: (N,) float64, 0 and more."""
    most = np.log1p(-np.minimum(opacities, 1 - 1e-6)) / math.log1p(-LEAST_SHARED)
    return np.maximum(np.floor(most) - 1, 0.0)


def occurrences(values: np.ndarray) -> np.ndarray:
    """How often each of `values` (N,) has occurred before: (N,)."""
    order = np.argsort(values, kind="stable")
    begins = np.flatnonzero(np.diff(values[order], prepend=-1))
    before = np.empty(len(values), np.int64)
    before[order] = np.arange(len(values)) - np.repeat(begins, np.diff(begins, append=len(values)))
    return before


def shared(opacities: np.ndarray, copies: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What becomes of a splat as `copies` of it lie on one another and look as it did before.

    Returns the opacity of each copy and the factor of its scale (eq. 9): 1 - (1 - o')^n = o, and the
    line integrals through the middle agree. Both (N,) float64.
    """
    opacities = opacities.astype(np.float64)
    opacity = 1 - (1 - opacities) ** (1 / copies)
    total = np.zeros_like(opacity)
    for i in range(1, int(copies.max(initial=0)) + 1):
        term = np.zeros_like(opacity)
        for k in range(i):
            term += math.comb(i - 1, k) * (-1) ** k / math.sqrt(k + 1) * opacity ** (k + 1)
        total += np.where(i <= copies, term, 0)
    return opacity, opacities / total


def mixed(value: int) -> int:
    """A well mixed 64-bit number (the finaliser of SplitMix64, Steele et al. 2014)."""
    value = (value + 0x9E3779B97F4A7C15) & 0xFFFFFFFFFFFFFFFF
    value = ((value ^ (value >> 30)) * 0xBF58476D1CE4E5B9) & 0xFFFFFFFFFFFFFFFF
    value = ((value ^ (value >> 27)) * 0x94D049BB133111EB) & 0xFFFFFFFFFFFFFFFF
    return value ^ (value >> 31)


@inline
def random_pair(seed, counter):
    """Two normal numbers that depend on nothing but the arguments: the same on any number of threads."""
    value = seed + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15)
    value = (value ^ (value >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    value = (value ^ (value >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    value = value ^ (value >> np.uint64(31))
    high = (np.float64(value >> np.uint64(32)) + 0.5) / 4294967296.0
    low = np.float64(value & np.uint64(0xFFFFFFFF)) / 4294967296.0
    radius, angle = np.sqrt(-2 * np.log(high)), 2 * np.pi * low
    return radius * np.cos(angle), radius * np.sin(angle)


@kernel
def shake(indices, means, quats, log_scales, opacity_logits, amount, seed):
    """Moves the means at `indices` by amount·fade(opacity)·S·noise, S being the covariance."""
    for i in indices:
        if opacity_logits[i] > MOST_SHAKEN:
            continue
        opacity = sigmoid(np.float64(opacity_logits[i]))
        fade = 1 / (1 + np.exp(-NOISE_SHARPNESS * (1 - opacity - NOISE_MIDDLE)))
        if not fade >= LEAST_NOISE:
            continue
        w, x, y, z = (
            np.float64(quats[i, 0]),
            np.float64(quats[i, 1]),
            np.float64(quats[i, 2]),
            np.float64(quats[i, 3]),
        )
        shrink = 1 / np.sqrt(w * w + x * x + y * y + z * z)
        r = rotation_matrix(w * shrink, x * shrink, y * shrink, z * shrink)
        n0, n1 = random_pair(seed, 2 * i)
        n2, _ = random_pair(seed, 2 * i + 1)
        # S·n = R·diag(s²)·Rᵀ·n
        a = (r[0] * n0 + r[3] * n1 + r[6] * n2) * np.exp(2 * np.float64(log_scales[i, 0]))
        b = (r[1] * n0 + r[4] * n1 + r[7] * n2) * np.exp(2 * np.float64(log_scales[i, 1]))
        c = (r[2] * n0 + r[5] * n1 + r[8] * n2) * np.exp(2 * np.float64(log_scales[i, 2]))
        dx = amount * fade * (r[0] * a + r[1] * b + r[2] * c)
        dy = amount * fade * (r[3] * a + r[4] * b + r[5] * c)
        dz = amount * fade * (r[6] * a + r[7] * b + r[8] * c)
        if abs(dx) + abs(dy) + abs(dz) < np.inf:
            means[i, 0] += dx
            means[i, 1] += dy
            means[i, 2] += dz
