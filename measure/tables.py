"""Figures in README.md, ACCURACY.md and SPEED.md come from JSON in assets/benchmarks, and from nowhere else.

A benchmark writes its raw results with `write_results`, and among them a ``table``:
``{"columns": [...], "rows": [[...], ...], "note": "..."}``. A Markdown file holds it between
``<!-- table: NAME -->`` and ``<!-- end of table -->``, NAME being the JSON's file name without its
suffix (or ``knobs``); ``python -m splatview.measure.tables README.md`` writes them anew, ``--check`` only
compares.
"""

from __future__ import annotations

import json
import os
import platform
import re
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .ladder_page import knobs_section

FOLDER = Path("assets") / "benchmarks"
KNOBS = "knobs"
"""The table that comes from the program's own knobs instead of from a file."""

SECTION = re.compile(r"(<!-- table: ([\w-]+) -->\n).*?(<!-- end of table -->)", re.DOTALL)


def describe_machine() -> dict[str, Any]:
    """Processor, cores open to this process, operating system, Python: no figure means much without."""
    processor = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        processor = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass  # not Linux: the platform's own word has to do
    return {
        "processor": processor,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
    }


def write_results(path: Path, results: Mapping[str, Any]) -> None:
    """Writes one benchmark's JSON, the machine's description added under ``machine``."""
    path.parent.mkdir(parents=True, exist_ok=True)
    text = json.dumps({"machine": describe_machine(), **results}, indent=1, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf8")


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
        if match[2] == KNOBS:
            return f"{match[1]}{knobs_section()}\n{match[3]}"
        results = json.loads((folder / f"{match[2]}.json").read_text(encoding="utf8"))
        return f"{match[1]}{markdown_table(results)}\n{match[3]}"

    return SECTION.sub(section, text)


def main(arguments: list[str]) -> int:
    """Fills the Markdown files named; with ``--check`` changes nothing and returns 1 where one is stale."""
    stale = 0
    for name in (argument for argument in arguments if argument != "--check"):
        path = Path(name)
        text = path.read_text(encoding="utf8")
        filled = fill(text, path.parent / FOLDER)
        if "--check" in arguments:
            stale |= filled != text
        else:
            path.write_text(filled, encoding="utf8")
    return int(stale)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
