"""Points by stereo of one checkout against those of another, in turn.

    python tools/bench/compare_stereo.py BEFORE AFTER DATA MADE [--rounds N]

BEFORE and AFTER are checkouts with a `.venv`, DATA and MADE the folders of captures of `capture_set.py`. Of a
capture without points that shows something everywhere depths are looked for that no point tells, of an object
those of random points where all photos look.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench_torch_loop import Worker, answer, in_turn

CASES = (("terrace", True), ("fruit", True), ("banana", True), ("skull RGBA 100", False))
"""Capture, and whether it shows something everywhere."""

PHOTOS = 16
"""Of a capture, neighbours, that are matched."""


def work(name: str, data: Path, made: Path, everywhere: bool) -> None:
    """The process of one checkout: a line of answer for each line asked, first how many points there are."""
    from capture_set import bench_split

    from splatview.scene.captures.points import random_points
    from splatview.trainer.stereo import stereo_points
    from splatview.trainer.views import train_views

    capture = bench_split(name, 0, data, made)
    capture = capture.about(capture.centre)
    views = train_views(capture.train[:PHOTOS])
    known = None
    if not everywhere:
        known = random_points([photo.camera for photo in capture.train])[0]

    def once() -> int:
        return len(stereo_points(views, known, threads=2)[0])

    once()
    print(once(), flush=True)
    answer(once)


class StereoWorker(Worker):
    def __init__(self, checkout: Path, name: str, data: Path, made: Path, everywhere: bool) -> None:
        python = checkout / ".venv" / "bin" / "python"
        command = [python, Path(__file__).resolve(), "--work", name, data, made, str(int(everywhere))]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.points = int(self._line())


def measured(checkouts: Sequence[Path], data: Path, made: Path, rounds: int) -> list[dict[str, Any]]:
    results = []
    for name, everywhere in CASES:
        workers = [StereoWorker(checkout, name, data, made, everywhere) for checkout in checkouts]
        (clock, processor), (ms, _) = in_turn([(worker, "run") for worker in workers], rounds, 1)
        for worker in workers:
            worker.close()
        results.append({"capture": name, "clock": clock, "processor": processor, "ms": ms})
        results[-1] |= {"points": [worker.points for worker in workers]}
        print(row(results[-1]), flush=True)
    return results


def row(result: dict[str, Any]) -> list[str]:
    ratios = [
        f"{one['median']:.2f} ({one['low']:.2f}-{one['high']:.2f})"
        for one in (result["clock"], result["processor"])
    ]
    seconds = [f"{result['ms'][name] / 1e3:.1f}" for name in ("before_ms", "after_ms")]
    return [result["capture"], *(f"{count:,}" for count in result["points"]), *seconds, *ratios]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    for name in ("before", "after", "data", "made"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()

    from splatview.measure.machine import FOLDER, write_results

    checkouts = [folder.resolve() for folder in (options.before, options.after)]
    results = measured(checkouts, options.data.resolve(), options.made.resolve(), options.rounds)
    columns = ["capture", "points before", "after", "before, s", "after, s"]
    table = {
        "columns": [*columns, "after / before", "in processor time"],
        "rows": [row(result) for result in results],
        "note": f"Stereo of the first {PHOTOS} photos trained on, split 0 of the bench. Medians and quartiles"
        " of pairs in turn, all cores.",
    }
    write_results(options.output or FOLDER / "stereo_in_turn.json", {"results": results, "table": table})


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2], Path(sys.argv[3]), Path(sys.argv[4]), sys.argv[5] == "1")
    else:
        main()
