"""A measured ladder as JSON, as rows of a table, and as a plot."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .ladder import Ladder, Measured
from .tables import describe_machine

MIB = 1 << 20

COLUMNS = (
    "knob",
    "value",
    "ms",
    "spread",
    "of baseline",
    "PSNR dB",
    "SSIM",
    "largest error",
    "MiB",
    "Pareto",
)


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
    if not abs(one.ratio - 1) > ladder.noise:
        return f"same ({one.ratio:.2f})"
    return f"{one.ratio:.2f}"


def cells(one: Measured, ladder: Ladder) -> list[str]:
    """A row of COLUMNS."""
    low, high = one.spread
    return [
        one.rung.knob,
        one.rung.value,
        f"{one.ms:.1f}",
        f"{low:.1f} to {high:.1f}",
        ratio_text(one, ladder),
        "exact" if one.psnr == math.inf else f"{one.psnr:.1f}",
        f"{one.ssim:.4f}",
        f"{one.max_error:.1e}",
        f"{one.memory / MIB:.0f}",
        "yes" if one.pareto else "",
    ]


def plot(ladder: Ladder, path: Path, *, title: str) -> None:
    """Time against accuracy, a mark a rung, the Pareto front as a line: written by matplotlib to `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import ScalarFormatter

    figure = Figure(figsize=(10, 6), dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    known = [one for one in ladder.rungs if math.isfinite(one.ms) and not math.isnan(one.psnr)]
    top = max((one.psnr for one in known if math.isfinite(one.psnr)), default=100.0) + 6
    knobs = list(dict.fromkeys(one.rung.knob for one in known))
    for one in known:
        colour = f"C{knobs.index(one.rung.knob) % 10}"
        marker = MARKERS[
            sorted({r.rung.artist.name for r in known}).index(one.rung.artist.name) % len(MARKERS)
        ]
        low, high = one.spread
        height = min(one.psnr, top)
        axes.plot([low, high], [height, height], color=colour, alpha=0.35, lw=3, solid_capstyle="round")
        axes.plot(one.ms, height, marker, color=colour, ms=9 if one.pareto else 6, mec="white", mew=0.8)
        if one.pareto or one is ladder.baseline:
            name = one.rung.value if one.rung.knob == "renderer" else f"{one.rung.knob} {one.rung.value}"
            label = f"{name} ({one.rung.artist.name})" if one.rung.knob != "renderer" else name
            axes.annotate(label, (one.ms, height), xytext=(7, 5), textcoords="offset points", fontsize=8)
    front = sorted((one.ms, min(one.psnr, top)) for one in known if one.pareto)
    axes.step(*zip(*front, strict=True), where="post", color="0.6", lw=1, zorder=0) if front else None
    for knob in knobs:
        axes.plot([], [], "o", color=f"C{knobs.index(knob) % 10}", label=knob)
    for number, name in enumerate(sorted({one.rung.artist.name for one in known})):
        axes.plot([], [], MARKERS[number % len(MARKERS)], color="0.4", label=f"drawn by {name}")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.set_xlabel("ms a frame (bars: quartiles)")
    axes.set_ylabel("PSNR against the float64 truth, dB")
    axes.axhline(40, color="0.85", lw=1, zorder=0)
    axes.annotate(
        "40 dB: hard to see",
        (1, 40),
        xycoords=("axes fraction", "data"),
        ha="right",
        va="bottom",
        fontsize=7,
        color="0.5",
    )
    axes.set_title(title, fontsize=11)
    axes.grid(alpha=0.2)
    axes.legend(fontsize=7, loc="lower right", ncols=2)
    from ..scene.files.atomic import atomic_write

    with atomic_write(path) as file:
        figure.savefig(file, format=path.suffix.lower().lstrip(".") or "png")


MARKERS = ("o", "s", "^", "D")
