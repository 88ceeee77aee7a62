"""Figures in README.md and docs/ come from JSON in assets/benchmarks, and from nowhere else.

A benchmark writes its raw results with `splatview.measure.machine.write_results`, and among them a ``table``:
``{"columns": [...], "rows": [[...], ...], "note": "..."}``. A Markdown file holds it between
``<!-- table: NAME -->`` and ``<!-- end of table -->``, NAME being the JSON's file name without its
suffix (or ``knobs``). A part of a table is named by lines in the marker::

    <!-- table: NAME
    columns: shortcut; PSNR, dB
    rows: defaults; `--keep 50`
    -->

``python tools/benchmark_docs.py README.md`` writes the tables anew, ``--check`` only compares.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splatview.measure.knobs import KNOBS
from splatview.measure.machine import FOLDER

KNOBS_SECTION = "knobs"
"""The table that comes from the program's own knobs instead of from a file."""

SECTION = re.compile(
    r"(<!-- table: ([\w-]+)(?:\ncolumns: ([^\n]*))?(?:\nrows: ([^\n]*))?\s-->\n).*?(<!-- end of table -->)",
    re.DOTALL,
)

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


def markdown_table(results: Mapping[str, Any]) -> str:
    """The ``table`` of one benchmark's JSON as Markdown, with its note and the machine below."""
    table, machine = results["table"], results["machine"]
    rows = [table["columns"], ["---", *["---:"] * (len(table["columns"]) - 1)], *table["rows"]]
    lines = ["| " + " | ".join(str(cell) for cell in row) + " |" for row in rows]
    note = f"{table['note']} " if table.get("note") else ""
    lines += ["", f"{note}Measured on {machine['processor']}, {machine['cores']} cores, {machine['system']}."]
    return "\n".join(lines)


def fill(text: str, folder: Path) -> str:
    """`text` with every table section made anew from the JSON files in `folder`."""

    def section(match: re.Match[str]) -> str:
        start, name, columns, rows, end = match.groups()
        if name == KNOBS_SECTION:
            return f"{start}{knobs_section()}\n{end}"
        results = json.loads((folder / f"{name}.json").read_text(encoding="utf8"))
        if columns or rows:
            results["table"] = part_of(results["table"], columns, rows)
        return f"{start}{markdown_table(results)}\n{end}"

    return SECTION.sub(section, text)


def part_of(table: Mapping[str, Any], columns: str | None, rows: str | None) -> dict[str, Any]:
    """Some columns (by their headings) and rows (by their first cells) of a table, in the order given.

    Names are separated by semicolons; of several that are equal the first is taken; None takes all. Of the
    note only the first sentence is kept, which says what was measured.

    Raises:
        ValueError: the table has no such column or row.
    """
    first = [str(row[0]) for row in table["rows"]]
    chosen = [table["rows"][first.index(name)] for name in rows.split("; ")] if rows else table["rows"]
    at = [table["columns"].index(name) for name in (columns.split("; ") if columns else table["columns"])]
    return {
        "columns": [table["columns"][i] for i in at],
        "rows": [[row[i] for i in at] for row in chosen],
        "note": f"{table['note'].partition('. ')[0].rstrip('.')}.",
    }


def results_folder(page: Path) -> Path:
    """The repository's `FOLDER`, from wherever in it the page lies."""
    above = [parent / FOLDER for parent in page.resolve().parents]
    return next((folder for folder in above if folder.is_dir()), above[0])


def main(arguments: list[str]) -> int:
    """Fills the Markdown files named; with ``--check`` changes nothing and returns 1 where one is stale."""
    stale = 0
    for name in (argument for argument in arguments if argument != "--check"):
        path = Path(name)
        text = path.read_text(encoding="utf8")
        filled = fill(text, results_folder(path))
        if "--check" in arguments:
            stale |= filled != text
        else:
            path.write_text(filled, encoding="utf8")
    return int(stale)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
