"""What a user does in the window for a README picture; run by `readme_pictures` where there is a display.

python tools/readme/readme_windows.py editing SCENE    opens, cleans up a little, waits to be stopped
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

from imgui_bundle import ImVec2, imgui

from splatview.edit.detectors import DETECTORS
from splatview.edit.operations.crop import ChangeCrop
from splatview.viewer.app import run_window
from splatview.viewer.editing.cleanup import is_priced
from splatview.viewer.editing.commands import take_tool
from splatview.viewer.editing.face_handles import place_of
from splatview.viewer.editing.session import EditSession, post_edit, session_of
from splatview.viewer.editing.tool_state import Face
from splatview.viewer.entries import open_page, toggle_strip
from splatview.viewer.film import add_keyframe
from splatview.viewer.navigation import dolly, orbit
from splatview.viewer.quality.effects import Effects
from splatview.viewer.quality.state import Accuracy, choose
from splatview.viewer.state import AppState
from splatview.viewer.theme import point_on_picture

READY = "readme-ready"
"""File, beside the settings, that says: now is the moment."""


def editing(app: AppState, ctx: Any) -> None:
    """A brushed selection, a crop box, and what the detector of floaters would take."""

    def frames(count: int = 5) -> None:
        ctx.yield_(count)

    def settle() -> None:
        frames()
        while app.waiting or not app.is_open or app.transition is not None:
            ctx.yield_(1)
        frames(10)

    settle()
    app.post(open_page, "Edit", "Clean up")
    app.post(toggle_strip, "History")
    frames()
    ctx.set_ref("//Edit")
    view = ctx.window_info("//View").rect_full
    ctx.key_press(imgui.Key.c)
    place = ImVec2(
        view.min.x + 0.30 * (view.max.x - view.min.x), view.min.y + 0.52 * (view.max.y - view.min.y)
    )
    ctx.mouse_teleport_to_pos(place)
    frames()
    ctx.mouse_drag_with_delta(ImVec2(90, 25), 0)
    settle()
    ctx.key_press(imgui.Key.escape)
    session = session_of(app)
    while session is not None and not all(is_priced(session, name) for name in DETECTORS):
        frames(5)
    ctx.item_click("Clean up/detectors/###clusters")
    settle()
    ctx.mouse_teleport_to_pos(ImVec2(view.max.x - 60, view.max.y - 40))
    settle()
    Path(os.environ["SPLATVIEW_CONFIG_DIR"], READY).touch()
    while not app.quitting:
        ctx.yield_(1)
        time.sleep(0.05)


def crop(app: AppState, ctx: Any) -> None:
    """A crop box about the middle of the demo, one face of it dragged by its dot, the mouse on another."""

    def settle() -> None:
        ctx.yield_(5)
        while app.waiting or app.picture.status or not app.is_open or app.transition is not None:
            ctx.yield_(1)
        ctx.yield_(10)

    settle()
    app.post(open_page, "Edit", "Crop")
    app.post(take_tool, "crop_box")
    settle()
    session = session_of(app)
    assert session is not None
    x, y, z = app.view.target.tolist()
    side = 0.22 * app.view.distance
    small = replace(session.document.crops[0], centre=(x, y, z), half_extents=(1.6 * side, side, side))
    post_edit(app, EditSession.apply, ChangeCrop(index=0, crop=small))
    app.post(lambda app: app.steer(orbit(app.view, 0.5, 0.25)))
    settle()
    view = ctx.window_info("//View").rect_full
    width, height = round(view.max.x - view.min.x), round(view.max.y - view.min.y)
    for face, dx in ((Face(0, -1), 60), (Face(1, -1), 0)):
        place = place_of(session.document.crops[0], face).tolist()
        at = point_on_picture(app.view.camera(width, height), view.min, place)
        assert at is not None
        ctx.mouse_teleport_to_pos(at)
        ctx.yield_(5)
        if dx:
            ctx.mouse_drag_with_delta(ImVec2(dx, 0), 0)
        settle()
    Path(os.environ["SPLATVIEW_CONFIG_DIR"], READY).touch()
    while not app.quitting:
        ctx.yield_(1)
        time.sleep(0.05)


def film(app: AppState, ctx: Any) -> None:
    """Four keyframes round the demo, and their way seen from farther off."""

    def settle() -> None:
        ctx.yield_(5)
        while app.waiting or app.picture.status or not app.is_open or app.transition is not None:
            ctx.yield_(1)
        ctx.yield_(5)

    settle()
    first = app.view
    app.post(toggle_strip, "Film")
    for azimuth, elevation, factor in (
        (-0.9, 0.05, 0.62),
        (-0.25, 0.02, 0.45),
        (0.45, 0.15, 0.55),
        (1.1, 0.3, 0.8),
    ):
        app.post(lambda app, a=azimuth, e=elevation, f=factor: app.steer(dolly(orbit(first, a, e), f)))
        settle()
        app.post(add_keyframe)
        settle()
    app.post(lambda app: app.steer(dolly(orbit(first, 0.15, 0.45), 1.2)))
    settle()
    Path(os.environ["SPLATVIEW_CONFIG_DIR"], READY).touch()
    while not app.quitting:
        ctx.yield_(1)
        time.sleep(0.05)


def accuracy(app: AppState, ctx: Any) -> None:
    """Prices of shortcuts, one taken, and where an eye would notice it."""
    while app.waiting or not app.is_open or app.transition is not None:
        ctx.yield_(1)
    app.post(open_page, "Accuracy")
    app.feature(Accuracy).rounds = 5
    app.post(app.feature(Accuracy).measure)
    ctx.yield_(3)
    while app.feature(Accuracy).ladder is None:
        ctx.yield_(1)
    app.post(choose, "sh-degree", "0")
    app.feature(Accuracy).comparing.right = "perceptual"
    ctx.yield_(10)
    while app.waiting:
        ctx.yield_(1)
    ctx.yield_(5)
    Path(os.environ["SPLATVIEW_CONFIG_DIR"], READY).touch()
    while not app.quitting:
        ctx.yield_(1)
        time.sleep(0.05)


def effects(app: AppState, ctx: Any) -> None:
    """The receipt with its prices, and the mouse on the evidence of one line."""
    while app.waiting or not app.is_open or app.transition is not None:
        ctx.yield_(1)
    app.post(open_page, "Accuracy", "Effects")
    ctx.yield_(3)
    for name in ("###Frame limit", "Compare"):
        ctx.item_close(f"//Accuracy/{name}")
    app.feature(Effects).seconds = 20.0
    app.post(app.feature(Effects).measure)
    ctx.yield_(3)
    while not app.feature(Effects).prices:
        ctx.yield_(1)
    ctx.set_ref("//Accuracy")
    ctx.mouse_move("**/##SH band 3")
    Path(os.environ["SPLATVIEW_CONFIG_DIR"], READY).touch()
    while not app.quitting:
        ctx.yield_(1)
        time.sleep(0.05)


DRIVES = {"editing": editing, "crop": crop, "film": film, "accuracy": accuracy, "effects": effects}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("drive", choices=DRIVES)
    parser.add_argument("scenes", nargs="*", type=Path)
    options = parser.parse_args()
    sys.exit(run_window(options.scenes, size=(1280, 800), drive=DRIVES[options.drive]))
