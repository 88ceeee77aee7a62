"""A measured ladder as JSON and as rows of a table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from splatview.measure.ladder import Ladder, Measured, is_clear
from splatview.measure.machine import describe_machine, finite

MIB = 1 << 20

VISIBLE_DB = 40.0
"""About where differences become hard to see."""

EXACT_DB = 60.0
"""From here on errors are below what an 8-bit screen can show."""

ENOUGH = 1.25
"""Seconds to ask for, of those that are thought to be needed."""

COLUMNS = ("shortcut", "ms", "time", "PSNR", "SSIM", "largest", "popping", "MiB")


def as_json(ladder: Ladder, about: Mapping[str, Any]) -> dict[str, Any]:
    """The ladder as scripts may rely on it; `about`: what was drawn (scene, size, truth, ...).

    Infinite PSNR is null: JSON has no infinity, and no error has no decibels.
    """
    base = ladder.baseline.rung
    return {
        "machine": describe_machine(),
        **about,
        "baseline": {"renderer": base.renderer.name, "options": list(base.options), "ms": ladder.baseline.ms},
        "noise": finite(ladder.noise),
        "views": ladder.views,
        "rounds": ladder.rounds,
        "complete": ladder.complete,
        "rungs": [_rung_json(one) for one in ladder.rungs],
        "left_out": [" ".join(rung.options) for rung in ladder.left_out],
    }


def _rung_json(one: Measured) -> dict[str, Any]:
    numbers = {
        "ms": one.ms,
        "ms_quartiles": list(one.spread),
        "ratio": one.ratio,
        "noise": one.noise,
        "psnr": one.psnr,
        "ssim": one.ssim,
        "max_error": one.max_error,
        "popping": one.popping,
    }
    return {
        "knob": one.rung.knob,
        "value": one.rung.value,
        "renderer": one.rung.renderer.name,
        "options": list(one.rung.options),
        **{name: finite(value) for name, value in numbers.items()},
        "pairs": len(one.times),
        "memory": one.memory,
        "clear": is_clear(one),
        "pareto": one.pareto,
    }


def bargains(ladder: Ladder) -> list[str]:
    """What of the baseline's shortcuts to take, in a sentence each: the fastest one on the front whose errors
    no screen of 8 bits shows, and the fastest whose errors are hard to see."""
    lines, last = [], None
    for level, words in (
        (EXACT_DB, "with errors finer than 8 bits"),
        (VISIBLE_DB, "with errors hard to see"),
    ):
        fast = [one for one in ladder.rungs if one.pareto and one.psnr >= level and is_clear(one)]
        best = min(fast, key=lambda one: one.ratio, default=None)
        if best is not None and best is not last and best.ratio < 1:
            last = best
            lines.append(
                f"Best {words} ({level:.0f} dB or more): {full_name(best, ladder)} takes"
                f" {1 - best.ratio:.0%} less time, at {best.psnr:.0f} dB."
            )
    if not lines:
        lines.append(
            "No shortcut here saves time, beyond the noise, with errors that are hard to see"
            f" ({VISIBLE_DB:.0f} dB or more)."
        )
    return lines


def left_out_text(ladder: Ladder) -> str:
    """What there was no time for, and how to get it."""
    by_renderer: dict[str, dict[str, list[str]]] = {}
    for rung in ladder.left_out:
        knobs = by_renderer.setdefault(rung.renderer.name, {})
        knobs.setdefault("defaults" if rung.knob == "renderer" else rung.knob, []).append(rung.value)
    parts = []
    for renderer, knobs in by_renderer.items():
        named = ", ".join(
            name if name == "defaults" else f"{name} {'|'.join(values)}" for name, values in knobs.items()
        )
        parts.append(f"{renderer}: {named}")
    enough = 10 * math.ceil(ENOUGH * ladder.needed / 10)
    return (
        f"Left out for want of time, {len(ladder.left_out)} of {len(ladder.left_out) + len(ladder.rungs)}: "
        f"{'; '.join(parts)}. --seconds {enough} should do for all of them, --renderers and --knobs choose."
    )


def ratio_text(one: Measured, ladder: Ladder) -> str:
    """Time by the baseline's: "0.80x"; "same" where no difference may be claimed."""
    if one is ladder.baseline:
        return "1x"
    if not math.isfinite(one.ratio):
        return "-"
    if not is_clear(one):
        return "same"
    return f"{one.ratio:.2f}x"


def rung_name(one: Measured) -> str:
    """ "sh-degree 1"; a renderer with its defaults by its name."""
    return one.rung.value if one.rung.knob == "renderer" else f"{one.rung.knob} {one.rung.value}"


def full_name(one: Measured, ladder: Ladder) -> str:
    """`rung_name`, with the renderer's where it is not the baseline's."""
    name = rung_name(one)
    own = one.rung.renderer.name
    return name if own in (ladder.baseline.rung.renderer.name, name) else f"{own} {name}"


def cells(one: Measured, ladder: Ladder) -> list[str]:
    """A row of COLUMNS."""
    low, high = one.spread
    return [
        rung_name(one),
        f"{one.ms:.{int(one.ms < 100)}f}±{(high - low) / 2:.0f}",
        ratio_text(one, ladder),
        "exact" if one.psnr == math.inf else f"{one.psnr:.1f}",
        f"{one.ssim:.4f}",
        f"{one.max_error:.2g}",
        f"{one.popping:.2g}",
        f"{one.memory / MIB:.0f}",
    ]
