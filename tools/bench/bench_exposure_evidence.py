"""By what exposures of photos are decided, on every capture of the bench that has points.

    python tools/bench/bench_exposure_evidence.py DATA MADE [--captures NAME ...]

Seconds for each capture: photos are compared with one another, nothing is trained. Captures that are not
there are passed over, and what a call has measured before is kept.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from capture_set import NAMES, RENDERED, bench_split, make_all, use_of

from splatview.measure.machine import FOLDER, write_results
from splatview.scene.errors import InputError
from splatview.trainer.exposure import FEWEST_NEAR, measured_evidence
from splatview.trainer.views import train_views

NOTE = (
    "Photos trained on in split 0. Differ: standard deviation of the photos' log gains. Known to: what gains "
    "leave unexplained. Uneven: ratio of the colours that differ most and least. Nearly the same place: "
    f"median log ratio of photos from there, where there are {FEWEST_NEAR} such pairs that differ. The rules "
    "were chosen on captures marked so, and are only judged by the others."
)


def measured(name: str, data: Path, made: Path) -> dict[str, Any] | None:
    """What speaks for correction of a capture's exposures; None where it has no points, or too few shared."""
    capture = bench_split(name, 0, data, made)
    if capture.guessed:
        return None
    found = measured_evidence(capture.points, train_views(capture.train), capture.background or (0, 0, 0))
    if not found.error < float("inf"):
        return None
    return {
        "capture": name,
        "photos": len(capture.train),
        **found._asdict(),
        "on": found.calls_for_correction,
    }


def table(runs: dict[str, dict[str, Any]]) -> dict[str, Any]:
    rows = [
        [
            *(name, use_of(name), str(run["photos"]), f"{run['spread']:.1%}", f"{run['error']:.1%}"),
            *(f"{run['unevenness']:.2f}", f"{run['near']:.1%}" if run["near"] else ""),
            "on" if run["on"] else "off",
        ]
        for name, run in ((name, runs[name]) for name in NAMES if name in runs)
    ]
    columns = [
        "capture",
        "rules",
        "photos",
        "differ",
        "known to",
        "uneven",
        "nearly the same place",
        "decided",
    ]
    return {"columns": columns, "rows": rows, "note": NOTE}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--captures", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "exposure_evidence.json")
    options = parser.parse_args()
    make_all(options.data, options.made, [name for name in options.captures if name in RENDERED])
    known = json.loads(options.output.read_text())["runs"] if options.output.exists() else []
    runs = {run["capture"]: run for run in known}
    for name in options.captures:
        try:
            found = measured(name, options.data, options.made)
        except (InputError, SystemExit) as error:
            print(f"{name}: {error}")
            continue
        if found is not None:
            runs[name] = found
            print(found, flush=True)
    write_results(options.output, {"runs": list(runs.values()), "table": table(runs)})


if __name__ == "__main__":
    main()
