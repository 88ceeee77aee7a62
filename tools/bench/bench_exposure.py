"""What exposures bring that are learnt: held-out PSNR without, with them, and as a run decides.

    python tools/bench/bench_exposure.py DATA MADE [--captures NAME ...] [--splits 0 1 2]

A minute of the bench each, see `bench_generalisation`; a capture whose photos have one exposure shows what a
wrong decision would cost. What a call has measured before is kept in assets/benchmarks/exposure.json.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from bench_generalisation import Key, known_runs, rounds_of, run_one
from capture_set import NAMES, RENDERED, SPLITS, make_all, use_of

from splatview.measure.machine import FOLDER, write_results

MODES = ("off", "on", "auto")
MINUTES = 1.0
CAPTURES = (
    *("banana", "miku", "miku 12 far", "miku 12 near", "miku 20 far", "miku 20 near"),
    *("castle", "kermit", "fox", "toy", "bust"),
    *("playbot RGBA 18", "spot RGBA 60", "biker front 24", "demo drift 40"),
)

NOTE = (
    "PSNR in dB of held-out thirds of the photos, after a fit of their exposures and as they are. Off: none "
    "are learnt; on: they are; auto: as the run decides by the photos. Rules were chosen on captures "
    "marked so, and are only judged by the others. A minute of a model of what a step costs on two cores."
)


def cell(runs: list[dict[str, Any]]) -> str:
    return ", ".join(f"{np.mean([run[kind] for run in runs]):.2f}" for kind in ("psnr_fitted", "psnr_plain"))


def decisions(runs: list[dict[str, Any]]) -> str:
    """What runs have decided, one word for each."""
    words = ("on" if run["exposure"] else "off" for run in runs)
    return ", ".join(words)


def table(runs: dict[Key, dict[str, Any]]) -> dict[str, Any]:
    rows = []
    for capture in NAMES:
        rounds = rounds_of(runs, capture, list(MODES), [MINUTES])
        if not rounds:
            continue
        found = [[runs[mode, capture, s, MINUTES, seed] for s, seed in rounds] for mode in MODES]
        gains = [b["psnr_fitted"] - a["psnr_fitted"] for a, b in zip(found[0], found[-1], strict=True)]
        row = [capture, use_of(capture), str(found[0][0]["photos"]), ", ".join(str(s) for s, _ in rounds)]
        rows.append([*row, *map(cell, found), f"{np.mean(gains):+.2f}", decisions(found[-1])])
    columns = ["capture", "rules", "photos", "splits", *MODES, "auto - off, fitted", "decided"]
    return {"columns": columns, "rows": rows, "note": NOTE}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--captures", nargs="+", choices=NAMES, default=CAPTURES)
    parser.add_argument("--splits", type=int, nargs="+", default=list(range(SPLITS)))
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "exposure.json")
    options = parser.parse_args()
    make_all(options.data, options.made, [name for name in options.captures if name in RENDERED])
    runs = known_runs(options.output)
    here = Path(__file__).resolve().parents[2]
    for split in options.splits:
        for capture in options.captures:
            for mode in MODES:
                key = (mode, capture, split, MINUTES, 0)
                if key not in runs:
                    fields = [f'exposure="{mode}"']
                    runs[key] = run_one(here, key, options.data.resolve(), options.made.resolve(), fields)
                    runs = known_runs(options.output) | runs  # of another call meanwhile
                    print(mode, capture, split, cell([runs[key]]), flush=True)
                    write_results(options.output, {"runs": list(runs.values()), "table": table(runs)})


if __name__ == "__main__":
    main()
