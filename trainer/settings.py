"""Every number of the training recipe, and how it changes as training goes on.

Times are shares of the run, so that a run of 2,000 steps is a short version of the same curve. The
paper's numbers are those of a run of 30,000 (Kerbl et al. 2023, section 7 and its code).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from splatview.scene import ImageModel
from splatview.scene.edits import Crop
from splatview.scene.gaussians import SH_COEFFICIENTS
from splatview.trainer.adam_kernels import REST_DIVISOR, Rates
from splatview.trainer.free_space import (
    FEW_VIEWS,
    FEW_VIEWS_ROUNDS,
    FREE_SPACE,
    LEAST_SHOWN,
    LEAST_VISIBILITY,
    MAX_SIZE,
    MOST_OF_ONE,
)
from splatview.trainer.loss import SSIM_WEIGHT
from splatview.trainer.recipe import FULL_REG_LOSS, GROWTH_LOSS
from splatview.trainer.strategies import STRATEGIES, StrategySettings
from splatview.trainer.strategies.ops import PAPER_ITERATIONS

ALPHA_WEIGHT = 0.3
"""See `TrainSettings.alpha_weight`. One minute on transparent pictures of 200x200, a third held out: without
it opacities of 0.007 (`playbot`) and 0.164 (`skull`) hang on the average where the photos are empty, with it,
and `--coarse auto`, of 0.005 and 0.004. Chosen on `playbot`: 32.8, 33.2 and 33.2 dB with 0.1, 0.3 and 1.
Dropped, for 5 % of a step: a background drawn anew for each step, 33.1 dB and 0.005 there, 29.1 dB and 0.003
on `skull`, which has 29.2 dB without. Dropped: that opaque photos, too, show nothing transparent, by the same
weight, so that no hole stands for what is dark. A minute, three splits each: `miku 12 near` +0.4 and `far`
0.0 dB, but `kermit` -1.4, `bust` -1.3 and `toy` -0.8: more stands before what other cameras see."""


@dataclass(frozen=True, kw_only=True)
class TrainSettings(StrategySettings):
    """The recipe. Equal settings, photos, points and threads train equal scenes.

    Raises:
        ValueError: a value makes no sense; the message names it.
    """

    iterations: int | None = PAPER_ITERATIONS
    """Steps of the whole run; None: as many as the minutes allow."""
    minutes: float | None = None
    """Wall-clock length of the whole run; with both, the one that ends first."""
    batch: int = 1
    """Photos per step, whose gradients are averaged. See `photo_size.automatic_batch`."""
    growth_batch: int = 1
    """The same while splats grow, if it is more, where a run finds early that photos are not met
    so well as `growth_loss`. See `photo_size.automatic_growth_batch`."""
    growth_loss: float = GROWTH_LOSS
    """Photo loss, a running mean, above which steps look at `growth_batch` photos."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    backdrop: Literal["auto", "off"] = "auto"
    """Whether photos that show the background as a plain colour, connected to their border, are known to be
    empty there. See `backdrop`."""
    surround: tuple[float, float, float] | None = None
    """Colour for what no photo shows, where photos show something everywhere: behind the scene in place of
    the background, and in a step another one about it; None: the background. See `backdrop`."""
    model: ImageModel = field(default_factory=ImageModel)
    ssim_weight: float = SSIM_WEIGHT
    alpha_weight: float = ALPHA_WEIGHT
    """Weight of the opacity of transparent photos in the loss: of the mean |difference| to the scene's."""
    exposure: Literal["auto", "on", "off"] = "auto"
    """Whether each photo's exposure is learnt; auto: where photos differ, see `exposure`."""
    shading: Literal["auto", "on", "off"] = "off"
    """Whether a coarse map of gains is learnt for each photo; auto: where photos differ, see `shading`."""
    outliers: Literal["auto", "off"] = "auto"
    """Whether photos that disagree with the others are left out, see `outliers`."""
    transients: Literal["auto", "off"] = "auto"
    """Whether parts of photos that the others contradict are masked, see `transients`."""
    start: Literal["auto", "points", "stereo"] = "auto"
    """Where splats begin: at the capture's points, or also where stereo finds surfaces; auto: by stereo alone
    where the capture has no points, by both where they are few. See `stereo`."""
    sky: Literal["auto", "on", "off"] = "auto"
    """Whether far splats are added for what photos show at infinity; auto: where enough of them is, see
    `sky`."""
    resolution: tuple[tuple[float, int], ...] | None = ((0.3, 2),)
    """(until this share of the run, photos are smaller by this factor), in order; None: by evidence, see
    `progressive`."""

    sh_degree: int = 3
    sh_every: float = 1000 / PAPER_ITERATIONS
    """Share of the run after which one more band is trained."""

    means_rate: float = 4.8e-4
    """Times the extent of the scene, at the start (three times the paper's: short runs move farther);
    exponential in between."""
    means_rate_end: float = 6e-6
    """Times the extent of the scene, at the end."""
    far_from: float = math.inf
    """Times `Capture.usual_distance`, at the start: from so far from the middle of the cameras on means move
    the faster, in proportion to their distance; inf: all alike. See `recipe.automatic_far_from`."""
    far_from_end: float = 1.0
    """The same at the end of the run, exponential in between; if it is less, that at the start."""
    quats_rate: float = 1e-3
    log_scales_rate: float = 5e-3
    log_scales_rate_end: float | None = None
    """At the end, exponential in between; None: the rate settles with the others. See `adam.FAST_SCALES`."""
    opacity_logits_rate: float = 5e-2
    sh_rate: float = 2.5e-3
    """Rate of the constant band."""
    sh_divisor: float = REST_DIVISOR
    """Of that rate for the higher bands. See `recipe.automatic_sh_divisor`."""
    settle_from: float = 0.5
    """Share of the run from which rates go down that have no end of their own."""
    settle_to: float = 0.1
    """Factor of those rates at the end, reached exponentially: the last photos do not pull the scene
    their way. Dropped: the mean of the last fifth of the run beside it, `banana` 28.76 and 28.86 dB in
    place of 28.76 and 28.87 (two seeds), `miku` 30.22 and 30.22, `skull RGBA 100` 33.36 and 33.39."""
    max_aspect: float = math.inf
    """No splat is longer than so many times its middle axis. See `recipe.automatic_max_aspect` and
    `recipe.FULL_REG_LOSS`."""
    dropout: float = 0.0
    """Share of the splats, drawn anew for each photo, that a step at the end of the run does without; it
    grows from 0 in proportion to the run. See `recipe.automatic_dropout` and `recipe.FULL_REG_LOSS`."""
    free_space: float = FREE_SPACE
    """Share of the depth at which what a photo shows begins, nearer than which no splat may stand before its
    camera; 0: anywhere. See `free_space`."""
    max_size: float = MAX_SIZE
    """Standard deviation that a splat has at most along any axis, in distances to a camera whose photo shows
    it. See `free_space.automatic_max_size`."""
    least_shown: float = LEAST_SHOWN
    """Of a photo, that a splat must contribute to all photos together, or it goes when density control ends
    and as the run does; 0: what none shows goes nowhere. See `free_space`."""
    least_visibility: float = LEAST_VISIBILITY
    """Share of what a splat would contribute to the photos with nothing before it, that it must contribute,
    or it goes too, at the end only where photos do not miss it; 0: what hides behind others may stay. See
    `free_space`."""
    most_of_one: float = MOST_OF_ONE
    """Share of a splat's contributions to all photos, of which one photo may have more only where nothing
    that others show is behind it: else it goes as the run ends, unless the photos are met so well that
    nothing has to stand for missing ones (`full_reg_loss`); 1: all may stay. See `free_space`."""
    withheld: float = 0.0
    """Share of the photos that a run does without at first, to see whether one scene is to take its time or
    `shorter` ones follow; 0: none, `met_loss` decides. See `withheld` and `recipe.automatic_tried`."""
    few_views: int = FEW_VIEWS
    """Splats that lie in the frames of at most so many photos stop learning after `few_views_rounds`, where
    there are more than five times as many photos; 0: none. See `free_space`."""
    few_views_rounds: float = FEW_VIEWS_ROUNDS
    """Times that every photo was looked at."""
    ensemble: int = 1
    """Scenes at most that are trained one after the other, where steps end each before the minutes are over;
    their mean then teaches a last one, see `ensemble`. 1: one alone."""
    shorter: tuple[int, int] | None = None
    """Steps and splats of each of several scenes, where there is no time for several of `iterations` and
    `max_splats`, unless one that takes its time still learns; None: those. See `recipe.automatic_shorter`."""
    met_loss: float = FULL_REG_LOSS
    """Photo loss, a running mean, below which photos are met well. See `recipe.automatic_met_loss`."""
    visible_only: bool = True
    """Whether Adam moves only the splats that reach into the photo; False: all, by their averages."""

    strategy: str = next(iter(STRATEGIES))
    """Name in `STRATEGIES`."""
    cut: tuple[tuple[Crop, ...], ...] = ()
    """What is cut away for good: a splat stays as long as each of these sets of crops leaves it, see
    `scene.edits.cropped_in`."""

    def __post_init__(self) -> None:
        if self.iterations is None and self.minutes is None:
            raise ValueError("iterations or minutes must be given")
        for name in ("iterations", "minutes", "batch", "growth_batch", "max_splats", "least_refine_steps"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise ValueError(f"{name} must be above 0, got {value}")
        if self.start not in ("auto", "points", "stereo"):
            raise ValueError(f"start must be auto, points or stereo, got {self.start!r}")
        if self.sky not in ("auto", "on", "off"):
            raise ValueError(f"sky must be auto, on or off, got {self.sky!r}")
        for name in ("backdrop", "outliers", "transients"):
            if getattr(self, name) not in ("auto", "off"):
                raise ValueError(f"{name} must be auto or off, got {getattr(self, name)!r}")
        if not self.max_aspect >= 1:
            raise ValueError(f"max_aspect must be at least 1, got {self.max_aspect}")
        if not 1 <= self.sh_divisor < math.inf:
            raise ValueError(f"sh_divisor must be at least 1 and finite, got {self.sh_divisor}")
        if not 0 <= self.free_space < 1:
            raise ValueError(f"free_space must be at least 0 and below 1, got {self.free_space}")
        for name in ("least_shown", "least_visibility"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 0 and below 1, got {getattr(self, name)}")
        if not 0.5 <= self.most_of_one <= 1:
            raise ValueError(f"most_of_one must be 0.5 to 1, got {self.most_of_one}")
        for name in ("far_from", "far_from_end"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if not self.max_size > 0:
            raise ValueError(f"max_size must be above 0, got {self.max_size}")
        if not self.few_views >= 0:
            raise ValueError(f"few_views must not be negative, got {self.few_views}")
        if not self.few_views_rounds >= 0:
            raise ValueError(f"few_views_rounds must not be negative, got {self.few_views_rounds}")
        if not self.ensemble >= 1:
            raise ValueError(f"ensemble must be at least 1, got {self.ensemble}")
        if self.shorter is not None and not min(self.shorter) >= 1:
            raise ValueError(f"shorter must be steps and splats above 0, got {self.shorter}")
        if not 0 <= self.withheld <= 0.5:
            raise ValueError(f"withheld must be 0 to 0.5, got {self.withheld}")
        if not 0 <= self.full_reg_opacity < 1:
            raise ValueError(f"full_reg_opacity must be at least 0 and below 1, got {self.full_reg_opacity}")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout must be at least 0 and below 1, got {self.dropout}")
        if self.strategy not in STRATEGIES:
            raise ValueError(f"strategy must be one of {', '.join(STRATEGIES)}, got {self.strategy!r}")
        if not 0 <= self.sh_degree < len(SH_COEFFICIENTS):
            raise ValueError(f"sh_degree must be 0 to 3, got {self.sh_degree}")
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed must be at least 0 and below 2**63, got {self.seed}")

    @property
    def trains_several(self) -> bool:
        """Whether a run may train several scenes: one has an end before that of the minutes."""
        ends = self.iterations is not None or self.shorter is not None
        return self.ensemble > 1 and self.minutes is not None and ends

    def progress(
        self, iteration: int, seconds: float, prepared: float = 0.0, *, shorter: bool = False
    ) -> float:
        """The share of the run that is over, 0 to 1. `prepared`: of the seconds, those before the first step,
        which are no progress: so a run that its steps end is the same, however many minutes it was given.
        `shorter`: by the steps of that name."""
        steps = self.shorter[0] if shorter and self.shorter else self.iterations
        by_steps = 0.0 if steps is None else iteration / steps
        by_clock = 0.0
        if self.minutes is not None:
            length = 60 * self.minutes
            by_clock = (seconds - prepared) / (length - prepared) if seconds < length else 1.0
        return min(max(by_steps, by_clock), 1.0)

    def rates(self, progress: float, extent: float) -> Rates:
        """Learning rates at a share of the run, for a scene of this extent."""
        settled = max(progress - self.settle_from, 0.0) / max(1 - self.settle_from, 1e-9)
        factor, scales, end = self.settle_to**settled, self.log_scales_rate, self.log_scales_rate_end
        return Rates(
            means=extent * self.means_rate * (self.means_rate_end / self.means_rate) ** progress,
            quats=factor * self.quats_rate,
            log_scales=factor * scales if end is None else scales * (end / scales) ** progress,
            opacity_logits=factor * self.opacity_logits_rate,
            sh=factor * self.sh_rate,
        )

    def far_from_at(self, progress: float) -> float:
        """`far_from` at a share of the run."""
        if not self.far_from < self.far_from_end:
            return self.far_from
        return self.far_from * (self.far_from_end / self.far_from) ** progress

    def sh_degree_at(self, progress: float) -> int:
        """The highest SH degree in training at a share of the run."""
        return (
            min(self.sh_degree, int(progress / self.sh_every + 1e-9)) if self.sh_every > 0 else self.sh_degree
        )


RECORDED_NAMES = {
    "resolution": "coarse",
    "max_aspect": "elongation",
    "dropout": "drop",
    "visible_only": "seen_only",
    "opacity_reg": "opacity_pull",
    "scale_reg": "scale_pull",
    "reg_end": "pull_end",
}
"""Names of fields in checkpoints where they are not those of `TrainSettings`."""


WITHOUT_WORD = {
    "alpha_weight": 0.0,
    "backdrop": "off",
    "full_reg_loss": 0.0,
    "full_reg_opacity": 0.0,
    "sky": "off",
    "surround": None,
    "outliers": "off",
    "transients": "off",
    "free_space": 0.0,
    "least_shown": 0.0,
    "least_visibility": 0.0,
    "most_of_one": 1.0,
    "max_size": math.inf,
    "far_from": math.inf,
    "far_from_end": 1.0,
    "withheld": 0.0,
    "few_views": 0,
    "few_views_rounds": 0.0,
    "ensemble": 1,
    "shorter": None,
    "met_loss": FULL_REG_LOSS,
}
"""Fields that older checkpoints do not have, as their runs went."""


def recorded(settings: TrainSettings) -> dict[str, Any]:
    """The settings as checkpoints have them: flat, by their recorded names."""
    return {RECORDED_NAMES.get(name, name): value for name, value in asdict(settings).items()}


def from_recorded(values: Mapping[str, Any]) -> TrainSettings:
    """The inverse, of plain JSON. Raises ValueError, TypeError and KeyError where it is damaged."""
    fields = {ours: values[theirs] for ours, theirs in RECORDED_NAMES.items()}
    fields |= WITHOUT_WORD
    fields |= {name: value for name, value in values.items() if name not in RECORDED_NAMES.values()}
    fields["model"] = ImageModel(**fields["model"])
    fields["no_growth"] = tuple(_crop(region) for region in fields["no_growth"])
    fields["cut"] = tuple(tuple(_crop(crop) for crop in crops) for crops in fields["cut"])
    fields["background"] = tuple(fields["background"])
    fields["surround"] = fields["surround"] and tuple(fields["surround"])
    fields["shorter"] = fields["shorter"] and tuple(fields["shorter"])
    if fields["resolution"] is not None:
        fields["resolution"] = tuple((float(until), int(factor)) for until, factor in fields["resolution"])
    return TrainSettings(**fields)


def _crop(region: dict[str, Any]) -> Crop:
    values: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in region.items()
    }
    return Crop(**values)
