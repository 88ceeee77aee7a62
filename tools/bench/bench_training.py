"""Training against the clock: held-out PSNR after so many minutes, and where the time of a step goes.

    python tools/bench/bench_training.py CAPTURES [--minutes 1 3 10] [--only banana]

CAPTURES is a folder with the captures `banana` and `miku`. Every figure is a run of the command of its own,
timed from the start of its process; run it with nothing else on the machine. Figures of runs that are not
made anew stay as they are. The peer's figures are those
of OpenSplat 1.1.5's CPU path with its depth order repaired, on the same photos, 2 cores.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from splatview.measure.machine import FOLDER, write_results

PEER = {
    ("banana", 2): {1: 23.4, 3: 26.7, 10: 28.1},
    ("miku", 4): {1: 23.2, 3: 27.3, 10: 29.1},
}
"""(capture, --downscale) -> minutes -> the peer's best mean PSNR in dB at that mark."""

RASTER_STAGES = ("project", "sort", "bin", "forward", "backward", "gather", "project_backward")


def train(capture: Path, downscale: int, minutes: float, folder: Path) -> dict[str, Any]:
    """One run: the last line of its metrics, with the wall-clock seconds of the whole process."""
    metrics = folder / "metrics.jsonl"
    metrics.unlink(missing_ok=True)
    program = "import sys; from splatview.cli.main import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "train", str(capture), "--headless", "--metrics", str(metrics)]
    command += ["--downscale", str(downscale), "--minutes", str(minutes), "-o", str(folder / "scene.ply")]
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    last = json.loads(metrics.read_text().splitlines()[-1])
    return {**last, "process_seconds": time.perf_counter() - begun}


def known_runs(path: Path) -> list[dict[str, Any]]:
    """Those of an earlier call."""
    return json.loads(path.read_text(encoding="utf8"))["runs"] if path.exists() else []


def label(run: dict[str, Any]) -> str:
    return f"{run['capture']} --downscale {run['downscale']}, {run['minutes']:g} min"


def row(run: dict[str, Any]) -> list[str]:
    """A run's line in the table."""
    stages = run["stages"]
    share = sum(stages[stage] for stage in RASTER_STAGES) / sum(stages.values())
    key = run["capture"], run["downscale"]
    peer = PEER[key].get(run["minutes"])
    return [
        label(run),
        f"{run['psnr']:.2f}",
        f"{run['ssim']:.3f}",
        "-" if peer is None else f"{peer:.1f}",
        f"{run['iteration']:,}",
        f"{run['gaussians']:,}",
        f"{share:.0%}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1, 3, 10])
    names = [name for name, _ in PEER]
    parser.add_argument("--only", choices=names, nargs="+", default=names, help="captures to train on")
    options = parser.parse_args()
    path = FOLDER / "training.json"
    runs = {(run["capture"], run["minutes"]): run for run in known_runs(path)}
    with tempfile.TemporaryDirectory() as folder:
        wanted: list[tuple[str, int, float]] = [(*key, m) for key in PEER for m in options.minutes]
        for name, downscale, minutes in wanted:
            if name not in options.only:
                continue
            result = train(options.captures / name, downscale, minutes, Path(folder))
            runs[name, minutes] = {"capture": name, "downscale": downscale, "minutes": minutes, **result}
            print(*row(runs[name, minutes]), sep="  ", flush=True)
            write(path, [runs[key] for key in sorted(runs)])


def write(path: Path, runs: list[dict[str, Any]]) -> None:
    """After every run: half an hour of them is not lost to the last."""
    write_results(
        path,
        {
            "runs": runs,
            "table": {
                "columns": ["run", "PSNR dB", "SSIM", "peer dB", "steps", "splats", "time in raster"],
                "rows": [row(run) for run in runs],
                "note": "Held-out photos; wall clock from process start. Peer: OpenSplat 1.1.5, CPU.",
            },
        },
    )


if __name__ == "__main__":
    main()
