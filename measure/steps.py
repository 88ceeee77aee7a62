"""What a governor can choose from: measured shortcuts, alone and with fewer pixels, each at its price."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .rungs import Measured

SCALES = tuple(2 ** (-k / 12) for k in range(25))
"""Of the picture's sides, from 1 to 1/4; times of neighbours are at most 11 % apart, so that one of them is
within a tenth of any budget that lies between."""

SHARES = tuple(round(0.05 * k, 2) for k in range(1, 20))
"""Of the splats, between those that are measured."""

LEAST_ERROR = 1e-14
"""Mean squared, for logarithms of errors that are 0: rounding alone makes more."""

UNPRICED_PIXELS = 0.8
"""The share of a frame that goes with its pixels, as long as nothing was measured."""


@dataclass(frozen=True, kw_only=True)
class Shortcut:
    """One way to draw in less time."""

    choices: tuple[tuple[str, str], ...]
    """Knob and value, as typed."""
    scale: float
    """Of the picture's sides."""
    kept: float = 1.0
    """Share of the splats that is drawn, of those that contribute most."""
    ms: float
    error: float | None
    """Mean squared error of colours against the truth; None: not measured."""

    @property
    def is_exact(self) -> bool:
        """Leaves nothing out."""
        return not self.choices and self.scale == 1 and self.kept == 1

    @property
    def note(self) -> str:
        """For the user: "40 % of the splats, 71 % of the size, about 35 dB"."""
        parts = [f"{name} {text}" for name, text in self.choices]
        if self.kept < 1:
            parts.append(f"{self.kept:.0%} of the splats")
        if self.scale < 1:
            parts.append(f"{self.scale:.0%} of the size")
        if self.error is None:
            parts.append("error not measured")
        elif self.error > 0:
            parts.append(f"about {-10 * math.log10(self.error):.0f} dB")
        return ", ".join(parts)


def priced(baseline: Measured, rungs: Sequence[Measured]) -> tuple[Shortcut, ...]:
    """Steps from what a ladder found out about one renderer, slowest first, none beaten by another.

    Of each rung with one knob turned, and of the baseline, a step a scale. What half the sides save and
    cost is measured; in between, time goes with the pixels and blur grows with their size. Where time did
    not suffice to measure it, fewer pixels are taken as `unpriced` does, when no measured rung will do.
    """
    own = [one for one in rungs if one.rung.artist.name == baseline.rung.artist.name]
    half = next((one for one in own if (one.rung.knob, one.rung.value) == ("resolution", "1/2")), None)
    share, halving = UNPRICED_PIXELS, None
    if half is not None and math.isfinite(half.ratio):
        share = min(max((1 - half.ratio) / (1 - 0.5**2), 0.0), 1.0)
        halving = max(squared(half.psnr) - squared(baseline.psnr), 0.0)
    steps = [
        Shortcut(
            choices=choices,
            kept=kept,
            scale=scale,
            ms=baseline.ms * ratio * (1 - share + share * scale**2),
            error=error + (halving or 0.0) * (1 / scale - 1),
        )
        for choices, kept, ratio, error in _alternatives(baseline, own)
        for scale in (SCALES if halving is not None else SCALES[:1])
    ]
    return best_of(steps if halving is not None else [*steps, *unpriced(baseline.ms)[1:]])


Alternative = tuple[tuple[tuple[str, str], ...], float, float, float]
"""Choices, share of the splats, time by the baseline's, mean squared error."""


def _alternatives(baseline: Measured, own: Sequence[Measured]) -> list[Alternative]:
    """The baseline, each rung with one knob turned, and between the shares of splats that were measured
    others: time goes with the share, and the error's logarithm too."""
    found: list[Alternative] = [((), 1.0, 1.0, squared(baseline.psnr))]
    shares = {1.0: (1.0, squared(baseline.psnr))}
    for one in own:
        if one is baseline or not math.isfinite(one.ratio) or one.rung.knob in WHOLE:
            continue
        if one.rung.knob == "keep":
            shares[one.rung.plan.kept] = (one.ratio, squared(one.psnr))
        else:
            found.append((((one.rung.knob, one.rung.value),), 1.0, one.ratio, squared(one.psnr)))
    measured = sorted(shares)
    ratios, errors = zip(*(shares[share] for share in measured), strict=True)
    between = [share for share in SHARES if share > measured[0]]
    for share in sorted({*measured[:-1], *between}):
        log_error = np.interp(share, measured, np.log(np.maximum(errors, LEAST_ERROR)))
        found.append(((), share, float(np.interp(share, measured, ratios)), float(np.exp(log_error))))
    return found


WHOLE = ("renderer", "resolution")
"""Rungs that are no knob of their own here."""


def unpriced(milliseconds: float) -> tuple[Shortcut, ...]:
    """Fewer pixels only, from what a full frame takes: good enough until prices are known."""
    return tuple(
        Shortcut(
            choices=(),
            scale=scale,
            ms=milliseconds * (1 - UNPRICED_PIXELS + UNPRICED_PIXELS * scale**2),
            error=None if scale < 1 else 0.0,
        )
        for scale in SCALES
    )


def best_of(steps: Sequence[Shortcut]) -> tuple[Shortcut, ...]:
    """Those that no other beats in time and error both, slowest first."""
    best: list[Shortcut] = []
    for step in sorted(steps, key=lambda one: (one.ms, badness(one))):
        if not best or badness(step) < badness(best[-1]):
            best.append(step)
    return tuple(reversed(best))


def badness(step: Shortcut) -> float:
    """Mean squared error; where it is not measured, worse than any, and the more so the fewer the pixels."""
    return step.error if step.error is not None else 1 / step.scale


def squared(psnr: float) -> float:
    """Mean squared error of so many dB."""
    return 10 ** (-psnr / 10)
