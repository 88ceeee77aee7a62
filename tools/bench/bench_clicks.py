"""How soon the window answers clicks and keys at 500,000 splats.

    python tools/bench/bench_clicks.py SCENE [--rounds N] [--renderer NAME] [-o JSON]

A window of 1280 x 800 under Xvfb gets a key or a mouse button, and the time is taken until the end of the
frame that shows the answer: the document, the page, the mode has changed, or progress of slow work is shown.
Counted besides are the longest frame until then, and the time until the picture is drawn in full again.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import gl_in_words, in_window, make_parser, spread
from imgui_bundle import ImVec2

from splatview.measure.machine import write_results
from splatview.renderers import VisualMode
from splatview.viewer import commands, layout
from splatview.viewer.app import run_window
from splatview.viewer.editing.cleanup import forget
from splatview.viewer.editing.session import EditSession, session_of
from splatview.viewer.state import AppState, Feature
from splatview.viewer.view_aids import ViewAids

SIZE = (1280, 800)

LIMIT = 60.0
"""Seconds for a picture in full."""


class Frames(Feature):
    """When frames began, and when the one had ended that first showed what is waited for."""

    def __init__(self) -> None:
        self.begun: list[float] = []
        self.shown_at: float | None = None
        self._answered: Callable[[], bool] = lambda: False
        self._is_shown = False
        self.gl = ""

    def watch(self, answered: Callable[[], bool]) -> None:
        self.begun.clear()
        self.shown_at, self._is_shown, self._answered = None, False, answered

    def before_frame(self, app: AppState) -> None:
        self.gl = self.gl or gl_in_words()
        now = time.perf_counter()
        self.begun.append(now)
        if self._is_shown and self.shown_at is None:
            self.shown_at = now
        self._is_shown = self._is_shown or self._answered()


class Clicks:
    """The hands on one window, with a clock."""

    def __init__(self, app: AppState, ctx: Any):
        self.app, self.ctx = app, ctx
        self.frames = Frames()
        app.add(self.frames)
        self.found: dict[str, list[dict[str, float]]] = {}

    @property
    def session(self) -> EditSession:
        session = session_of(self.app)
        assert session is not None
        return session

    def settle(self) -> None:
        limit = time.perf_counter() + LIMIT
        calm = 0
        while calm < 5:
            self.ctx.yield_(1)
            resting = not self.app.waiting and self.app.is_open and self.app.transition is None
            calm = calm + 1 if resting else 0
            if time.perf_counter() > limit:
                raise AssertionError("the window does not settle")

    def timed(
        self, name: str, act: Callable[[], object], answered: Callable[[], bool], *, settled: bool = True
    ) -> None:
        """`act` gives the last event; `settled`: when all before it is done."""
        if settled:
            self.settle()
        assert not answered(), f"{name}: answered before it was asked"
        self.frames.watch(answered)
        begun = time.perf_counter()
        act()
        while self.frames.shown_at is None:
            self.ctx.yield_(1)
            if time.perf_counter() - begun > LIMIT:
                raise AssertionError(f"{name}: no answer")
        shown = self.frames.shown_at
        times = [begun, *(at for at in self.frames.begun if begun < at <= shown)]
        while self.app.picture.busy:
            self.ctx.yield_(1)
        entry = {
            "answer": shown - begun,
            "frame": float(np.diff(times).max()),
            "whole": max(time.perf_counter(), shown) - begun,
        }
        self.found.setdefault(name, []).append({key: 1000 * value for key, value in entry.items()})

    def key(self, name: str, chord: str, answered: Callable[[], bool]) -> None:
        self.timed(name, lambda: self.ctx.key_down(commands.chord(chord)), answered)
        self.ctx.key_up(commands.chord(chord))

    def button(self, name: str, ref: str, answered: Callable[[], bool], *, settled: bool = True) -> None:
        """A press on an item; timed is what follows the release."""
        self.ctx.mouse_move(ref)
        self.ctx.mouse_down(0)
        self.timed(name, lambda: self.ctx.mouse_up(0), answered, settled=settled)

    def page(self, name: str) -> None:
        shown = next(page.window for page in layout.PAGES if page.name == name)

        def there() -> bool:
            window = self.ctx.get_window_by_ref(f"//{shown}")
            return self.app.page == name and window is not None and window.active

        self.button(f"page {name}", f"//##rail/{name}", there)

    def place(self, x: float, y: float) -> ImVec2:
        view = self.ctx.window_info("//View").rect_full
        return ImVec2(view.min.x + x * view.get_width(), view.min.y + y * view.get_height())

    def stroke(self, name: str, points: list[tuple[float, float]]) -> None:
        """A drag; timed is what follows the release of the button."""
        self.ctx.mouse_teleport_to_pos(self.place(*points[0]))
        self.ctx.yield_(2)
        self.ctx.mouse_down(0)
        for point in points[1:]:
            self.ctx.mouse_teleport_to_pos(self.place(*point))
            self.ctx.yield_(1)
        before = len(self.session.document.history.done)
        self.timed(
            name,
            lambda: self.ctx.mouse_up(0),
            lambda: self.session.job is not None or len(self.session.document.history.done) > before,
        )


def go_through(clicks: Clicks) -> None:
    """Everything once."""
    app, ctx = clicks.app, clicks.ctx
    for page in ("View", "Edit", "Accuracy", "Train", "Scene"):  # Edit is open at the end
        clicks.page(page)
    modes: tuple[VisualMode, ...] = ("points", "ellipsoids", "depth", "overdraw", "normals", "splats")
    for key, mode in zip("234561", modes, strict=True):
        clicks.key(f"mode {mode}", key, lambda mode=mode: app.mode == mode)
    document = clicks.session.document
    ctx.key_press(commands.chord("Ctrl+Shift+A"))
    clicks.key("select all", "Ctrl+A", lambda: document.counts.selected > 0)
    clicks.key("select none", "Ctrl+Shift+A", lambda: document.counts.selected == 0)
    ctx.key_press(commands.chord("R"))
    clicks.stroke("rectangle", [(0.35, 0.3), (0.5, 0.4), (0.6, 0.6)])
    clicks.settle()
    clicks.key("delete", "Delete", lambda: document.counts.deleted > 0)
    clicks.key("undo", "Ctrl+Z", lambda: document.counts.deleted == 0)
    clicks.key("redo", "Ctrl+Y", lambda: document.counts.deleted > 0)
    ctx.key_press(commands.chord("Ctrl+Z"))
    ctx.key_press(commands.chord("C"))
    clicks.stroke("brush", [(0.4, 0.5), (0.45, 0.52), (0.5, 0.5), (0.55, 0.55)])
    ctx.key_press(commands.chord("Escape"))
    aids = app.feature(ViewAids)
    for name, chord in (("centres", "Shift+M"), ("rings", "Shift+R")):
        for on in (True, False):
            title = f"{name} {'on' if on else 'off'}"
            clicks.key(title, chord, lambda name=name, on=on: getattr(aids, name) == on)
    clicks.session.forms.open_section = "Clean up"
    ctx.yield_(10)
    ctx.set_ref("//Edit")

    def is_looked_for() -> bool:
        job = clicks.session.job
        return job is not None and job.title == "Looking for floaters"

    clicks.button(  # while all are being counted
        "detector: floaters", "Clean up/detectors/###clusters", is_looked_for, settled=False
    )
    if (job := clicks.session.job) is not None:
        job.cancel()
    app.post(forget)
    clicks.session.forms.open_section = "Colour & opacity"
    clicks.settle()
    slider = ctx.item_info("Colour & opacity/##Brightness").rect_full
    ctx.mouse_teleport_to_pos(ImVec2(slider.min.x + 0.6 * slider.get_width(), slider.get_center().y))
    clicks.timed(
        "slider: brightness", lambda: ctx.mouse_down(0), lambda: clicks.session.forms.previewing != ""
    )
    ctx.mouse_up(0)
    clicks.settle()
    app.post(lambda app: clicks.session.cancel_preview())
    clicks.settle()


def window(scene: str, renderer: str, rounds: int, report: str) -> None:
    found: dict[str, Any] = {}

    def act(app: AppState, ctx: Any) -> None:
        clicks = Clicks(app, ctx)
        clicks.settle()
        app.prefer(smooth=False)
        for _ in range(rounds + 1):
            go_through(clicks)
        found.update(clicks.found, splats=len(app.scene.gaussians), renderer=app.picture.backend)
        found["gl"] = clicks.frames.gl

    if run_window([Path(scene)], size=SIZE, renderer=renderer, drive=act) != 0:
        raise SystemExit("the window was not driven to the end")
    Path(report).write_text(json.dumps(found))


KINDS = ("answer", "frame", "whole")


def main() -> None:
    if sys.argv[1] == "--window":
        scene, renderer, rounds, report = sys.argv[2:]
        window(scene, renderer, int(rounds), report)
        return
    parser = make_parser(__doc__, "clicks.json", scene=True)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--renderer", default="auto")
    options = parser.parse_args()
    arguments = ("--window", options.scene.resolve(), options.renderer, options.rounds)
    found = in_window(__file__, arguments, (SIZE[0], SIZE[1]), timeout=900)
    splats, renderer, gl = (found.pop(name) for name in ("splats", "renderer", "gl"))
    clicks, rows = {}, []
    for name, entries in found.items():
        entries = entries[len(entries) // (options.rounds + 1) :]  # the first round compiles
        clicks[name] = {kind: [entry[kind] for entry in entries] for kind in KINDS}
        ms = {kind: np.array(clicks[name][kind]) for kind in KINDS}
        rows.append(
            [
                name,
                spread(float(np.median(ms["answer"])), (ms["answer"].min(), ms["answer"].max())),
                f"{np.median(ms['frame']):.0f}",
                f"{np.median(ms['whole']):.0f}",
            ]
        )
        print(*rows[-1], sep=" | ", flush=True)
    table = {
        "columns": ["click or key", "answered, ms", "longest frame, ms", "picture in full, ms"],
        "rows": rows,
        "note": f"{options.scene.name}, {splats:,} splats, a picture of {SIZE[0]} x {SIZE[1]} drawn by"
        f" `{renderer}` {gl}; medians of {options.rounds} (least to most).",
    }
    write_results(options.output, {"scene": options.scene.name, "clicks_ms": clicks, "table": table})


if __name__ == "__main__":
    main()
