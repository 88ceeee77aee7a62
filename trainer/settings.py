"""Every number of the training recipe, and how it changes as training goes on.

Times are shares of the run, so that a run of 2,000 steps is a short version of the same curve. The
paper's numbers are those of a run of 30,000 (Kerbl et al. 2023, section 7 and its code).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from splatview.scene import ImageModel
from splatview.scene.edits import Crop
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.trainer.adam import Pull, Rates
from splatview.trainer.loss import SSIM_WEIGHT

PAPER_ITERATIONS = 30_000


PIXELS_PER_SPLAT = 30
"""With more splats, few photos are learnt by heart: on `banana` at a quarter of its size, 12,000 splats
(25 pixels each) score 0.1 dB more on held-out photos than 25,000, and 1.7 dB less on those trained."""

SPLATS_FOR_A_MINUTE = 20_000
"""What a budget of one minute can train; a longer one by the square root, as steps become slower too."""

LEAST_LIMIT, MOST_LIMIT = 2_000, 2_000_000


def automatic_limit(pixels: int, minutes: float | None = None) -> int:
    """A sensible `max_splats` for photos of so many pixels together, and a run of so many minutes."""
    limit = min(max(pixels // PIXELS_PER_SPLAT, LEAST_LIMIT), MOST_LIMIT)
    if minutes is not None:
        limit = min(limit, max(round(SPLATS_FOR_A_MINUTE * math.sqrt(minutes)), LEAST_LIMIT))
    return limit


LEAST_PULL, MOST_PULL = 0.01, 0.1
"""The first is that of Kheradmand et al. 2024."""


def automatic_pull(photos: int) -> float:
    """Sensible `opacity_pull` and `scale_pull` for so many photos: the fewer, the stronger.

    Splats that serve few views then fade. On held-out photos of `banana` (13 to train on) 0.1 scores
    0.6 dB more than 0.01, on those of `miku` (84) 0.6 dB less.
    """
    return min(max(1.3 / max(photos, 1), LEAST_PULL), MOST_PULL)


LEAST_DROP, MOST_DROP = 0.05, 0.2
"""The second is that of Park et al. 2025, for 3 to 24 photos."""


def automatic_drop(photos: int) -> float:
    """A sensible `drop` for so many photos: the fewer, the more; none from about fifty on.

    On held-out photos of `banana` (13 to train on) after 8,000 steps at half size 0.2 scores 0.2 dB more
    than none, and 0.6 dB more after 4,000 at a quarter.
    """
    share = min(2.6 / max(photos, 1), MOST_DROP)
    return share if share >= LEAST_DROP else 0.0


FEW_PHOTOS = 50

LONGEST_OF_FEW = 6.0


def automatic_elongation(photos: int) -> float:
    """A sensible `elongation` for so many photos: where they are few, needles make out a texture in the
    photos, and streaks in between.

    On held-out photos of `banana` (13 to train on) after 8,000 steps at half size 6 scores 0.24 dB and 0.02
    SSIM more than none.
    """
    return LONGEST_OF_FEW if photos < FEW_PHOTOS else math.inf


STEPS_PER_PHOTO, LEAST_STEPS = 600, 3_000


def automatic_steps(photos: int) -> int | None:
    """Steps after which a run on so few photos should be over; None: they are not few.

    On held-out photos of `banana` (13 to train on, half size) runs of 8,000 and of 16,000 steps both score
    28.74 dB; without a limit to elongation they score 28.8 and 28.2 dB, and one of 67,000 steps, with neither
    dropping nor fading pulls, 26.6 dB: what is left to learn by then is single photos.
    """
    return max(STEPS_PER_PHOTO * photos, LEAST_STEPS) if photos < FEW_PHOTOS else None


LEAST_PULLED = 0.1
"""Pixels, seen from as far as the extent: thinner splats are not pulled to be thinner still."""


@dataclass(frozen=True, kw_only=True)
class TrainSettings:
    """The recipe. Equal settings, photos, points and threads train equal scenes.

    Raises:
        ValueError: a value makes no sense; the message names it.
    """

    iterations: int | None = PAPER_ITERATIONS
    """Steps of the whole run; None: as many as the minutes allow."""
    minutes: float | None = None
    """Wall-clock length of the whole run; with both, the one that ends first."""
    seed: int = 0
    batch: int = 1
    """Photos a step, whose gradients are averaged."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    model: ImageModel = field(default_factory=ImageModel)
    ssim_weight: float = SSIM_WEIGHT
    exposure: Literal["auto", "on", "off"] = "auto"
    """Whether each photo's exposure is learnt; auto: where photos differ, see `exposure`."""
    coarse: tuple[tuple[float, int], ...] = ((0.3, 2),)
    """(until this share of the run, photos are smaller by this factor), in order."""

    sh_degree: int = 3
    sh_every: float = 1000 / PAPER_ITERATIONS
    """Share of the run after which one more band is trained."""

    means_rate: float = 4.8e-4
    """Times the extent of the scene, at the start (three times the paper's: short runs move farther)..."""
    means_rate_end: float = 6e-6
    """... and at the end, exponentially in between."""
    quats_rate: float = 1e-3
    log_scales_rate: float = 5e-3
    opacity_logits_rate: float = 5e-2
    sh_rate: float = 2.5e-3
    """Of the constant band; higher bands have a twentieth."""
    settle_from: float = 0.5
    """From this share of the run on all rates but that of the means, which has its own end, go down..."""
    settle_to: float = 0.1
    """... exponentially, to this factor at the end: the last photos do not pull the scene their way."""
    elongation: float = math.inf
    """No splat is longer than so many times its middle axis. See `automatic_elongation`."""
    drop: float = 0.0
    """Share of the splats, drawn anew for each photo, that a step at the end of the run does without; it
    grows from 0 in proportion to the run. See `automatic_drop`."""
    seen_only: bool = True
    """Whether Adam moves only the splats that reach into the photo; False: all, by their averages."""

    strategy: Literal["classic", "mcmc"] = "mcmc"
    refine_from: float = 500 / PAPER_ITERATIONS
    refine_until: float = 15_000 / PAPER_ITERATIONS
    refine_every: float = 100 / PAPER_ITERATIONS
    least_refine_steps: int = 50
    """Steps between refinements at least: gradients are averaged over some photos even in short runs."""
    max_splats: int = 1_000_000
    """Density control adds no splats beyond this."""
    no_growth: tuple[Crop, ...] = ()
    """Where density control multiplies none: inside these shapes, those switched off aside. What they keep
    does not matter; halves of a large neighbour may still reach in."""
    cut: tuple[tuple[Crop, ...], ...] = ()
    """What is cut away for good: a splat stays as long as each of these sets of crops leaves it, see
    `scene.crop.cropped_in`."""
    grow_for: float = 12_000 / PAPER_ITERATIONS
    """mcmc: share of the run, from `refine_from` on, in which the number grows to `max_splats`."""
    noise: float = 5e5
    """mcmc: noise on positions, in units of their rate."""
    opacity_pull: float = LEAST_PULL
    """mcmc: weight of the mean opacity in the loss; and..."""
    scale_pull: float = LEAST_PULL
    """... of the mean scale, world units over the extent. See `automatic_pull`."""
    pull_end: float = 0.1
    """mcmc: factor of both at the end of the run, reached exponentially. Adam moves what only a pull moves
    at full speed: at constant strength a run of 67,000 steps on 13 photos ended with a median opacity of
    0.01 and half of the splats thinner than a thousandth of a pixel, 1.4 dB below one of 4,000 steps."""
    absolute_gradient: bool = False
    """classic: add up a splat's gradient over pixels by absolute value (Ye et al. 2024, AbsGS)."""

    def __post_init__(self) -> None:
        if self.iterations is None and self.minutes is None:
            raise ValueError("iterations or minutes must be given")
        for name in ("iterations", "minutes", "batch", "max_splats", "least_refine_steps"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"{name} must be above 0, got {value}")
        if not self.elongation >= 1:
            raise ValueError(f"elongation must be at least 1, got {self.elongation}")
        if not 0 <= self.drop < 1:
            raise ValueError(f"drop must be at least 0 and below 1, got {self.drop}")
        if not 0 <= self.sh_degree < len(SH_COEFFICIENTS):
            raise ValueError(f"sh_degree must be 0 to 3, got {self.sh_degree}")
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed must be at least 0 and below 2**63, got {self.seed}")

    def progress(self, iteration: int, seconds: float) -> float:
        """The share of the run that is over, 0 to 1."""
        by_steps = 0.0 if self.iterations is None else iteration / self.iterations
        by_clock = 0.0 if self.minutes is None else seconds / (60 * self.minutes)
        return min(max(by_steps, by_clock), 1.0)

    def rates(self, progress: float, extent: float) -> Rates:
        """Learning rates at a share of the run, for a scene of this extent."""
        start, end = math.log(self.means_rate), math.log(self.means_rate_end)
        settled = max(progress - self.settle_from, 0.0) / max(1 - self.settle_from, 1e-9)
        factor = self.settle_to**settled
        return Rates(
            means=extent * math.exp(start + (end - start) * progress),
            quats=factor * self.quats_rate,
            log_scales=factor * self.log_scales_rate,
            opacity_logits=factor * self.opacity_logits_rate,
            sh_constant=factor * self.sh_rate,
            sh_others=factor * self.sh_rate / 20,
        )

    def pull_at(self, progress: float, extent: float, focal: float) -> Pull:
        """The pulls on opacity and scale at a share of the run, for photos of this focal length in px."""
        if self.strategy != "mcmc":
            return Pull()
        factor = self.pull_end**progress
        return Pull(
            factor * self.opacity_pull, factor * self.scale_pull / extent, LEAST_PULLED * extent / focal
        )

    def sh_degree_at(self, progress: float) -> int:
        """The highest SH degree in training at a share of the run."""
        return (
            min(self.sh_degree, int(progress / self.sh_every + 1e-9)) if self.sh_every > 0 else self.sh_degree
        )

    def shrink_at(self, progress: float) -> int:
        """The factor by which photos are smaller at a share of the run."""
        return next((factor for until, factor in self.coarse if progress < until), 1)
