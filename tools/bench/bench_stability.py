"""Hard cases on every renderer of this machine: writes assets/benchmarks/stability.json.

    python tools/bench/bench_stability.py [-o JSON]

No times are taken: the table says how many comparisons passed, and how far the worst was from the float64
reference.
"""

from __future__ import annotations

import time

import numpy as np
from harness import make_parser

from splatview.cli.stability import NAMES, as_json, case_renderers, describe_gl, run_with_progress
from splatview.measure.hard_cases import CASES
from splatview.measure.hard_cases.run import CaseResult
from splatview.measure.machine import write_results


def table(results: list[CaseResult]) -> dict:
    """A row a theme, a column a renderer: comparisons passed, and the largest error."""
    kinds = [
        kind
        for kind in dict.fromkeys((r.renderer, precision(r)) for r in results)
        if "float64" not in kind[0]
    ]
    rows = []
    for theme in dict.fromkeys(result.case.theme for result in results):
        here = [result for result in results if result.case.theme == theme]
        row: list[object] = [theme, len({result.case.name for result in here})]
        for kind in kinds:
            mine = [result for result in here if (result.renderer, precision(result)) == kind]
            failed = sum(not result.passed for result in mine)
            verdict = f"**{failed} failed**" if failed else "passed"
            row.append(f"{verdict}, {np.max([result.error for result in mine]):.0e}")
        rows.append(row)
    titles = [f"`{name}`, {blend}" if name in NAMES else name for name, blend in kinds]
    return {"columns": ["theme", "cases", *titles], "rows": rows}


def precision(result: CaseResult) -> str:
    return result.settings.rsplit(", ", 1)[1]


def main() -> None:
    output = make_parser(__doc__, "stability.json").parse_args().output
    begun = time.perf_counter()
    with case_renderers(NAMES) as renderers:
        results = run_with_progress(CASES, renderers)
    seconds = time.perf_counter() - begun
    excluded = sum(result.excluded for result in results)
    failed = sum(not result.passed for result in results)
    driver = describe_gl()["renderer"]
    note = (
        f"{len(CASES)} cases, {len(results)} comparisons with the float64 reference, {failed} failed; each"
        " cell has the largest error of any pixel and channel (0 to 1 is black to white, relative beyond"
        " that). Bounds are 2e-03 in float32, and 2e-02 where float16 blends, more for what it cannot hold;"
        f" {excluded} pixels were left out because an alpha sits on its cut or depths tie. GL: {driver}."
    )
    found = as_json(results, NAMES)
    # Which of the rows passed is in the table.
    found["cases"] = [row for row in found["cases"] if not row["passed"]]
    write_results(output, {**found, "seconds": seconds, "table": {**table(results), "note": note}})


if __name__ == "__main__":
    main()
