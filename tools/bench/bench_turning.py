"""How smoothly a scene turns in the window where OpenGL is software: pictures a second under a real drag.

    python tools/bench/bench_turning.py SCENE [--size WxH] [--seconds S] [--rounds N]

Opens the window on a screen without a monitor (Xvfb), lets xdotool drag the mouse over the picture to and
fro, and notes when a new picture and when a frame of the window is shown. Each way of drawing gets a
window of its own, in turn, `--rounds` times over. `--size` is the picture's, not the window's.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from harness import PANELS, in_window, make_parser

from splatview.measure.machine import write_results
from splatview.viewer.state import AppState

WAYS = {
    "clock": "all splats, frames by the clock",
    "splats": "all splats, frames by pictures",
    "all": "merged splats, frames by pictures",
}
"""The last is what the program does; each one before lacks something more."""

CLOCK_FPS = 24.0

STEP_SECONDS = 1 / 60
"""Between two movements of the mouse."""

TO_AND_FRO = 120
"""Movements one way, 3 px each, before the mouse turns back: a quarter turn about the scene in 2 s."""


def drag(display: str, at: tuple[int, int], seconds: float) -> subprocess.Popen[bytes]:
    """The mouse, dragged to and fro from `at` at constant speed, in a process of its own."""
    steps = int(seconds / STEP_SECONDS)
    command = ["xdotool", "mousemove", str(at[0]), str(at[1]), "sleep", "0.3", "mousedown", "1"]
    for step in range(steps):
        away = 3 * (TO_AND_FRO - abs(TO_AND_FRO - step % (2 * TO_AND_FRO)))
        command += ["mousemove", str(at[0] + away), str(at[1]), "sleep", f"{STEP_SECONDS:.4f}"]
    command += ["mouseup", "1"]
    return subprocess.Popen(command, env=dict(os.environ, DISPLAY=display))


def watch(scene: Path, way: str, size: tuple[int, int], seconds: float, report: Path) -> None:
    """Run in a process of its own: the window, and what is seen in it."""
    from splatview.renderers import async_renderer, quality
    from splatview.viewer import app as app_module
    from splatview.viewer import viewport
    from splatview.viewer.picture import Picture

    started: list[bool] = []
    notes: list[str] = []
    frames: list[float] = []
    pictures: list[tuple[float, int]] = []
    found: dict[str, Any] = {}
    if way in ("clock", "splats"):
        async_renderer.make_levels = lambda gaussians, stop: (quality.Level(gaussians),)
    if way == "clock":
        async_renderer.AsyncRenderer.wait = lambda self, seconds: None
        app_module.MAX_FPS = app_module.SOFTWARE_FPS = CLOCK_FPS
    app_module.look_for_abandoned = lambda app: None  # no dialog over the picture
    real_upload, real_draw = Picture._upload, viewport.draw_picture

    def act(app: AppState) -> None:
        """What a user does, beside the frame loop. ImGui's test engine would shut out the real mouse."""
        settle(app)
        drag(os.environ["DISPLAY"], (250, 60 + size[1] // 2), 1.0).wait()  # prices are found out
        settle(app)
        drag(os.environ["DISPLAY"], (250, 60 + size[1] // 2), 2.0).wait()  # and compared with what it takes
        settle(app)
        frames.clear()
        pictures.clear()
        begun = os.times()
        drag(os.environ["DISPLAY"], (250, 60 + size[1] // 2), seconds).wait()
        ended, done = time.perf_counter(), os.times()
        settle(app)
        found.update(summary(frames, pictures, ended))
        used = done.user + done.system - begun.user - begun.system
        found["cores"] = used / (done.elapsed - begun.elapsed)
        found["size"] = list(app.picture_size)
        found["note"] = next((note for note in reversed(notes) if note), "in full")
        report.write_text(json.dumps(found))
        app.quitting = True

    def upload(self, image):
        real_upload(self, image)
        pictures.append((time.perf_counter(), image.shape[0]))
        notes.append(self.note)

    def draw(app, *arguments):
        if not started:
            started.append(True)
            threading.Thread(target=act, args=(app,), daemon=True).start()
        frames.append(time.perf_counter())
        real_draw(app, *arguments)

    Picture._upload = upload
    viewport.draw_picture = draw
    app_module.run_window([scene], size=(size[0] + PANELS[0], size[1] + PANELS[1]), renderer="cpu")


def settle(app: AppState) -> None:
    """Waits until nothing is on its way."""
    time.sleep(0.5)
    while app.waiting or app.transition or not app.is_open or pricing():
        time.sleep(0.01)


def pricing() -> bool:
    return any(thread.name == "splatview-cpu-plan" for thread in threading.enumerate())


def summary(frames: list[float], pictures: list[tuple[float, int]], ended: float) -> dict[str, Any]:
    """Rates and gaps while the mouse moved, and how long after it the last picture came."""
    moving = [at for at, _ in pictures if at < ended]
    shown = [at for at in frames if moving[0] <= at <= moving[-1]]
    gaps = 1000 * np.diff(moving)
    return {
        "pictures_per_s": 1000 / float(gaps.mean()),
        "gap_ms": [float(np.percentile(gaps, share)) for share in (50, 95, 100)],
        "frames_per_s": len(shown) / (shown[-1] - shown[0]),
        "rows": sorted({rows for at, rows in pictures if at < ended}),
        "rest_s": pictures[-1][0] - ended,
    }


def main() -> None:
    parser = make_parser(__doc__, "turning.json", size="1280x720")
    parser.add_argument("--seconds", type=float, default=8.0)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--remark", default="", help="a sentence on the circumstances, for the table")
    parser.add_argument("--way", choices=WAYS, help=argparse.SUPPRESS)
    options = parser.parse_args()
    width, height = options.size
    if options.way:
        watch(options.scene, options.way, options.size, options.seconds, options.output)
        return
    rounds: dict[str, list[dict[str, Any]]] = {way: [] for way in WAYS}
    for _ in range(options.rounds):
        for way, found in rounds.items():
            size = ["--size", f"{width}x{height}", "--seconds", options.seconds]
            arguments = [options.scene, *size, "--way", way, "-o"]
            found.append(in_window(__file__, arguments, options.size, timeout=120))
            print(way, found[-1], flush=True)
    write_results(
        options.output,
        {
            "scene": options.scene.name,
            "seconds": options.seconds,
            "rounds": {WAYS[way]: found for way, found in rounds.items()},
            "table": {
                "columns": [
                    "way of drawing",
                    "pictures a second",
                    "ms between two: median",
                    "95 %",
                    "left out while moving",
                    "sharp after",
                ],
                "rows": [row(WAYS[way], found) for way, found in rounds.items()],
                "note": f"{options.scene.name} at {width}x{height} in a window that Mesa's llvmpipe draws, "
                f"dragged for {options.seconds:g} s; medians of {options.rounds} window(s) each, in turn. "
                f"{options.remark}".strip(),
            },
        },
    )


def row(way: str, found: list[dict[str, Any]]) -> list[str]:
    def median(*path: Any) -> float:
        values = found
        for key in path:
            values = [value[key] for value in values]
        return float(np.median(np.array(values, float)))

    return [
        way,
        f"{median('pictures_per_s'):.0f}",
        f"{median('gap_ms', 0):.0f}",
        f"{median('gap_ms', 1):.0f}",
        found[-1]["note"],
        f"{median('rest_s'):.2f} s",
    ]


if __name__ == "__main__":
    main()
