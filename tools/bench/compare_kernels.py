"""Steps and frames of the rasteriser of one checkout against those of another, in turn.

    python tools/bench/compare_kernels.py BEFORE AFTER [--rounds N]

BEFORE and AFTER are checkouts with a `.venv`. A step is a picture of 256x256 and its gradients, a frame a
picture of 1280x720, of the synthetic scenes of bench_kernels.py, on all cores.
"""

from __future__ import annotations

import argparse
import inspect
import subprocess
import sys
from pathlib import Path
from typing import Any

from bench_torch_loop import Worker, answer, in_turn

CASES = (
    ("step", 20_000, (256, 256)),
    ("step", 100_000, (256, 256)),
    ("frame", 100_000, (1280, 720)),
    ("frame", 500_000, (1280, 720)),
)
"""What, splats, size."""

REPEATS = {20_000: 20, 100_000: 8, 500_000: 3}
"""Steps or frames in a round, by splats."""


def work(kind: str, splats: int, width: int, height: int) -> None:
    """The process of one checkout: a line of answer for each line asked."""
    import numpy as np
    from bench_kernels import synthetic_camera, synthetic_scene

    from splatview.raster import Workspace, draw_frame, parameters_of
    from splatview.raster.gradients import differentiate
    from splatview.scene import RenderSettings

    scene, camera = parameters_of(synthetic_scene(splats)), synthetic_camera(width, height)
    workspace, gradients = Workspace(), None
    # What training asks for: without gradients by the view, where a checkout knows of the choice.
    asked = {"by_view": False} if "by_view" in inspect.signature(differentiate).parameters else {}
    weights = np.random.default_rng(1).normal(size=(height, width, 4)).astype(np.float32)

    def once() -> None:
        nonlocal gradients
        frame = draw_frame(scene, camera, RenderSettings(), workspace)
        if kind == "step":
            gradients = differentiate(scene, frame, weights, reuse=gradients, **asked)

    for _ in range(3):
        once()
    print("ready", flush=True)
    answer(once)


class KernelWorker(Worker):
    def __init__(self, checkout: Path, kind: str, splats: int, size: tuple[int, int]) -> None:
        python = checkout / ".venv" / "bin" / "python"
        command = [python, Path(__file__).resolve(), "--work", kind, *map(str, (splats, *size))]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._line()


def measured(before: Path, after: Path, rounds: int) -> list[dict[str, Any]]:
    results = []
    for kind, splats, size in CASES:
        workers = [KernelWorker(checkout, kind, splats, size) for checkout in (before, after)]
        (clock, processor), (ms, processor_ms) = in_turn(
            [(worker, "run") for worker in workers], rounds, REPEATS[splats]
        )
        for worker in workers:
            worker.close()
        case = f"{kind}, {splats:,} splats, {size[0]}x{size[1]}"
        results.append({"case": case, "clock": clock, "processor": processor})
        results[-1] |= {"ms": ms, "processor_ms": processor_ms}
        print(row(results[-1]), flush=True)
    return results


def row(result: dict[str, Any]) -> list[str]:
    ratios = [
        f"{one['median']:.3f} ({one['low']:.3f}-{one['high']:.3f})"
        for one in (result["clock"], result["processor"])
    ]
    return [result["case"], f"{result['ms']['before_ms']:.1f}", f"{result['ms']['after_ms']:.1f}", *ratios]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    for name in ("before", "after"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()

    from splatview.measure.machine import FOLDER, write_results

    results = measured(options.before.resolve(), options.after.resolve(), options.rounds)
    table = {
        "columns": ["what", "before, ms", "after, ms", "after / before", "in processor time"],
        "rows": [row(result) for result in results],
        "note": "Medians and quartiles of pairs in turn, all cores. A step is a picture and its gradients.",
    }
    write_results(options.output or FOLDER / "kernels_in_turn.json", {"results": results, "table": table})


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2], *map(int, sys.argv[3:6]))
    else:
        main()
