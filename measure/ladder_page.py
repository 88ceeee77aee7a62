"""What ACCURACY.md holds: tables of ladders and bills from their JSON, of the knobs from their own data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from .knobs import KNOBS

LADDER_COLUMNS = (
    "shortcut",
    "ms a frame",
    "time",
    "PSNR, dB",
    "SSIM",
    "largest error",
    "popping",
    "MiB",
    "front",
)


def ladder_table(results: Mapping[str, Any]) -> dict[str, Any]:
    """The `table` of a ladder's JSON (`splatview ladder --json`), the noise floor beside each ratio."""
    width, height = results["size"]
    base = results["baseline"]["renderer"]
    rows = []
    last = None
    for rung in results["rungs"]:
        if rung["renderer"] != last:
            last = rung["renderer"]
            rows.append([f"**drawn by `{last}`**", *[""] * (len(LADDER_COLUMNS) - 1)])
        rows.append(_row(rung, rung["noise"] or results["noise"]))
    left_out = results["left_out"]
    return {
        "columns": list(LADDER_COLUMNS),
        "rows": rows,
        "note": f"{results['scene']}, {results['splats']:,} splats at {width}x{height}, "
        f"{results['views']} views, up to {results['rounds']} pairs a row. Time: of `{base}` with its "
        "defaults, drawn in turn with it, and the noise floor for so many pairs, never below that of "
        f'`{base}` against itself; "same" where no difference may be claimed. Errors: against a float64 '
        "truth that agrees with the reference to "
        f"{results['truth']['largest_difference_from_reference']:.0e} in sampled blocks. "
        "Popping: the largest change of a pixel when the eye turns a little. "
        "Front: faster, by more than the noise, than all on the front that are nearer to the truth; nothing "
        "else in the table is both faster and nearer."
        + (f" Left out for want of time: {len(left_out)} rows." if left_out else ""),
    }


def _row(rung: Mapping[str, Any], noise: float | None) -> list[str]:
    low, high = (part if part is not None else math.nan for part in rung["ms_quartiles"])
    name = "defaults" if rung["knob"] == "renderer" else f"`--{rung['knob']} {rung['value']}`"
    floor = "" if noise is None else f" ±{noise:.0%}"
    time = f"{rung['ratio']:.2f}{floor}" if rung["clear"] or rung["ratio"] == 1 else f"same{floor}"
    return [
        name,
        f"{rung['ms']:.1f} ±{(high - low) / 2:.1f}",
        time,
        "exact" if rung["psnr"] is None else f"{rung['psnr']:.1f}",
        "-" if rung["ssim"] is None else f"{rung['ssim']:.4f}",
        f"{rung['max_error']:.2g}",
        f"{rung['popping']:.2g}",
        f"{rung['memory'] / 2**20:.0f}",
        "yes" if rung["pareto"] else "",
    ]


def bill_table(scene: str, rows: list[tuple[str, str, str]], sums: list[str]) -> dict[str, Any]:
    """The `table` of a bill, by `bill.rows` and `bill.sums`."""
    return {
        "columns": [scene, "splats", "a NeRF"],
        "rows": [list(row) for row in rows],
        "note": " ".join(f"{line}." if not line.endswith(".") else line for line in sums),
    }


def knobs_section() -> str:
    """Every knob, by the table that the program itself reads."""
    lines = ["| option | values, exact first | renderers | what it does |", "| --- | --- | --- | --- |"]
    for knob in KNOBS:
        values = ", ".join(value.text for value in knob.values)
        owners = ", ".join(f"`{name}`" for name in knob.renderers)
        lines.append(f"| `{knob.option}` | {values} | {owners} | {knob.title}: {knob.changes}. |")
    return "\n".join(lines)
