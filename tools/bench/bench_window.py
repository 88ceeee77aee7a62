"""How soon the window is there, and what it takes of a core when nobody touches it.

    python tools/bench/bench_window.py [SCENE ...] [--rounds N] [--renderer NAME] [-o JSON]

The command itself opens each scene, or the demo, in a window under Xvfb, again and again; the first start of
each counts for nothing, as it fills caches. Timed from the begin of the process are the end of the first
frame, and the moment when the scene's picture has come in full. Then nobody touches the window: after
some seconds its processor time is that of the whole process, by the system.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from harness import PANELS, gl_in_words, make_parser, screen, spread, window_environment

from splatview.measure.machine import write_results

SIZE = (1280, 800)

CALM_SECONDS, IDLE_SECONDS = 6.0, 20.0
"""Before the window is taken to be idle, and for how long it is watched."""

LIMIT = 60.0
"""Seconds for a picture in full."""


def window(begun: float, scene: str, renderer: str, report: str) -> None:
    """The process of the window: the command, with a clock before each frame."""
    from splatview.cli import start
    from splatview.viewer import app as application

    frames: list[float] = []

    class Timed(application.Window):
        def before_frame(self) -> None:
            frames.append(time.time() - begun)
            super().before_frame()
            if (
                len(frames) > 1
                and not Path(report).exists()
                and self.app.is_open
                and not self.app.picture.busy
            ):
                found = {"frame": frames[1], "scene": time.time() - begun}
                Path(report).write_text(json.dumps(found | {"gl": gl_in_words()}))

    application.Window = Timed  # pyright: ignore[reportPrivateImportUsage]
    sys.argv = ["splatview", *([scene] if scene else []), "--renderer", renderer]
    start()


def processor_seconds(pid: int) -> float:
    """Of all threads of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def one_start(scene: Path | None, renderer: str, environment: dict[str, str]) -> dict[str, Any]:
    """Seconds to the first frame and to the scene; share of a core when idle; what draws the window."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.json"
        command = [sys.executable, __file__, "--window", str(time.time()), str(scene or ""), renderer, report]
        process = subprocess.Popen(command, env=environment)
        try:
            limit = time.perf_counter() + LIMIT
            while not (report.exists() and report.stat().st_size):
                time.sleep(0.05)
                if time.perf_counter() > limit or process.poll() is not None:
                    raise SystemExit(f"{scene or 'demo'}: no picture")
            found: dict[str, Any] = json.loads(report.read_text())
            time.sleep(CALM_SECONDS)
            begun, used = time.perf_counter(), processor_seconds(process.pid)
            time.sleep(IDLE_SECONDS)
            used = processor_seconds(process.pid) - used
            return found | {"idle": used / (time.perf_counter() - begun)}
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait()


def cell(values: list[float], scale: float, digits: int) -> str:
    """The median, and in brackets the least and the most."""
    scaled = scale * np.array(values)
    return spread(float(np.median(scaled)), (scaled.min(), scaled.max()), digits)


def main() -> None:
    if sys.argv[1:2] == ["--window"]:
        begun, scene, renderer, report = sys.argv[2:]
        window(float(begun), scene, renderer, report)
        return
    parser = make_parser(__doc__, "window.json", scenes=True)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--renderer", default="auto")
    options = parser.parse_args()
    results, rows = [], []
    with (
        screen(f"{SIZE[0] + PANELS[0]}x{SIZE[1] + PANELS[1]}") as made,
        tempfile.TemporaryDirectory() as folder,
    ):
        environment = window_environment(made.display, folder)
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # a user's Python keeps what it compiles
        for scene in options.scenes or [None]:
            path = scene and scene.resolve()
            one_start(path, options.renderer, environment)
            found = [one_start(path, options.renderer, environment) for _ in range(options.rounds)]
            name = scene.name if scene else "the demo"
            results.append({"scene": name, "rounds": found})
            frame, whole, idle = ([round_[kind] for round_ in found] for kind in ("frame", "scene", "idle"))
            rows.append([name, cell(frame, 1, 2), cell(whole, 1, 2), cell(idle, 100, 1)])
            print(*rows[-1], sep=" | ", flush=True)
    table = {
        "columns": ["scene", "first frame, s", "scene in full, s", "idle, % of a core"],
        "rows": rows,
        "note": f"From the begin of the process, every start but the first; medians of {options.rounds}"
        f" (least to most). Idle: {IDLE_SECONDS:g} s without a touch. Drawn {results[0]['rounds'][0]['gl']}.",
    }
    write_results(options.output, {"results": results, "table": table})


if __name__ == "__main__":
    main()
