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
from harness import in_window, make_parser, spread
from imgui_bundle import ImVec2, imgui

from splatview.measure.machine import write_results
from splatview.viewer import commands, layout
from splatview.viewer.app import run_window
from splatview.viewer.editing.session import EditSession, session_of
from splatview.viewer.state import AppState
from splatview.viewer.view_aids import ViewAids

SIZE = (1280, 800)

LIMIT = 60.0
"""Seconds for a picture in full."""


class Clicks:
    """The hands on one window, with a clock."""

    def __init__(self, app: AppState, ctx: Any):
        self.app, self.ctx = app, ctx
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

    def timed(self, name: str, act: Callable[[], object], answered: Callable[[], bool]) -> None:
        """`act` gives the last event and waits for no frame."""
        self.settle()
        begun = last = time.perf_counter()
        longest = 0.0
        act()
        while True:
            self.ctx.yield_(1)
            now = time.perf_counter()
            longest, last = max(longest, now - last), now
            if answered():
                break
            if now - begun > LIMIT:
                raise AssertionError(f"{name}: no answer")
        answer = now - begun
        while self.app.waiting or self.app.picture.busy:
            self.ctx.yield_(1)
        entry = {"answer": answer, "frame": longest, "whole": time.perf_counter() - begun}
        self.found.setdefault(name, []).append({key: 1000 * value for key, value in entry.items()})

    def key(self, chord: str) -> Callable[[], None]:
        """Press and release, as one event each."""
        value = commands.chord(chord)
        io = imgui.get_io()
        modifiers = {imgui.Key.mod_ctrl, imgui.Key.mod_shift, imgui.Key.mod_alt}
        held = [mod for mod in modifiers if int(value) & int(mod)]
        main = imgui.Key(int(value) & ~sum(int(mod) for mod in held))

        def press() -> None:
            for key in (*held, main):
                io.add_key_event(key, True)
            for key in (main, *held):
                io.add_key_event(key, False)

        return press

    def page(self, name: str) -> None:
        ref = f"//##rail/{name}"
        self.ctx.mouse_move(ref)
        shown = next(page.window for page in layout.PAGES if page.name == name)

        def there() -> bool:
            window = self.ctx.get_window_by_ref(f"//{shown}")
            return self.app.page == name and window is not None and window.active

        self.ctx.mouse_down(0)
        self.timed(f"page {name}", lambda: imgui.get_io().add_mouse_button_event(0, False), there)
        self.ctx.mouse_up(0)

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
            lambda: imgui.get_io().add_mouse_button_event(0, False),
            lambda: self.session.job is not None or len(self.session.document.history.done) > before,
        )
        self.ctx.mouse_up(0)


def go_through(clicks: Clicks) -> None:
    """Everything once."""
    app, ctx = clicks.app, clicks.ctx
    for page in ("Edit", "View", "Accuracy", "Train", "Scene"):
        clicks.page(page)
    for key, mode in zip(
        "234561", ("points", "ellipsoids", "depth", "overdraw", "normals", "splats"), strict=True
    ):
        clicks.timed(f"mode {mode}", clicks.key(key), lambda mode=mode: app.mode == mode)
    ctx.key_press(commands.chord("R"))
    clicks.stroke("rectangle", [(0.35, 0.3), (0.5, 0.4), (0.6, 0.6)])
    document = clicks.session.document
    selected = document.counts.selected
    clicks.timed("delete", clicks.key("Delete"), lambda: document.counts.deleted >= selected)
    clicks.timed("undo", clicks.key("Ctrl+Z"), lambda: document.counts.deleted == 0)
    clicks.timed("redo", clicks.key("Ctrl+Y"), lambda: document.counts.deleted >= selected)
    clicks.timed("undo", clicks.key("Ctrl+Z"), lambda: document.counts.deleted == 0)
    ctx.key_press(commands.chord("C"))
    clicks.stroke("brush", [(0.4, 0.5), (0.45, 0.52), (0.5, 0.5), (0.55, 0.55)])
    ctx.key_press(commands.chord("Escape"))
    clicks.timed("select all", clicks.key("Ctrl+A"), lambda: document.counts.selected > selected)
    clicks.timed("select none", clicks.key("Ctrl+Shift+A"), lambda: document.counts.selected == 0)
    aids = app.feature(ViewAids)
    for name, chord in (("centres", "Shift+M"), ("rings", "Shift+R")):
        for on in (True, False):
            clicks.timed(
                f"{name} {'on' if on else 'off'}",
                clicks.key(chord),
                lambda name=name, on=on: getattr(aids, name) == on,
            )
    clicks.session.forms.open_section = "Clean up"
    clicks.settle()
    ctx.set_ref("//Edit")
    ctx.mouse_move("Clean up/detectors/###clusters")
    ctx.mouse_down(0)
    form = clicks.session.forms.clean
    clicks.timed(
        "detector: floaters",
        lambda: imgui.get_io().add_mouse_button_event(0, False),
        lambda: clicks.session.job is not None or form.mask is not None,
    )
    ctx.mouse_up(0)
    clicks.settle()
    ctx.key_press(commands.chord("Escape"))
    clicks.settle()
    clicks.session.forms.open_section = "Colour & opacity"
    clicks.settle()
    slider = ctx.item_info("Colour & opacity/##Brightness").rect_full
    ctx.mouse_teleport_to_pos(ImVec2(slider.min.x + 0.6 * slider.get_width(), slider.get_center().y))
    clicks.timed(
        "slider: brightness",
        lambda: imgui.get_io().add_mouse_button_event(0, True),
        lambda: clicks.session.forms.previewing != "",
    )
    ctx.mouse_up(0)
    clicks.settle()
    clicks.session.cancel_preview()


def window(scene: str, renderer: str, rounds: int, report: str) -> None:
    found: dict[str, Any] = {}

    def act(app: AppState, ctx: Any) -> None:
        clicks = Clicks(app, ctx)
        clicks.settle()
        app.prefer(smooth=False)
        for _ in range(rounds + 1):
            go_through(clicks)
        found.update(clicks.found, splats=len(app.scene.gaussians), renderer=app.picture.backend)

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
    found = in_window(__file__, arguments, (SIZE[0], SIZE[1]), timeout=280)
    splats, renderer = found.pop("splats"), found.pop("renderer")
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
        f" `{renderer}` without a GPU; medians of {options.rounds} (least to most).",
    }
    write_results(options.output, {"scene": options.scene.name, "clicks_ms": clicks, "table": table})


if __name__ == "__main__":
    main()
