"""The ladder for training: what each shortcut of the recipe gives for the same time.

Runs are handed in: this package trains nothing. All runs of a seed see the photos in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from splatview.measure.machine import finite

STUDENT_95 = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)
"""97.5 % quantiles of Student's t for 1 to 9 degrees of freedom; beyond, 2.2 is a little too wide."""


@dataclass(frozen=True, kw_only=True)
class TrainingRung:
    """One way to train."""

    knob: str
    value: str
    changes: Mapping[str, Any]
    """Fields of the recipe that differ from the baseline; "splats" is a factor on its cap on splats,
    "precision" the dtype of pictures and of what is differentiated through them."""
    needs: str = ""
    """What a capture must have for the change to make one."""


BASELINE = TrainingRung(knob="recipe", value="as it is", changes={})


def _rungs(knob: str, needs: str = "", **values: Mapping[str, Any]) -> tuple[TrainingRung, ...]:
    return tuple(
        TrainingRung(knob=knob, value=value.replace("_", " "), changes=changes, needs=needs)
        for value, changes in values.items()
    )


TRAINING_RUNGS: tuple[TrainingRung, ...] = (
    BASELINE,
    *_rungs("start", "points enough of its own", stereo={"start": "stereo"}),
    *_rungs(
        "resolution",
        full={"resolution": ()},
        by_evidence={"resolution": None},
        half_for_60_percent={"resolution": ((0.6, 2),)},
        quarter_then_half={"resolution": ((0.2, 4), (0.5, 2))},
    ),
    *_rungs("SH degree", constant={"sh_degree": 0}, one={"sh_degree": 1}, at_once={"sh_every": 0.0}),
    *_rungs("SH rate", of_the_paper={"sh_divisor": 20.0}),
    *_rungs("rates of far means", as_of_near_ones={"far_from": math.inf}),
    *_rungs("strategy", classic={"strategy": "classic"}),
    *_rungs("splats", half={"splats": 0.5}, double={"splats": 2.0}),
    *_rungs("exposure", off={"exposure": "off"}, on={"exposure": "on"}),
    *_rungs("shading", off={"shading": "off"}, on={"shading": "on"}),
    *_rungs("outliers", stay={"outliers": "off"}),
    *_rungs("transients", stay={"transients": "off"}),
    *_rungs("opacity of photos", "transparent photos", not_taught={"alpha_weight": 0.0}),
    *_rungs(
        "backdrop",
        "a plain backdrop",
        by_splats={"backdrop": "off", "background": (0.0, 0.0, 0.0)},
        not_known_as_empty={"backdrop": "off"},
    ),
    *_rungs("sky", "a sky", off={"sky": "off"}),
    *_rungs(
        "surround", "photos that show something everywhere, few of them each place", black={"surround": None}
    ),
    *_rungs("free space", "points that photos show", off={"free_space": 0.0}),
    *_rungs("size of splats", half_the_distance={"max_size": 0.5}, any={"max_size": math.inf}),
    *_rungs("unseen splats", stay={"least_shown": 0.0, "least_visibility": 0.0}),
    *_rungs("hidden splats", stay={"least_visibility": 0.0}),
    *_rungs("splats of one photo", stay={"most_of_one": 1.0}),
    *_rungs("frozen splats", none={"few_views": 0}),
    *_rungs(
        "regularisers", whatever_the_loss={"full_reg_loss": 0.0}, however_faint={"full_reg_opacity": 0.0}
    ),
    *_rungs("dropout", off={"dropout": 0.0}),
    *_rungs("elongation", free={"max_aspect": math.inf}),
    *_rungs("steps", as_many_as_fit={"iterations": None}),
    *_rungs("several scenes", one_alone={"ensemble": 1}),
    *_rungs("photos of a step", one={"batch": 1}, two={"batch": 2}),
    *_rungs("optimiser", all_splats={"visible_only": False}),
    *_rungs("precision", float64={"precision": "float64"}),
    *_rungs("early stop", at_1_percent={"early_stop": 1e-2}),
)
"""Baseline first; each other one differs in one knob."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Curve:
    """One run: held-out PSNR against its seconds."""

    seconds: np.ndarray
    """(E,) float64, ascending."""
    psnr: np.ndarray
    """(E,) dB."""
    steps: int
    gaussians: int

    @property
    def final(self) -> float:
        return float(self.psnr[-1]) if len(self.psnr) else math.nan

    def seconds_to(self, target: float) -> float:
        """When the PSNR first was `target` dB, straight lines between evaluations; inf if it never was."""
        above = np.flatnonzero(self.psnr >= target)
        if not len(above):
            return math.inf
        first = int(above[0])
        if first == 0:
            return float(self.seconds[0])
        low, high = float(self.psnr[first - 1]), float(self.psnr[first])
        share = (target - low) / (high - low) if high > low else 1.0
        return float(self.seconds[first - 1] + share * (self.seconds[first] - self.seconds[first - 1]))


@dataclass(kw_only=True)
class Trained:
    """A rung and its runs, one a seed."""

    rung: TrainingRung
    curves: list[Curve] = field(default_factory=list)

    @property
    def psnr(self) -> tuple[float, float]:
        """Mean final PSNR in dB, and the half width of its 95 % interval over seeds; inf for one seed."""
        return mean_and_half_width([curve.final for curve in self.curves])

    def seconds_to(self, target: float) -> tuple[float, float]:
        """Likewise of the seconds to `target` dB; inf where a seed never came there."""
        return mean_and_half_width([curve.seconds_to(target) for curve in self.curves])

    def gain(self, baseline: Trained) -> tuple[float, float]:
        """Likewise of the difference to `baseline`, seed by seed: what photos and chance have in common
        falls out of it."""
        pairs = zip(self.curves, baseline.curves, strict=False)
        return mean_and_half_width([own.final - other.final for own, other in pairs])


def mean_and_half_width(values: Sequence[float]) -> tuple[float, float]:
    """Of a few values: their mean, and the half width of its 95 % interval by Student's t."""
    if not values:
        return math.nan, math.inf
    numbers = np.asarray(values, np.float64)
    if len(numbers) < 2 or not np.isfinite(numbers).all():
        return float(numbers.mean()), math.inf
    quantile = STUDENT_95[len(numbers) - 2] if len(numbers) - 2 < len(STUDENT_95) else 2.2
    return float(numbers.mean()), quantile * float(numbers.std(ddof=1)) / math.sqrt(len(numbers))


