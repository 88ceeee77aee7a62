"""A measured ladder as JSON and as rows of a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from .ladder import Ladder, Measured, is_clear
from .tables import describe_machine

MIB = 1 << 20

COLUMNS = ("shortcut", "ms", "time", "PSNR", "SSIM", "largest", "popping", "MiB")


def as_json(ladder: Ladder, about: Mapping[str, Any]) -> dict[str, Any]:
    """The ladder as scripts may rely on it; `about`: what was drawn (scene, size, truth, ...).

    Infinite PSNR is null: JSON has no infinity, and no error has no decibels.
    """
    base = ladder.baseline.rung
    return {
        "machine": describe_machine(),
        **about,
        "baseline": {"renderer": base.artist.name, "options": list(base.options), "ms": ladder.baseline.ms},
        "noise": ladder.noise if math.isfinite(ladder.noise) else None,
        "views": ladder.views,
        "rounds": ladder.rounds,
        "complete": ladder.complete,
        "rungs": [_rung_json(one, ladder.noise) for one in ladder.rungs],
    }


def _rung_json(one: Measured, noise: float) -> dict[str, Any]:
    numbers = {
        "ms": one.ms,
        "ms_quartiles": list(one.spread),
        "ratio": one.ratio,
        "psnr": one.psnr,
        "ssim": one.ssim,
        "max_error": one.max_error,
        "popping": one.popping,
    }
    return {
        "knob": one.rung.knob,
        "value": one.rung.value,
        "renderer": one.rung.artist.name,
        "options": list(one.rung.options),
        **{name: _finite(value) for name, value in numbers.items()},
        "memory": one.memory,
        "clear": is_clear(one, noise),
        "pareto": one.pareto,
    }


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return value if math.isfinite(value) else None


def ratio_text(one: Measured, ladder: Ladder) -> str:
    """Time by the baseline's: "0.80 x"; "same" where no difference may be claimed."""
    if one is ladder.baseline:
        return "1 x"
    if not math.isfinite(one.ratio):
        return "-"
    if not is_clear(one, ladder.noise):
        return "same"
    return f"{one.ratio:.2f} x"


def rung_name(one: Measured) -> str:
    """ "sh-degree 1"; a renderer with its defaults by its name."""
    return one.rung.value if one.rung.knob == "renderer" else f"{one.rung.knob} {one.rung.value}"


def cells(one: Measured, ladder: Ladder) -> list[str]:
    """A row of COLUMNS."""
    low, high = one.spread
    return [
        rung_name(one),
        f"{one.ms:.{int(one.ms < 100)}f} ±{(high - low) / 2:.0f}",
        ratio_text(one, ladder),
        "exact" if one.psnr == math.inf else f"{one.psnr:.1f}",
        f"{one.ssim:.4f}",
        f"{one.max_error:.2g}",
        f"{one.popping:.2g}",
        f"{one.memory / MIB:.0f}",
    ]
