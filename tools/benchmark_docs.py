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

import argparse
import json
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
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pages", nargs="+", type=Path)
    parser.add_argument("--check", action="store_true", help="only say, by exit code 1, that a page is stale")
    options = parser.parse_args(arguments)
    stale = 0
    for path in options.pages:
        text = path.read_text(encoding="utf8")
        filled = fill(text, results_folder(path))
        if options.check:
            stale |= filled != text
        else:
            path.write_text(filled, encoding="utf8")
    return int(stale)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