TRAINING_COLUMNS = ("shortcut", "PSNR dB", "gain dB", "s to equal", "steps", "splats")


def training_cells(one: Trained, baseline: Trained) -> list[str]:
    """A row of COLUMNS, with 95 % intervals. "s to equal": until the PSNR that the baseline ended with."""
    psnr, width = one.psnr
    gain, gain_width = one.gain(baseline)
    seconds, _ = one.seconds_to(baseline.psnr[0])
    name = "baseline" if one.rung is BASELINE else f"{one.rung.knob}: {one.rung.value}"
    if one is baseline:
        said, equal = "", ""
    else:
        same = not abs(gain) > gain_width
        said = f"same ({gain:+.2f})" if same else f"{gain:+.2f}{_width(gain_width)}"
        equal = "never" if math.isinf(seconds) else f"{seconds:.0f}"
    return [
        name,
        f"{psnr:.2f}{_width(width)}",
        said,
        equal,
        f"{np.mean([curve.steps for curve in one.curves]):,.0f}",
        f"{np.mean([curve.gaussians for curve in one.curves]):,.0f}",
    ]


def _width(value: float) -> str:
    return "" if math.isinf(value) else f" ±{value:.{2 if value < 10 else 0}f}"


def training_as_json(trained: Sequence[Trained]) -> list[dict[str, Any]]:
    """What scripts may rely on; null where there is no number."""
    baseline = trained[0]
    return [
        {
            "knob": one.rung.knob,
            "value": one.rung.value,
            "psnr": finite(one.psnr[0]),
            "psnr_half_width": finite(one.psnr[1]),
            "gain": finite(one.gain(baseline)[0]),
            "gain_half_width": finite(one.gain(baseline)[1]),
            "seconds_to_equal": finite(one.seconds_to(baseline.psnr[0])[0]),
            "runs": [
                {
                    "seconds": curve.seconds.tolist(),
                    "psnr": curve.psnr.tolist(),
                    "steps": curve.steps,
                    "gaussians": curve.gaussians,
                }
                for curve in one.curves
            ],
        }
        for one in trained
    ]
