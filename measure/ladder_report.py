"""A measured ladder as JSON, as rows of a table, and as a plot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .ladder import Ladder, Measured, is_clear
from .tables import describe_machine

MIB = 1 << 20

COLUMNS = ("shortcut", "ms", "quartiles", "of baseline", "PSNR dB", "SSIM", "largest", "MiB")


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
        "rungs": [_rung_json(one) for one in ladder.rungs],
    }


def _rung_json(one: Measured) -> dict[str, Any]:
    numbers = {
        "ms": one.ms,
        "ms_quartiles": list(one.spread),
        "ratio": one.ratio,
        "psnr": one.psnr,
        "ssim": one.ssim,
        "max_error": one.max_error,
    }
    return {
        "knob": one.rung.knob,
        "value": one.rung.value,
        "renderer": one.rung.artist.name,
        "options": list(one.rung.options),
        **{name: _finite(value) for name, value in numbers.items()},
        "memory": one.memory,
        "pareto": one.pareto,
    }


def _finite(value: Any) -> Any:
    if isinstance(value, list):
        return [_finite(part) for part in value]
    return value if math.isfinite(value) else None


def ratio_text(one: Measured, ladder: Ladder) -> str:
    """The ratio of times; "same" where it is within the noise."""
    if one is ladder.baseline:
        return "1"
    if not math.isfinite(one.ratio):
        return "-"
    if not is_clear(one, ladder.noise):
        return f"same ({one.ratio:.2f})"
    return f"{one.ratio:.2f}"


def rung_name(one: Measured) -> str:
    """ "sh-degree 1"; a renderer with its defaults by its name."""
    return one.rung.value if one.rung.knob == "renderer" else f"{one.rung.knob} {one.rung.value}"


def cells(one: Measured, ladder: Ladder) -> list[str]:
    """A row of COLUMNS."""
    low, high = one.spread
    return [
        rung_name(one),
        f"{one.ms:.1f}",
        f"{low:.0f} to {high:.0f}",
        ratio_text(one, ladder),
        "exact" if one.psnr == math.inf else f"{one.psnr:.1f}",
        f"{one.ssim:.4f}",
        f"{one.max_error:.1e}",
        f"{one.memory / MIB:.0f}",
    ]


def plot(ladder: Ladder, path: Path, *, title: str) -> None:
    """Time against accuracy, a mark a rung, the Pareto front as a line: written by matplotlib to `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import FuncFormatter, NullFormatter

    from ..scene.files.atomic import atomic_write

    figure = Figure(figsize=(10, 6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    known = [one for one in ladder.rungs if math.isfinite(one.ratio) and not math.isnan(one.psnr)]
    top = max((one.psnr for one in known if math.isfinite(one.psnr)), default=100.0) + 6
    knobs = list(dict.fromkeys(one.rung.knob for one in known))
    artists = list(dict.fromkeys(one.rung.artist.name for one in known))
    axes.axvspan(1 / (1 + ladder.noise), 1 + ladder.noise, color="0.93", zorder=0, lw=0)
    axes.axhline(VISIBLE_DB, color="0.8", lw=1, ls=":", zorder=0)
    for one in known:
        colour, marker = f"C{knobs.index(one.rung.knob) % 10}", MARKERS[artists.index(one.rung.artist.name)]
        height = min(one.psnr, top)
        low, high = np.percentile(one.ratios, [25, 75])
        axes.plot([low, high], [height, height], color=colour, alpha=0.3, lw=3, solid_capstyle="round")
        size = 9 if one.pareto else 6
        axes.plot(one.ratio, height, marker, color=colour, ms=size, mec="white", mew=0.8)
        axes.annotate(
            rung_name(one),
            (one.ratio, height),
            xytext=(6, 4),
            textcoords="offset points",
            fontsize=8 if one.pareto else 6,
            color="black" if one.pareto else "0.45",
        )
    if front := sorted((one.ratio, min(one.psnr, top)) for one in known if one.pareto):
        axes.step(*zip(*front, strict=True), where="post", color="0.55", lw=1, zorder=0.5)
    for number, knob in enumerate(knobs):
        axes.plot([], [], "o", color=f"C{number % 10}", label=knob)
    for number, name in enumerate(artists):
        axes.plot([], [], MARKERS[number], color="0.4", label=f"drawn by {name}")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    base = ladder.baseline
    axes.set_xlabel(
        f"time a frame, of {base.rung.artist.name}'s {base.ms:.0f} ms"
        f" (bars: quartiles; grey: noise floor, ±{ladder.noise:.0%})"
    )
    axes.set_ylabel("PSNR against the float64 truth, dB")
    axes.set_title(title, fontsize=11)
    axes.grid(alpha=0.2)
    axes.legend(fontsize=7, loc="best", ncols=2)
    with atomic_write(path) as file:
        figure.savefig(file, format=path.suffix.lower().lstrip("."))


MARKERS = ("o", "s", "^", "D", "v")

VISIBLE_DB = 40.0
"""About where differences become hard to see: a dotted line."""
