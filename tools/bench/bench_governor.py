"""How well a frame budget is held in the window while one flies, and how soon the exact picture is back.

    python tools/bench/bench_governor.py SCENE [--size WxH] [--pictures N]

Opens the window on a screen without a monitor (Xvfb), flies round the scene and towards it and back, and
notes what drawing each picture took and how it was reduced. Writes governor.json.
"""

from __future__ import annotations

import argparse
import json
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
from harness import PANELS, in_window, make_parser

from splatview.measure.machine import write_results
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.state import AppState

BUDGETS = {"cpu": (20.0, 30.0, 45.0), "quads": (250.0, 400.0)}
"""ms, within what software OpenGL and the CPU can do with half a million splats."""

LEARNING = 12
"""Pictures under a budget that are not counted: the governor finds out about the machine."""

PATIENCE = 200.0


def fly(app: AppState, number: int) -> None:
    """The next of the way's positions."""
    from splatview.viewer.navigation import orbit
    from splatview.viewer.navigation.controllers import dolly

    app.steer(dolly(orbit(app.view, 0.012, 0.0), 1.0 + 0.01 * np.sin(number / 15)))


def watch(scene: Path, renderer: str, size: tuple[int, int], pictures: int, report: Path) -> None:
    """Run in a process of its own: the window, and what is seen in it."""
    from splatview.renderers.async_renderer import AsyncRenderer
    from splatview.viewer import app as app_module
    from splatview.viewer import viewport

    real_render = AsyncRenderer._render
    app_module.look_for_abandoned = lambda app: None  # no dialog over the picture
    real_draw, started, found = viewport.draw_picture, [], {}
    frames: list[tuple[int, float, tuple[int, int], str]] = []

    def render(self: Any, request: Any, shortcut: Any) -> None:
        real_render(self, request, shortcut)
        reduced = "" if shortcut is None or shortcut.exact else shortcut.note
        frames.append(
            (
                len(frames),
                sum(self._stats.ms.values()),
                (request.camera.width, request.camera.height),
                reduced,
            )
        )

    def note(app: AppState) -> None:
        if renderer == "cpu":
            return  # drawn in a thread of its own, and noted there
        stats, picture = app.stats, app.picture
        if stats is None or picture is None or not stats.ms:
            return
        if not frames or frames[-1][0] != stats.drawn:
            reduced = app.feature(Accuracy).note or picture.note
            frames.append((stats.drawn, sum(stats.ms.values()), picture.texture.size, reduced))

    def draw(app: AppState, *arguments: Any) -> None:
        real_draw(app, *arguments)
        note(app)
        if not started:
            started.append(True)
            threading.Thread(target=act, args=(app,), daemon=True).start()

    def settle(app: AppState) -> None:
        time.sleep(0.5)
        limit = time.monotonic() + PATIENCE
        while app.waiting or app.transition or not app.is_open or pricing():
            assert time.monotonic() < limit, "the window does not settle"
            time.sleep(0.01)

    def one_step(app: AppState, number: int, done: threading.Event) -> None:
        fly(app, number)
        done.set()

    def begin_to_measure(app: AppState, begun: threading.Event) -> None:
        app.feature(Accuracy).measure(app)
        begun.set()

    def pictures_while_flying(app: AppState, wanted: int) -> list[tuple[int, float, tuple[int, int], str]]:
        frames.clear()
        number, limit = 0, time.monotonic() + PATIENCE
        while len(frames) < wanted and time.monotonic() < limit:
            done = threading.Event()
            app.post(one_step, number, done)
            app.feature(Accuracy).wake()
            done.wait(1.0)
            number += 1
        return list(frames)

    def act(app: AppState) -> None:
        try:
            settle(app)
            app.prefer(smooth=False)
            begun = threading.Event()
            app.post(begin_to_measure, begun)
            assert begun.wait(PATIENCE), "nothing is measured"
            settle(app)
            found["size"] = list(app.picture_size)
            ladder = app.feature(Accuracy).ladder
            found["priced"] = [f"{one.rung.knob} {one.rung.value}" for one in ladder.rungs] if ladder else []
            exact = app.picture.texture.size
            full = [ms for _, ms, size, note in pictures_while_flying(app, LEARNING) if not note]
            found["full_ms"] = float(np.median(full)) if full else None
            settle(app)
            found["budgets"] = []
            for budget in BUDGETS[renderer]:
                app.post(lambda app, budget=budget: app.feature(Accuracy).hold(app, budget))
                pictures_while_flying(app, LEARNING)
                settle(app)  # what is to be found out about prices is found out at rest
                pictures_while_flying(app, LEARNING)
                flown = pictures_while_flying(app, pictures)
                frames.clear()
                settle(app)
                if renderer != "cpu":  # times come a frame late, or never
                    frames.append((-1, 0.0, app.picture.texture.size, app.feature(Accuracy).note))
                after = [(size == exact and not note) for _, _, size, note in frames]
                times = [ms for _, ms, _, _ in flown]
                found["budgets"].append(
                    {
                        "budget_ms": budget,
                        "median_ms": float(np.median(times)),
                        "quartiles_ms": [float(v) for v in np.percentile(times, [25, 75])],
                        "pictures": len(times),
                        "reduced": flown[-1][3],
                        "pictures_until_exact": after.index(True) + 1 if True in after else None,
                    }
                )
            report.write_text(json.dumps(found))
        finally:
            app.quitting = True

    viewport.draw_picture = draw
    AsyncRenderer._render = render
    app_module.run_window([scene], size=(size[0] + PANELS[0], size[1] + PANELS[1]), renderer=renderer)


