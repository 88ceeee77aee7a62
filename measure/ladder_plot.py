"""A measured ladder drawn: time against accuracy, a mark a rung, the Pareto front as a line."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from splatview.measure.ladder import Ladder, Measured
from splatview.measure.ladder_report import EXACT_DB, VISIBLE_DB, rung_name
from splatview.scene.errors import printable

MARKERS = ("o", "s", "^", "D", "v")
"""By renderer."""

FRONT, INK, FAINT = "#1f6f8b", "0.15", "0.5"

LABEL_STEPS = tuple(
    (dx, dy, "left" if dx > 0 else "right" if dx < 0 else "center")
    for reach in (9, 18, 30, 44, 60, 80, 104)
    for dx, dy in ((1, 0.5), (1, -0.5), (-1, 0.5), (-1, -0.5), (0, 1), (0, -1), (0.7, 1), (0.7, -1))
    for dx, dy in ((dx * reach, dy * reach),)
)
"""Places tried for a label, points from its mark: near ones first."""


def plot(ladder: Ladder, path: Path, *, title: str) -> None:
    """Written by matplotlib to `path`, .png, .svg or .pdf."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    from splatview.scene.formats.io import atomic_write

    figure = Figure(figsize=(11, 6.2), dpi=160)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.075, 0.11, 0.9, 0.76))
    known = [one for one in ladder.rungs if math.isfinite(one.ratio) and not math.isnan(one.psnr)]
    top = max((one.psnr for one in known if math.isfinite(one.psnr)), default=100.0) + 8
    places = [(one.ratio, min(one.psnr, top)) for one in known]
    _scales(axes, ladder, places, top)
    notes = _background(axes, ladder)
    knobs = [name for name in dict.fromkeys(one.rung.knob for one in known) if name != "renderer"]
    renderers = list(dict.fromkeys(one.rung.renderer.name for one in known))
    for one, (x, y) in zip(known, places, strict=True):
        _mark(axes, one, x, y, knobs, renderers)
    _front(axes, [place for one, place in zip(known, places, strict=True) if one.pareto])
    _legend(axes, knobs, renderers)
    base = ladder.baseline
    axes.set_xlabel(
        f"time of a frame, of {base.rung.renderer.name}'s {base.ms:.3g} ms  (bars: quartiles of the pairs)",
        color=INK,
    )
    axes.set_ylabel("PSNR against the float64 truth, dB", color=INK)
    figure.text(0.075, 0.945, "What accuracy costs in time", fontsize=15, weight="bold", color=INK)
    figure.text(0.075, 0.9, printable(title), fontsize=10.5, color=FAINT, parse_math=False)
    _labels(figure, axes, known, places, notes)
    with atomic_write(path) as file:
        figure.savefig(file, format=path.suffix.lower().lstrip("."))


