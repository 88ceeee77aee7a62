"""Trains in a real window under Xvfb while the view is flown, and says what either costs the other.

    python tools/bench/soak_training.py [CAPTURE] [--minutes 10] [--downscale K] [--max-splats N]

Without a capture it is the demo's. Four kinds of seconds take turns, so that a machine that drifts, and a
scene that grows, decide nothing: the window stands still (as if there were none), it is left alone, the
view flies, and the view flies while training pauses. Ends with an error if an update got lost: if steps
shown ever went back, or if the last picture is not of the last step.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import threading
import time
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from harness import make_parser, screen

from splatview.cli import train
from splatview.cli import train as train_window
from splatview.measure.machine import write_results
from splatview.viewer.commands import quit_window
from splatview.viewer.navigation import Transition, orbit
from splatview.viewer.state import AppState, process_memory
from splatview.viewer.training.live import LiveTraining

BLOCK_SECONDS = 4.0
SETTLING_SECONDS = 2.0
"""Between blocks: the last one's pictures and shares of cores are out of the way then."""

KINDS = ("no viewer", "left alone", "flown", "flown, training paused")
TURN = 2.0
"""Radians that the view is turned by in a block."""


class Soak:
    """The user who watches, and what he notes."""

    def __init__(self, minutes: float):
        self.seconds = 60 * minutes
        self.app: AppState | None = None
        self.kind: str | None = None
        self.frames: dict[str, list[float]] = defaultdict(list)
        """Seconds between frames, by kind."""
        self.rates: list[tuple[str, float]] = []
        """Steps a second of each block, in order."""
        self.work: dict[str, list[float]] = defaultdict(list)
        """Processor milliseconds of the whole program a step, by kind: what other programs on the machine
        take does not count there."""
        self.memory: list[tuple[float, float, int, float]] = []
        """(seconds, MiB, splats, MiB of a snapshot) after each round."""
        self.shown: list[int] = []
        """Steps of the snapshots shown, in order."""
        self.problems: list[str] = []
        self.window: dict[str, Any] = {}
        self._last_frame: tuple[str, float] | None = None

    def watch(self, training: LiveTraining) -> None:
        """Called for every frame, in place of `LiveTraining.before_frame`."""
        app, now = training.app, time.perf_counter()
        if app is not None and self.app is None:
            self.app = app
            threading.Thread(target=self.act, args=(app, training), daemon=True).start()
        if self.kind is not None and self._last_frame is not None and self._last_frame[0] == self.kind:
            self.frames[self.kind].append(now - self._last_frame[1])
        self._last_frame = None if self.kind is None else (self.kind, now)
        if training.shown is not None and training.shown.iteration not in self.shown[-1:]:
            self.shown.append(training.shown.iteration)

    def act(self, app: AppState, training: LiveTraining) -> None:
        try:
            self.turns(app, training)
        except BaseException as error:
            self.problems.append(f"{type(error).__name__}: {error}")
        finally:
            app.post(quit_window)

    def turns(self, app: AppState, training: LiveTraining) -> None:
        wait(lambda: training.shown is not None and training.status.iteration > 100, 120)
        until = time.monotonic() + self.seconds
        direction = 1.0
        while time.monotonic() < until:
            for kind in KINDS:
                self.block(app, training, kind, direction)
            direction = -direction
            snapshot = training.shown
            assert snapshot is not None
            size = snapshot.gaussians.nbytes / 2**20
            self.memory.append(
                (training.status.seconds, process_memory() or 0.0, training.status.gaussians, round(size, 2))
            )
        training.thread.pause()
        wait(lambda: training.status.state == "paused", 60)
        wait(lambda: training.shown is not None and training.shown.iteration == training.status.iteration, 60)
        answer = training.thread.post(lambda session: session.trainer.splats.arrays.means.copy())
        assert training.shown is not None
        if not np.array_equal(answer.result(60), training.shown.gaussians.means):
            self.problems.append("the last picture is not of the trainer's scene")
        self.window = {
            "picture": list(app.picture_size),
            "renderer": app.picture.name,
            "gpu": app.gpu_name,
            "splats": training.status.gaussians,
            "steps": training.status.iteration,
            "share": app.preferences.training_share,
            "snapshots": training.thread.published,
            "publishing_share": training.thread.publishing_seconds / training.status.seconds,
        }

    def block(self, app: AppState, training: LiveTraining, kind: str, direction: float) -> None:
        if kind == "flown, training paused":
            training.thread.pause()
            wait(lambda: training.status.state == "paused", 60)
        time.sleep(SETTLING_SECONDS)
        if kind == "no viewer":
            # Frames stop, and with them all drawing.
            app.post(lambda app: time.sleep(BLOCK_SECONDS + 0.2))
            training.thread.share = 1.0
        elif kind.startswith("flown"):
            app.post(self.fly, direction)
        time.sleep(0.1)
        self.kind = kind
        begun, step, busy = time.perf_counter(), training.status.iteration, time.process_time()
        time.sleep(BLOCK_SECONDS)
        steps = training.status.iteration - step
        rate = steps / (time.perf_counter() - begun)
        if steps > 0:
            self.work[kind].append(1000 * (time.process_time() - busy) / steps)
        self.kind = None
        self.rates.append((kind, rate))
        if kind == "flown, training paused":
            if rate > 0:
                self.problems.append("steps were taken in a pause")
            training.thread.resume()

    @staticmethod
    def fly(app: AppState, direction: float) -> None:
        end = orbit(app.view, direction * TURN, 0.0)
        app.transition = Transition(start=app.view, end=end, began=app.now(), duration=BLOCK_SECONDS + 0.5)


