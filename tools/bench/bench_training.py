"""Training against the clock: held-out PSNR after so many minutes, and where the time of a step goes.

    python tools/bench/bench_training.py CAPTURES [--minutes 1 3 10] [--only banana] [--seeds 0 1 2]

CAPTURES is a folder with the captures `banana` and `miku`. Every figure is a run of the command of its own,
timed from the start of its process; run it with nothing else on the machine. Figures of runs that are not
made anew stay as they are, and so do those of recipes from before ("others"). The peer's figures are those
of OpenSplat 1.1.5's CPU path with its depth order repaired, on the same photos, 2 cores.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from itertools import groupby, product
from pathlib import Path
from statistics import mean
from typing import Any

from splatview.measure.machine import FOLDER, write_results

PEER = {
    ("banana", 2): {1: 23.4, 3: 26.7, 10: 28.1},
    ("miku", 4): {1: 23.2, 3: 27.3, 10: 29.1},
}
"""(capture, --downscale) -> minutes -> the peer's best mean PSNR in dB at that mark."""

RASTER_STAGES = ("project", "sort", "bin", "forward", "backward", "gather", "project_backward")


def train(capture: Path, downscale: int, minutes: float, seed: int, folder: Path) -> dict[str, Any]:
    """One run: the last line of its metrics, with the wall-clock seconds of the whole process."""
    metrics = folder / "metrics.jsonl"
    metrics.unlink(missing_ok=True)
    program = "import sys; from splatview.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "train", str(capture), "--headless", "--metrics", str(metrics)]
    command += ["--downscale", str(downscale), "--minutes", str(minutes), "--seed", str(seed)]
    command += ["-o", str(folder / "scene.ply")]
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    last = json.loads(metrics.read_text().splitlines()[-1])
    return {**last, "process_seconds": time.perf_counter() - begun}


def known(path: Path) -> dict[str, Any]:
    """What earlier calls have written, but for the machine, which is that of the last one."""
    found = json.loads(path.read_text(encoding="utf8")) if path.exists() else {"runs": []}
    return {key: value for key, value in found.items() if key != "machine"}


def label(run: dict[str, Any]) -> str:
    return f"{run['capture']} --downscale {run['downscale']}, {run['minutes']:g} min"


def key_of(run: dict[str, Any]) -> tuple[str, float, int]:
    return run["capture"], run["minutes"], run.get("seed", 0)


def row(runs: list[dict[str, Any]]) -> list[str]:
    """The line in the table of runs that differ by their seeds alone: means, and how far PSNR goes."""
    first = runs[0]
    peer = PEER[first["capture"], first["downscale"]].get(first["minutes"])
    shares = [
        sum(run["stages"][stage] for stage in RASTER_STAGES) / sum(run["stages"].values()) for run in runs
    ]
    scores = sorted(run["psnr"] for run in runs)
    several = len(runs) > 1
    return [
        label(first) + (f" ({len(runs)} runs)" if several else ""),
        f"{mean(scores):.2f}" + (f" ({scores[0]:.2f} to {scores[-1]:.2f})" if several else ""),
        f"{mean(run['ssim'] for run in runs):.3f}",
        "-" if peer is None else f"{peer:.1f}",
        f"{mean(run['iteration'] for run in runs):,.0f}",
        f"{mean(run['gaussians'] for run in runs):,.0f}",
        f"{mean(shares):.0%}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1, 3, 10])
    names = [name for name, _ in PEER]
    parser.add_argument("--only", choices=names, nargs="+", default=names, help="captures to train on")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    options = parser.parse_args()
    path = FOLDER / "training.json"
    runs = {key_of(run): run for run in known(path)["runs"]}
    captures = [key for key in PEER if key[0] in options.only]
    wanted: list[tuple[tuple[str, int], float, int]] = list(product(captures, options.minutes, options.seeds))
    with tempfile.TemporaryDirectory() as folder:
        for (name, downscale), minutes, seed in wanted:
            result = train(options.captures / name, downscale, minutes, seed, Path(folder))
            run = {"capture": name, "downscale": downscale, "minutes": minutes, "seed": seed, **result}
            runs[key_of(run)] = run
            print(*row([run]), sep="  ", flush=True)
            write(path, [runs[key] for key in sorted(runs)])


def write(path: Path, runs: list[dict[str, Any]]) -> None:
    """After every run: half an hour of them is not lost to the last."""
    alike = [list(group) for _, group in groupby(runs, lambda run: key_of(run)[:2])]
    table = {
        "columns": ["run", "PSNR dB", "SSIM", "peer dB", "steps", "splats", "time in raster"],
        "rows": [row(group) for group in alike],
        "note": "Held-out photos; wall clock from process start. Of several runs, which differ by their "
        "seeds, means and, in brackets, least and largest PSNR. Peer: OpenSplat 1.1.5, CPU.",
    }
    write_results(path, known(path) | {"runs": runs, "table": table})


if __name__ == "__main__":
    main()
