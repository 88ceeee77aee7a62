"""Held-out PSNR after so many minutes by one checkout and by another, side by side with one thread each.

    python tools/bench/compare_training.py BEFORE AFTER CAPTURES KEPT [--minutes 1 3 10] [--note TEXT]

BEFORE and AFTER are checkouts with a `.venv`; CAPTURES has the folders `banana` and `miku`. The two runs of a
pair begin together and have a core each, so that a machine that becomes slower meets both. KEPT receives
metrics, scenes and what the program said; a pair that is there is not trained again.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from pathlib import Path
from typing import Any

from bench_training import PEER, label

from splatview.measure.machine import FOLDER, write_results

SIDES = ("before", "after")


def pair(checkouts: dict[str, Path], capture: Path, downscale: int, minutes: float, kept: Path) -> list[Path]:
    """Trains both; their metrics."""
    found, running = [], []
    for side, checkout in checkouts.items():
        stem = kept / f"{side}-{capture.name}-{minutes:g}"
        metrics, scene = stem.with_suffix(".jsonl"), stem.with_suffix(".ply")
        found.append(metrics)
        if scene.exists():
            continue
        metrics.unlink(missing_ok=True)
        command = [str(checkout / ".venv" / "bin" / "splatview"), "train", str(capture), "--headless"]
        command += ["--threads", "1", "--downscale", str(downscale), "--minutes", str(minutes)]
        command += ["--metrics", str(metrics), "-o", str(scene)]
        with stem.with_suffix(".log").open("w") as log:
            running.append(subprocess.Popen(command, stdout=log, stderr=log))
    for process in running:
        if process.wait() != 0:
            raise SystemExit(f"{' '.join(map(str, process.args))} failed; see the .log in {kept}")
    return found


def row(run: dict[str, Any]) -> list[str]:
    before, after = run["before"], run["after"]
    return [
        label(run),
        f"{before['psnr']:.2f}",
        f"{after['psnr']:.2f}",
        f"{after['psnr'] - before['psnr']:+.2f}",
        f"{before['iteration']:,}",
        f"{after['iteration']:,}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("captures", type=Path)
    parser.add_argument("kept", type=Path)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1, 3, 10])
    parser.add_argument("--note", default="", help="what else is to be known, for the table")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "training_pairs.json")
    options = parser.parse_args()
    checkouts = {"before": options.before.resolve(), "after": options.after.resolve()}
    options.kept.mkdir(parents=True, exist_ok=True)
    runs: list[dict[str, Any]] = []
    for name, downscale in PEER:
        for minutes in options.minutes:
            metrics = pair(checkouts, options.captures.resolve() / name, downscale, minutes, options.kept)
            last = [json.loads(path.read_text(encoding="utf8").splitlines()[-1]) for path in metrics]
            found = dict(zip(SIDES, last, strict=True))
            runs.append({"capture": name, "downscale": downscale, "minutes": minutes, **found})
            print(*row(runs[-1]), sep="  ", flush=True)
            columns = ["run", "before, dB", "after, dB", "after - before", "steps before", "steps after"]
            note = (
                "Held-out photos; pairs of runs side by side, one thread each. Before: a loop in numpy;"
                f" after: the same kernels through torch. {options.note}"
            ).strip()
            table = {"columns": columns, "rows": [row(run) for run in runs], "note": note}
            write_results(options.output, {"runs": runs, "table": table})


if __name__ == "__main__":
    main()
