"""Prices, shortcuts and the frame budget in a real window; run by `conftest.drive` like `drives`."""

from __future__ import annotations

import sys
import time
from typing import Any

import drives
import numpy as np
from drives import Hand
from imgui_bundle import ImVec2, imgui

from splatview import raster
from splatview.measure.knobs import Plan
from splatview.renderers import quality
from splatview.renderers.request import FrameRequest
from splatview.viewer.navigation import orbit
from splatview.viewer.quality.measurement import Measurement
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.state import AppState


def prices(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Measure, read the prices, take a shortcut by a click, compare, and take all back."""
    hand.settle()
    app.prefer(smooth=False)
    accuracy = app.feature(Accuracy)
    accuracy.rounds = options.get("rounds")
    exact = hand.picture()
    hand.page("Accuracy")
    hand.frames(3)
    progress: list[float] = []
    report = Measurement.report

    def noted(self: Measurement, share: float, text: str = "") -> None:
        progress.append(share)
        report(self, share, text)

    Measurement.report = noted
    hand.ctx.item_click("**/###measure")
    hand.wait(lambda: accuracy.ladder is not None, "the prices", 240)
    Measurement.report = report
    hand.frames(3)
    assert accuracy.ladder is not None
    found["progress"] = [progress[0], max(progress)]
    found["rungs"] = [
        [one.rung.knob, one.rung.value, one.psnr, one.max_error, one.ratio] for one in accuracy.ladder.rungs
    ]
    found["elsewhere"] = sorted({len(one.elsewhere) for one in accuracy.ladder.rungs})
    found["noise"] = accuracy.ladder.noise
    found["evaluations"] = accuracy.bill.evaluations if accuracy.bill else None
    hand.shoot(options.get("shot_prices"))

    by_mark(app, hand, found)
    hand.ctx.item_open("###all")
    hand.ctx.item_click("**/###sh-degree 0")
    hand.frames(3)
    hand.settle()
    found["choices"] = dict(accuracy.choices)
    plan = accuracy.plan(app)
    picture = app.picture
    coarse = hand.on_gl_thread(lambda: picture.read(FrameRequest(None, app.camera, plan.settings)))
    shown = seen(hand, app)
    found["shown_is_coarse"] = float(np.abs(shown - coarse).max())
    found["differs"] = float(np.abs(coarse - exact).max())

    for right in ("chosen", "signed", "perceptual"):
        accuracy.comparing.right = right
        hand.wait(lambda: not accuracy.comparing.busy, "the comparison")
        hand.frames(3)
        hand.shoot((options.get("shot_split") or "").replace("#", right) or None)
    compared = accuracy.comparing.latest
    assert compared is not None, accuracy.comparing.problem
    found["compared"] = [compared.psnr, compared.largest, compared.noticed]
    found["line"] = [accuracy.comparing.line]
    eye = app.camera.eye
    drag_line(hand, 60)
    found["line"].append(accuracy.comparing.line)
    found["eye_moved"] = float(np.abs(app.camera.eye - eye).max())
    accuracy.comparing.right = "off"

    hand.page("Accuracy")
    hand.ctx.item_click("**/###exact")
    hand.frames(3)
    hand.settle()
    found["back"] = float(np.abs(seen(hand, app) - exact).max())
    found["choices_after"] = dict(accuracy.choices)

    reduced(app, hand, found, exact)
    accuracy.rounds = 1_000_000  # until it is cancelled
    hand.ctx.item_click("**/###measure")
    hand.wait(lambda: accuracy.measurement is not None, "the second measurement")
    hand.frames(2)
    hand.ctx.item_click("**/###cancel")
    hand.wait(lambda: accuracy.measurement is None, "it to end")
    found["prices_kept"] = accuracy.ladder is not None


def by_mark(app: AppState, hand: Hand, found: dict[str, Any]) -> None:
    """A click on a mark of the plot draws by its shortcut, another one takes it back."""
    accuracy = app.feature(Accuracy)
    marks = {name: at for name, at in accuracy.marks.items() if name[0] != "renderer"}

    def alone(name: tuple[str, str]) -> float:
        others = [at for other, at in accuracy.marks.items() if other != name]
        return float(np.hypot(*(np.array(others) - marks[name]).T).min())

    name = max(marks, key=alone)
    found["mark"] = list(name)
    found["by_mark"] = []
    for _ in range(2):
        hand.ctx.mouse_teleport_to_pos(ImVec2(*accuracy.marks[name]))
        hand.frames(2)
        hand.ctx.mouse_click(0)
        hand.frames(3)
        hand.settle()
        found["by_mark"].append(dict(accuracy.choices))


def reduced(app: AppState, hand: Hand, found: dict[str, Any], exact: np.ndarray) -> None:
    """Fewer splats, and the scene in fewer bits, each by a click and back by another."""
    accuracy = app.feature(Accuracy)
    assert app.is_open
    for name, value in (("keep", "25"), ("attributes", "8-bit-sh")):
        hand.ctx.item_click(f"**/###{name} {value}")
        hand.frames(3)
        hand.wait(lambda: accuracy.storing is None, "the scene to be stored")
        hand.settle()
        shown = seen(hand, app)
        plan = Plan(kept=0.25) if name == "keep" else Plan(attributes="8-bit-sh")
        request = quality.reduced(FrameRequest.by_plan(app.scene.gaussians, app.camera, plan))
        assert request.gaussians is not None
        wanted = raster.render(request.gaussians, app.camera, app.settings)
        found[name] = [float(np.abs(shown - wanted).max()), float(np.abs(shown - exact).max())]
        hand.ctx.item_click(f"**/###{name} {value}")
        hand.frames(3)
        hand.wait(lambda: accuracy.storing is None, "the scene as it is")
        hand.settle()
        found[f"{name} back"] = float(np.abs(seen(hand, app) - exact).max())


def drag_line(hand: Hand, dx: float) -> None:
    hand.point(hand.app.feature(Accuracy).comparing.line, 0.6)
    hand.ctx.mouse_drag_with_delta(ImVec2(dx, 0), imgui.MouseButton_.left)
    hand.frames(2)


def seen(hand: Hand, app: AppState) -> np.ndarray:
    """What the window shows of the scene now (H, W, 4)."""
    picture = app.picture
    hand.settle()
    return hand.on_gl_thread(
        lambda: (
            np.frombuffer(picture.texture.read(), picture_type(picture.texture.dtype))
            .reshape(*reversed(picture.texture.size), 4)
            .astype(np.float32)
        )
    )


def picture_type(name: str) -> type[np.floating]:
    return np.float16 if name == "f2" else np.float32


def governor(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Turn with a budget that a full frame does not meet, and come to rest."""
    hand.settle()
    app.prefer(smooth=False)
    accuracy, picture = app.feature(Accuracy), app.picture
    exact_size = picture.texture.size

    def turn(_: AppState) -> None:
        app.steer(orbit(app.view, 0.01, 0.0))

    def turned(frames: int) -> list[float]:
        times: list[float] = []
        last = app.stats.drawn
        while len(times) < frames:
            app.post(turn)
            hand.frames(1)
            stats = app.stats
            if stats is not None and stats.drawn != last and stats.ms:
                last = stats.drawn
                times.append(sum(stats.ms.values()))
        return times

    full = turned(options["frames"])
    found["full_ms"] = float(np.median(full))
    time.sleep(0.4)
    hand.settle()
    app.post(lambda app: app.feature(Accuracy).hold(app, options["share"] * found["full_ms"]))
    hand.settle()
    time.sleep(options.get("patience", 0.0))
    turned(options["frames"])
    governed = turned(2 * options["frames"])
    found["budget_ms"] = options["share"] * found["full_ms"]
    found["governed_ms"] = float(np.median(governed))
    found["moving_size"] = picture.texture.size
    found["badge"] = accuracy.note or picture.note
    hand.shoot(options.get("shot"))
    sizes = []
    for _ in range(4):
        hand.frames(1)
        sizes.append(picture.texture.size)
    found["resting_sizes"] = sizes
    hand.settle()
    found["exact_size"], found["final_size"] = exact_size, picture.texture.size
    found["badge_at_rest"] = accuracy.note or picture.note


if __name__ == "__main__":
    sys.exit(drives.main(globals()))
