"""Memory of training runs: what is stated before they begin, beside what they take at their peak.

    python tools/bench/bench_training_memory.py DATA MADE [--only NAME ...] [--table]

DATA holds the folders `captures` and `scenes`, MADE the captures that `capture_set.py` has rendered. Each run
is a process of its own, whose peak of resident memory the system tells (`ru_maxrss`). Constants of
`trainer.memory` were chosen on the runs marked so and are judged by the others. `--table` states anew, by the
constants as they are, what was measured before.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from splatview.measure.machine import FOLDER, write_results
from splatview.scene.captures import load_capture
from splatview.trainer.memory import (
    Machine,
    PhotoSizes,
    begins_by_stereo,
    own_points,
    run_memory,
    sizes_of_capture,
)
from splatview.trainer.recipe import MEMBERS
from splatview.trainer.settings import TrainSettings

sys.path.append(str(Path(__file__).parents[1] / "soak"))
from screen import screen

PROGRAM = "import sys; from splatview.cli.main import main; sys.exit(main())"

THREADS = 2

WAIT = 600.0
"""Seconds that a run in a window may take."""


@dataclass(frozen=True, kw_only=True)
class Case:
    """A run of `splatview train`."""

    capture: str
    splats: int
    use: Literal["choose", "judge"]
    downscale: int = 1
    steps: int = 300
    minutes: int | None = None
    """What ends the run in place of the steps, after several scenes."""
    options: tuple[str, ...] = ()
    window: bool = False

    @property
    def name(self) -> str:
        size = f" --downscale {self.downscale}" if self.downscale > 1 else ""
        more = " " + " ".join(self.options) if self.options else ""
        more += f", {self.steps:,} steps" if self.steps != 300 else ""
        more += f", several scenes in {self.minutes} minutes" if self.minutes else ""
        more += ", in a window" if self.window else ""
        return f"{self.capture}{size}, {self.splats:,} splats{more}"


CASES = (
    Case(capture="banana", downscale=2, splats=20_000, use="choose"),
    Case(capture="banana", downscale=2, splats=55_000, use="choose"),
    Case(capture="banana", splats=50_000, use="choose"),
    Case(capture="playbot-rgba-100", splats=10_000, use="choose"),
    Case(capture="playbot-rgba-100", splats=120_000, use="choose"),
    Case(capture="miku", downscale=4, splats=20_000, use="judge"),
    Case(capture="miku", downscale=4, splats=75_000, use="judge"),
    Case(capture="miku", downscale=4, splats=60_000, use="judge", steps=1500),
    Case(capture="miku", downscale=2, splats=60_000, use="judge"),
    Case(capture="skull-close-80", splats=20_000, use="judge"),
    Case(capture="skull-rgba-100", splats=100_000, use="judge"),
    Case(capture="banana", downscale=2, splats=15_000, use="judge", options=("--strategy", "classic")),
    Case(capture="playbot-rgba-18", splats=20_000, use="judge", options=("--batch", "2")),
    Case(capture="miku", downscale=4, splats=500_000, use="judge", options=("--memory", "600MB")),
    Case(capture="toy", downscale=2, splats=20_000, use="judge", minutes=6),
    Case(capture="playbot-rgba-100", splats=50_000, use="choose", window=True),
    Case(capture="miku", downscale=4, splats=70_000, use="judge", window=True),
)


def arguments(case: Case, folder: Path, output: Path) -> list[str]:
    """Of the program."""
    ends = ["--minutes", case.minutes] if case.minutes else ["--iterations", case.steps]
    limits = [*ends, "--max-splats", case.splats, "--threads", THREADS]
    given = ["train", folder, "--downscale", case.downscale, *limits, *case.options]
    given += ["-o", output / "scene.ply", "--metrics", output / "metrics.jsonl"]
    return [str(one) for one in given] + ([] if case.window else ["--headless"])


def measured(case: Case, folder: Path) -> dict[str, Any]:
    """Peak of the run's resident memory in bytes, with what its metrics say."""
    with ExitStack() as stack:
        output = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        environment = dict(os.environ)
        if case.window:
            made = stack.enter_context(screen("1280x800"))
            environment |= {"DISPLAY": made.display, "LIBGL_ALWAYS_SOFTWARE": "1"}
            environment |= {"SPLATVIEW_CONFIG_DIR": str(output)}
            environment.pop("WAYLAND_DISPLAY", None)
        command = [sys.executable, "-c", PROGRAM, *arguments(case, folder, output)]
        with open(output / "said.txt", "wb") as said:
            process = subprocess.Popen(command, env=environment, stdout=said, stderr=said)
        if case.window:
            wait_for_end(process, output / "metrics.jsonl", case.steps)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{case.name}: {(output / 'said.txt').read_text()}")
        lines = [json.loads(line) for line in (output / "metrics.jsonl").read_text().splitlines()]
        said = " ".join((output / "said.txt").read_text().split())
        if case.minutes and "the first one is shown" not in said:
            raise SystemExit(f"{case.name}: it has trained one alone; give it more minutes")
    scale = 1 if sys.platform == "darwin" else 1024
    return {
        "bytes": usage.ru_maxrss * scale,
        "said": lines[0]["memory"]["bytes"],
        "splats": lines[0]["memory"]["splats"],
        "gaussians": max(line["gaussians"] for line in lines),
    }