def _scales(axes: Any, ladder: Ladder, places: list[tuple[float, float]], top: float) -> None:
    from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter, NullLocator

    axes.set_xscale("log")
    noise = ladder.noise if math.isfinite(ladder.noise) else 1.0
    low = min([x for x, _ in places] + [1 / (1 + noise)]) / 1.25
    high = max([x for x, _ in places] + [1 + noise]) * 1.45
    axes.set_xlim(low, high)
    axes.set_ylim(min([y for _, y in places], default=20.0) - 6, top + 4)
    ticks = [t for power in range(-4, 5) for t in (10.0**power * step for step in (1, 2, 5))]
    axes.xaxis.set_major_locator(FixedLocator([t for t in ticks if low <= t <= high]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}x"))


def _background(axes: Any, ladder: Ladder) -> list[Any]:
    """The noise floor, and what decibels mean; returns the words."""
    noise = ladder.noise if math.isfinite(ladder.noise) else 1.0
    axes.axvspan(1 / (1 + noise), 1 + noise, color="0.92", zorder=0, lw=0)
    low, high = axes.get_ylim()
    notes = [
        axes.text(1, high, f"noise floor ±{noise:.0%}", ha="center", va="top", color=FAINT, fontsize=7.5)
    ]
    for level, text in (
        (VISIBLE_DB, "above: hard to see"),
        (EXACT_DB, "above: finer than a screen's 8 bits"),
    ):
        axes.axhline(level, color="0.75", lw=0.9, ls=(0, (2, 3)), zorder=0)
        notes.append(
            axes.text(
                0.005,
                level + 0.006 * (high - low),
                text,
                transform=axes.get_yaxis_transform(),
                va="bottom",
                fontsize=7.5,
                color=FAINT,
            )
        )
    axes.grid(alpha=0.15, lw=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    return notes


def _mark(axes: Any, one: Measured, x: float, y: float, knobs: list[str], renderers: list[str]) -> None:
    colour = INK if one.rung.knob == "renderer" else f"C{knobs.index(one.rung.knob) % 10}"
    marker = MARKERS[renderers.index(one.rung.renderer.name) % len(MARKERS)]
    low, high = np.percentile(one.ratios, [25, 75])
    axes.plot([low, high], [y, y], color=colour, alpha=0.28, lw=2.6, solid_capstyle="round", zorder=2)
    size = 9 if one.pareto else 6.5
    axes.plot([x], [y], marker, color=colour, ms=size, mec="white", mew=0.9, zorder=4)


def _front(axes: Any, places: list[tuple[float, float]]) -> None:
    if places:
        axes.step(*zip(*sorted(places), strict=True), where="post", color=FRONT, lw=1.6, alpha=0.7, zorder=3)


def _legend(axes: Any, knobs: list[str], renderers: list[str]) -> None:
    for number, name in enumerate(renderers):
        axes.plot([], [], MARKERS[number % len(MARKERS)], color="0.35", label=f"drawn by {name}")
    axes.plot([], [], color=FRONT, lw=1.6, alpha=0.7, label="nothing both faster and nearer")
    for number, knob in enumerate(knobs):
        axes.plot([], [], "o", color=f"C{number % 10}", label=knob)
    # Above the axes, where no mark can be.
    axes.legend(
        fontsize=7.5,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.005),
        ncols=min(6, len(knobs) + len(renderers) + 1),
        frameon=False,
        handletextpad=0.3,
        columnspacing=1.1,
        borderaxespad=0.2,
    )


def _labels(
    figure: Any, axes: Any, known: list[Measured], places: list[tuple[float, float]], notes: list[Any]
) -> None:
    """Names beside their marks, each in the first place where it covers no other name, mark or note."""
    from matplotlib.transforms import Bbox

    renderer = figure.canvas.get_renderer()
    window = axes.get_window_extent(renderer)
    point = figure.dpi / 72
    marks = [axes.transData.transform(place) for place in places]
    taken = [Bbox.from_extents(x - 5 * point, y - 5 * point, x + 5 * point, y + 5 * point) for x, y in marks]
    taken += [note.get_window_extent(renderer) for note in notes]
    # The front first: its names get the near places.
    for index in sorted(range(len(known)), key=lambda n: (not known[n].pareto, places[n])):
        one, (x, y) = known[index], marks[index]
        text = axes.annotate(
            rung_name(one),
            places[index],
            xytext=(0, 0),
            textcoords="offset points",
            va="center",
            fontsize=8.5 if one.pareto else 7,
            weight="bold" if one.pareto else "normal",
            color=INK if one.pareto else FAINT,
            zorder=5,
        )
        size = text.get_window_extent(renderer)
        for dx, dy, side in LABEL_STEPS:
            left = x + dx * point - {"left": 0.0, "right": size.width, "center": size.width / 2}[side]
            low = y + dy * point - size.height / 2
            box = Bbox.from_bounds(left, low, size.width, size.height)
            inside = (
                window.x0 <= box.x0 and box.x1 <= window.x1 and window.y0 <= box.y0 and box.y1 <= window.y1
            )
            if inside and not any(box.overlaps(other) for other in taken):
                break
        else:
            text.remove()  # a name over another could not be read either; the table has them all
            continue
        text.set_position((dx, dy))
        text.set_horizontalalignment(side)
        if math.hypot(dx, dy) > 14:
            axes.annotate(
                "",
                places[index],
                xytext=(dx, dy),
                textcoords="offset points",
                arrowprops={"arrowstyle": "-", "color": "0.75", "lw": 0.6, "shrinkA": 0, "shrinkB": 3},
                zorder=1,
            )
        taken.append(box)