def pricing() -> bool:
    return any(thread.name == "splatview-cpu-plan" for thread in threading.enumerate())


def row(renderer: str, found: dict[str, Any], one: dict[str, Any]) -> list[str]:
    low, high = one["quartiles_ms"]
    full = found["full_ms"]
    return [
        f"`{renderer}`",
        "-" if full is None else f"{full:.0f}",
        f"{one['budget_ms']:.0f}",
        f"{one['median_ms']:.1f} ({low:.1f} to {high:.1f})",
        f"{one['median_ms'] / one['budget_ms'] - 1:+.0%}",
        one["reduced"] or "nothing",
        str(one["pictures_until_exact"]),
    ]


def main() -> None:
    parser = make_parser(__doc__, "governor.json", size="640x360")
    parser.add_argument("--pictures", type=int, default=60)
    parser.add_argument("scene", type=Path)
    parser.add_argument("--remark", default="", help="a sentence on the circumstances, for the table")
    parser.add_argument("--renderer", choices=BUDGETS)
    parser.add_argument("--watch", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    width, height = options.size
    if options.watch:
        watch(options.scene, options.renderer, options.size, options.pictures, options.watch)
        return
    renderers = [options.renderer] if options.renderer else list(BUDGETS)
    made = {}
    for renderer in renderers:
        size = ["--size", f"{width}x{height}", "--pictures", options.pictures]
        arguments = [options.scene, *size, "--renderer", renderer, "--watch"]
        made[renderer] = in_window(__file__, arguments, options.size, timeout=600)
        print(renderer, json.dumps(made[renderer], indent=1), flush=True)
    write_results(
        options.output,
        {
            "scene": options.scene.name,
            "renderers": made,
            "table": {
                "columns": [
                    "drawn by",
                    "in full, ms",
                    "budget, ms",
                    "median while flying, ms (quartiles)",
                    "off the budget",
                    "left out at the end",
                    "pictures until exact at rest",
                ],
                "rows": [row(name, found, one) for name, found in made.items() for one in found["budgets"]],
                "note": f"{options.scene.name} at {width}x{height} in a window that llvmpipe draws; "
                f"{options.pictures} pictures a budget flying round and to and fro. "
                f"Until the exact one, those count that were under way when the camera stopped. "
                f"{options.remark}".strip(),
            },
        },
    )


if __name__ == "__main__":
    main()