def wait_for_end(process: subprocess.Popen[bytes], metrics: Path, steps: int) -> None:
    """Closes the window once the run in it is over."""
    limit = time.monotonic() + WAIT
    while time.monotonic() < limit:
        if metrics.exists() and f'"iteration": {steps},' in metrics.read_text():
            time.sleep(5)  # what is shown of the end
            break
        time.sleep(0.5)
    process.send_signal(signal.SIGTERM)


def stated(run: dict[str, Any]) -> int:
    """Bytes, by the constants as they are."""
    memory = run_memory(
        PhotoSizes(**run["sizes"]),
        resolution=TrainSettings.resolution,
        batch=run["batch"],
        stereo=run["stereo"],
        ensemble=run.get("ensemble", 1),
        machine=Machine(left=0, threads=THREADS, compiles=False),
        window=run["window"],
    )
    return memory.peak(run["splats"])


def row(run: dict[str, Any]) -> list[str]:
    said = stated(run)
    return [
        run["name"],
        run["use"],
        f"{run['sizes']['pixels'] / 1e6:.1f}",
        f"{said / 1e6:.0f}",
        f"{run['bytes'] / 1e6:.0f}",
        f"{said / run['bytes']:.2f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?")
    parser.add_argument("made", type=Path, nargs="?")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="cases whose names hold one of these")
    parser.add_argument("--table", action="store_true", help="measure nothing")
    options = parser.parse_args()
    path = FOLDER / "training_memory.json"
    runs = {run["name"]: run for run in json.loads(path.read_text())["runs"]} if path.exists() else {}
    for case in () if options.table else CASES:
        if options.only and not any(part in case.name for part in options.only):
            continue
        folder = options.data / "captures" / case.capture
        if not folder.exists():
            folder = options.made / case.capture
        capture = load_capture(folder, downscale=case.downscale)
        sizes = sizes_of_capture(capture)
        kept = {"name": case.name, "use": case.use, "window": case.window}
        kept["stereo"] = begins_by_stereo("auto", **own_points(capture))
        kept["ensemble"] = MEMBERS if case.minutes else 1
        kept["batch"] = int(case.options[1]) if "--batch" in case.options else 1
        runs[case.name] = {**kept, "sizes": asdict(sizes), **measured(case, folder)}
        print(*row(runs[case.name]), sep="  ", flush=True)
        write(path, runs)
    write(path, runs)


def write(path: Path, runs: dict[str, dict[str, Any]]) -> None:
    ordered = [runs[case.name] for case in CASES if case.name in runs]
    write_results(
        path,
        {
            "runs": ordered,
            "table": {
                "columns": ["run", "rules", "megapixels", "stated, MB", "measured, MB", "stated / measured"],
                "rows": [row(run) for run in ordered],
                "note": "Largest resident memory of the process, evaluations, checkpoint and saving included;"
                " 300 steps, or as stated, in which the number of splats reaches its limit. Constants were"
                " chosen on the runs marked so, and are only judged by the others.",
            },
        },
    )


if __name__ == "__main__":
    main()