def wait(condition, seconds: float) -> None:
    limit = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > limit:
            raise TimeoutError("waited in vain")
        time.sleep(0.02)


def ratios(rates: list[tuple[str, float]], kind: str) -> list[float]:
    """Each block's steps a second over those without a viewer just before and after it."""
    bare = [(place, rate) for place, (name, rate) in enumerate(rates) if name == "no viewer"]
    found = []
    for place, (name, rate) in enumerate(rates):
        before = [value for at, value in bare if at < place][-1:]
        after = [value for at, value in bare if at > place][:1]
        if name == kind and before:
            found.append(rate / statistics.mean(before + after))
    return found


def report(soak: Soak) -> dict[str, Any]:
    if any(a > b for a, b in zip(soak.shown, soak.shown[1:], strict=False)):
        soak.problems.append("a later picture was of an earlier step")
    speed = {kind: ratios(soak.rates, kind) for kind in ("left alone", "flown")}
    times = {
        kind: {
            "frames": len(frames),
            "median_ms": round(1000 * statistics.median(frames), 1),
            "p95_ms": round(1000 * float(np.percentile(frames, 95)), 1),
            "max_ms": round(1000 * max(frames), 1),
        }
        for kind, frames in soak.frames.items()
        if len(frames) > 2 and kind != "no viewer"
    }
    bare = [rate for kind, rate in soak.rates if kind == "no viewer"]
    work = {kind: statistics.median(values) for kind, values in soak.work.items()}
    rows = [["no viewer", f"{statistics.median(bare):.1f}", "1.00", f"{work['no viewer']:.0f}", "", ""]]
    for kind in KINDS[1:]:
        rate = statistics.median(value for name, value in soak.rates if name == kind)
        share = f"{statistics.median(speed[kind]):.2f}" if speed.get(kind) else ""
        frame = times.get(kind, {"median_ms": "", "p95_ms": ""})
        paced = kind == "left alone"
        rows.append(
            [
                kind,
                f"{rate:.1f}",
                share,
                f"{work[kind]:.0f}" if kind in work else "",
                "as asked for" if paced else str(frame["median_ms"]),
                "" if paced else str(frame["p95_ms"]),
            ]
        )
    half = len(soak.memory) // 2
    later = soak.memory[half:] or soak.memory
    growth = later[-1][1] - later[0][1]
    note = (
        f"{soak.seconds / 60:g} minutes, {soak.window.get('splats', 0):,} splats in the end, "
        f"{len(soak.shown):,} snapshots shown, none lost; snapshots took "
        f"{100 * soak.window.get('publishing_share', 0):.1f} % of training's time. Memory grew by "
        f"{growth:.0f} MiB in the second half, a snapshot by {later[-1][3] - later[0][3]:.1f} MiB. Picture "
        f"{'x'.join(map(str, soak.window.get('picture', [])))} by {soak.window.get('renderer')}, "
        f"{100 * soak.window.get('share', 0):.0f} % of the cores for training while the view moves."
    )
    return {
        "minutes": soak.seconds / 60,
        **soak.window,
        "problems": soak.problems,
        "speed_beside_no_viewer": speed,
        "processor_ms_a_step": {kind: round(value, 2) for kind, value in work.items()},
        "frames": times,
        "blocks": [{"kind": kind, "steps_a_second": round(rate, 2)} for kind, rate in soak.rates],
        "memory": [
            dict(zip(("seconds", "process_mib", "splats", "snapshot_mib"), row, strict=True))
            for row in soak.memory
        ],
        "shown": len(soak.shown),
        "table": {
            "columns": [
                "window",
                "steps a second",
                "of those without",
                "processor ms a step",
                "frame, median ms",
                "95 % within ms",
            ],
            "rows": rows,
            "note": note,
        },
    }


def main() -> None:
    parser = make_parser(__doc__, "training_window.json")
    parser.add_argument("capture", nargs="?")
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--downscale", default="1")
    parser.add_argument("--max-splats", default="50000")
    options = parser.parse_args()
    soak = Soak(options.minutes)
    real = LiveTraining.before_frame

    def watched(self: LiveTraining, app: AppState) -> None:
        real(self, app)
        soak.watch(self)

    LiveTraining.before_frame = watched
    with tempfile.TemporaryDirectory() as folder, screen() as made:
        os.environ |= {"SPLATVIEW_CONFIG_DIR": folder, "DISPLAY": made.display, "LIBGL_ALWAYS_SOFTWARE": "1"}
        os.environ.pop("WAYLAND_DISPLAY", None)
        arguments = ["--demo"] if options.capture is None else [options.capture]
        arguments += ["-o", str(Path(folder) / "soak.ply"), "--minutes", str(options.minutes)]
        arguments += ["--downscale", options.downscale, "--max-splats", options.max_splats]
        parsed = train.make_parser().parse(arguments)
        assert parsed is not None
        train_window.train_in_window(parsed, time.perf_counter(), lambda run: run.name)
    results = report(soak)
    write_results(options.output, results)
    for row in results["table"]["rows"]:
        print(*row, sep="  ")
    print(results["table"]["note"])
    if soak.problems:
        raise SystemExit("; ".join(soak.problems))


if __name__ == "__main__":
    main()
