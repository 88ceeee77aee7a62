"""Training against the clock: held-out PSNR after so many minutes, and where the time of a step goes.

    python tests/benchmarks/bench_training.py CAPTURES [--minutes 1 3 10]

CAPTURES is a folder with the captures `banana` and `miku`. Every figure is a run of the command of its own,
timed from the start of its process; run it with nothing else on the machine. The peer's figures are those
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

from splatview.measure.tables import FOLDER, write_results

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
    program = "import sys; from splatview.viewer.cli import main; sys.exit(main())"
    command = [sys.executable, "-c", program, "train", str(capture), "--headless", "--metrics", str(metrics)]
    command += ["--downscale", str(downscale), "--minutes", str(minutes), "-o", str(folder / "scene.ply")]
    begun = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    last = json.loads(metrics.read_text().splitlines()[-1])
    return {**last, "process_seconds": time.perf_counter() - begun}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("captures", type=Path)
    parser.add_argument("--minutes", type=float, nargs="+", default=[1, 3, 10])
    options = parser.parse_args()
    runs, rows = [], []
    with tempfile.TemporaryDirectory() as folder:
        for (name, downscale), marks in PEER.items():
            for minutes in options.minutes:
                result = train(options.captures / name, downscale, minutes, Path(folder))
                stages = result["stages"]
                share = sum(stages[stage] for stage in RASTER_STAGES) / sum(stages.values())
                runs.append({"capture": name, "downscale": downscale, "minutes": minutes, **result})
                peer = marks.get(minutes)
                rows.append(
                    [
                        f"{name} --downscale {downscale}, {minutes:g} min",
                        f"{result['psnr']:.2f}",
                        f"{result['ssim']:.3f}",
                        "-" if peer is None else f"{peer:.1f}",
                        f"{result['iteration']:,}",
                        f"{result['gaussians']:,}",
                        f"{share:.0%}",
                    ]
                )
                print(*rows[-1], sep="  ", flush=True)
    write_results(
        FOLDER / "training.json",
        {
            "runs": runs,
            "table": {
                "columns": ["run", "PSNR dB", "SSIM", "peer dB", "steps", "splats", "time in raster"],
                "rows": rows,
                "note": "Held-out photos; wall clock from process start. Peer: OpenSplat 1.1.5, CPU.",
            },
        },
    )


if __name__ == "__main__":
    main()
