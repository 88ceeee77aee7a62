"""What a user does with the window, run by `conftest.drive` in a process of its own.

usage: drives.py NAME RESULT.json OPTIONS.json [SCENE ...]

Each function gets the window's `AppState`, ImGui's test context, the options, and a dict to report in.
"""

from __future__ import annotations

import ctypes
import itertools
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from imgui_bundle import ImVec2, hello_imgui, imgui
from imgui_bundle.glfw_utils import glfw_window_hello_imgui
from PIL import ImageGrab

import glfw  # isort: skip  (after imgui_bundle, which says which libglfw that is)

from splatview.cli.window import start_training
from splatview.renderers.gl.context import describe
from splatview.renderers.request import FrameRequest
from splatview.viewer import app as window
from splatview.viewer import commands as keys
from splatview.viewer import dialogs as file_dialogs
from splatview.viewer import layout, loading
from splatview.viewer.app import run_window
from splatview.viewer.editing.session import session_of
from splatview.viewer.state import AppState

LIMIT = 200.0
"""Seconds until what is waited for counts as never coming; a machine that compiles kernels beside is slow."""

STAMP = ImVec2(1 / 32, 1 / 32)
"""Pixels of a window that nobody looks at, for each of its own."""


class Hand:
    """The user's hands and eyes."""

    def __init__(self, app: AppState, ctx: Any):
        self.app, self.ctx = app, ctx
        self._little = False

    def frames(self, count: int = 3) -> None:
        self.ctx.yield_(count)

    def wait(self, condition: Callable[[], bool], what: str, seconds: float = LIMIT) -> None:
        limit = time.monotonic() + seconds
        while not condition():
            if time.monotonic() > limit:
                raise AssertionError(f"waited in vain for {what}; messages: {self.said}")
            self.ctx.yield_(1)
            time.sleep(0.004)  # what is waited for has the cores meanwhile, not the window's next frames

    def settle(self) -> None:
        """Until nothing is on its way any more."""
        self.frames(2)
        self.wait(
            lambda: not self.app.waiting and self.app.transition is None and self.app.is_open,
            "the window to settle",
        )
        self.frames(2)

    def press(self, key: str) -> None:
        self.ctx.key_press(keys.chord(key))
        self.frames(2)

    def hold(self, key: str, seconds: float) -> None:
        self.ctx.key_hold(keys.chord(key), seconds)

    def drag(self, dx: float, dy: float, button: int = 0, *, over: tuple[float, float] = (0.5, 0.5)) -> None:
        self.point(*over)
        self.ctx.mouse_drag_with_delta(ImVec2(dx, dy), button)
        self.frames(1)

    def double_click(self) -> None:
        """However slow the frames between the two clicks are."""
        io = imgui.get_io()
        usual = io.mouse_single_click_delay, io.mouse_double_click_time
        io.mouse_single_click_delay, io.mouse_double_click_time = 61.0, 60.0
        self.ctx.mouse_double_click(0)
        self.frames(1)
        io.mouse_single_click_delay, io.mouse_double_click_time = usual

    def point(self, x: float, y: float) -> None:
        """At a share of the picture's width and height."""
        view = self.ctx.window_info("//View").rect_full
        self.ctx.mouse_teleport_to_pos(
            ImVec2(view.min.x + x * (view.max.x - view.min.x), view.min.y + y * (view.max.y - view.min.y))
        )
        self.frames(2)

    def page(self, name: str) -> None:
        """Opens a page of the inspector by the rail; items are looked for in it from now on."""
        if self.app.page != name or self.app.panels_hidden:
            self.ctx.item_click(f"//##rail/{name}")
        self.frames(3)
        self.ctx.set_ref(f"//{next(page.window for page in layout.PAGES if page.name == name)}")

    def strip(self, name: str) -> None:
        """Opens a panel of the bottom strip by the status bar."""
        if self.app.strip != name or self.app.panels_hidden:
            self.ctx.item_click(f"//##status/###{name}")
        self.frames(3)

    def drop(self, *paths: str) -> None:
        """As GLFW does when files are dropped: calls the C callback that the window has installed."""
        glfw_window = glfw_window_hello_imgui()
        unused: Any = lambda *_: None  # noqa: E731
        callback: Any = glfw.set_drop_callback(glfw_window, unused)
        names = (ctypes.c_char_p * len(paths))(*[path.encode() for path in paths])
        self.on_gl_thread(lambda: callback(glfw_window, len(paths), names))
        window.install_drop_handler(self.app)

    def on_gl_thread(self, work: Callable[[], Any]) -> Any:
        """The test runs in a thread of its own, where no GL context is current."""
        answer: list[Any] = []
        self.app.post(lambda app: answer.append(work()))
        self.wait(lambda: bool(answer), "the frame loop")
        return answer[0]

    def is_software(self) -> bool:
        """Whether OpenGL is this machine's processor."""
        return self.on_gl_thread(lambda: describe(moderngl.create_context()).is_software)

    def picture(self) -> np.ndarray:
        """What a saved picture would hold now."""
        app = self.app
        picture = app.picture
        return self.on_gl_thread(
            lambda: picture.read(FrameRequest(None, app.camera, app.settings, mode=app.mode))
        )

    def picture_of_edits(self) -> np.ndarray:
        """The same with the edits in force."""
        app, session = self.app, session_of(self.app)
        assert session is not None
        picture, document = app.picture, session.document
        return self.on_gl_thread(
            lambda: picture.read(
                FrameRequest(None, app.camera, app.settings, mode=app.mode, edits=document.edits)
            )
        )

    def draw_little(self, little: bool = True) -> None:
        """Draws the window from now on as a stamp of some pixels, or whole again. Layout, clicks and the
        splats' picture are the same; but where OpenGL is software, drawing the panels is three quarters of a
        frame (12 of 17 ms at 800 x 500), and no test looks at them."""

        def shrink() -> None:
            imgui.get_main_viewport().framebuffer_scale = STAMP

        self._little = little
        hello_imgui.get_runner_params().callbacks.before_imgui_render = shrink if little else lambda: None

    def shoot(self, path: str | None) -> None:
        """The whole window into a file, where one is asked for."""
        if path is None:
            return
        little = self._little
        self.draw_little(False)
        self.frames(3)
        if shutil.which("import"):
            subprocess.run(["import", "-window", "root", path], check=False)
        else:
            ImageGrab.grab(xdisplay=os.environ["DISPLAY"]).save(path)
        self.draw_little(little)

    @property
    def said(self) -> list[str]:
        return [message.text for message in self.app.messages]


def pose(app: AppState) -> dict[str, Any]:
    camera, view = app.camera, app.view
    return {
        "eye": camera.eye.tolist(),
        "forward": camera.forward.tolist(),
        "target": view.target.tolist(),
        "distance": view.distance,
        "fov_y": view.lens.fov_y,
    }


def camera_json(app: AppState) -> dict[str, Any]:
    camera = app.camera
    data = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    return {**data, "world_to_camera": camera.world_to_camera.tolist()}


def tour(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Open by drop, orbit, pan, zoom, focus, fly, every mode, help, a picture."""
    hand.settle()
    found["first"] = app.scene.name if app.is_open else None
    hand.drop(options["drop"])
    hand.wait(lambda: app.is_open and app.scene.name == Path(options["drop"]).name, "the drop")
    hand.settle()
    found["title"] = app.scene.name if app.is_open else None
    app.prefer(smooth=False)

    found["start"] = pose(app)
    hand.drag(60, 0)
    found["orbited"] = pose(app)
    hand.drag(40, 30, 1)
    found["panned"] = pose(app)
    hand.point(0.5, 0.5)
    hand.ctx.mouse_wheel_y(2)
    hand.frames(3)
    found["zoomed"] = pose(app)
    hand.press("F")
    hand.settle()
    found["framed"] = pose(app)
    hand.point(0.5, 0.5)
    hand.double_click()
    hand.frames(4)
    found["focused"] = pose(app)
    found["focus_said"] = hand.said[-1]

    hand.press("F3")
    found["navigation"] = app.preferences.navigation
    before = pose(app)
    hand.hold("W", 0.3)
    hand.frames(2)
    found["flown"] = [before, pose(app)]
    before = pose(app)
    hand.drag(50, 0)
    found["looked"] = [before, pose(app)]
    hand.press("F4")
    before = pose(app)
    hand.drag(30, 20)
    found["rolled"] = [before, pose(app)]
    hand.press("F2")
    hand.press("Z")
    found["from_z"] = pose(app)
    hand.press("F")

    found["modes"] = {}
    for key, mode in zip("23451", ("points", "ellipsoids", "depth", "overdraw", "splats"), strict=True):
        hand.press(key)
        hand.settle()
        image = hand.picture()
        found["modes"][app.mode] = {
            "asked": mode,
            "mean": float(np.mean(image[..., :3])),
            "finite": bool(np.isfinite(image).all()),
        }

    hand.press("F1")
    found["help_open"] = app.dialog == "help"
    found["help_window"] = hand.ctx.get_window_by_ref("//Keys and mouse") is not None
    hand.press("F1")
    found["help_closed"] = app.dialog is None

    hand.press("B")
    found["bookmarks"] = [bookmark.name for bookmark in app.bookmarks]
    hand.settle()
    found["camera"] = camera_json(app)
    hand.press("F12")
    hand.settle()
    found["said"] = hand.said
    found["stats"] = {
        "splats": app.stats.splats,
        "drawn_idle": idle_draws(app, hand),
        "stages": sorted(app.stats.ms),
        "history": len(app.frame_history),
    }
    app.prefer(background=(0.25, 0.5, 0.75), fly_speed=3.0)


def menus(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """By menu and panel: open by a typed path, a picture at twice the size, every panel, every entry."""
    file_dialogs.has_native_dialogs = lambda: False
    hand.settle()
    ctx = hand.ctx
    ctx.set_ref("##MainMenuBar")
    ctx.menu_click("File/Open...")
    hand.frames(4)
    ctx.key_chars_replace_enter(options["typed"])
    hand.wait(lambda: app.is_open and app.scene.name == Path(options["typed"]).name, "the scene")
    hand.settle()
    found["opened"] = app.scene.name if app.is_open else None
    ctx.menu_click("File/Open...")
    hand.frames(4)
    ctx.item_click("//Open a scene/Cancel")
    hand.frames(3)

    ctx.menu_click("Camera/Trackball")
    hand.frames(3)
    found["navigation"] = app.preferences.navigation
    ctx.menu_click("Camera/Up axis/+Z")
    hand.settle()
    found["up"] = app.view.up.tolist()

    ctx.menu_click("File/Save a picture as...")
    hand.frames(4)
    ctx.item_click("//Save a picture/2 x")
    ctx.item_click("//Save a picture/Beside the scene")
    hand.settle()
    found["picture_size"] = list(app.picture_size)

    found["panels"] = []
    for panel in layout.available(app, layout.STRIP):
        hand.strip(panel.name)
        if ctx.get_window_by_ref(f"//{panel.window}").active:
            found["panels"].append(panel.name)
    for panel in layout.PAGES:
        hand.page(panel.name)
        if ctx.get_window_by_ref(f"//{panel.window}").active:
            found["panels"].append(panel.name)
    hand.page("View")
    ctx.item_open("Advanced")
    ctx.item_click("##Antialiased")
    hand.settle()
    found["antialiased"] = app.settings.model.antialiased
    ctx.item_click("###reset image model")
    hand.settle()
    found["antialiased_after"] = app.settings.model.antialiased

    hand.press("H")
    hand.frames(4)
    wide = app.picture_size[0]
    hand.press("H")
    hand.frames(4)
    found["widths"] = [wide, app.picture_size[0]]
    hand.press("H")  # ends with only the picture: the next run must have the panels


def second_look(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    hand.settle()
    found["visible"] = [
        panel.name
        for panel in (*layout.PAGES, *layout.STRIP)
        if hand.ctx.window_info(f"//{panel.window}", imgui.test_engine.TestOpFlags_.no_error).id_
    ]
    found["navigation"] = app.preferences.navigation


def idle_draws(app: AppState, hand: Hand) -> int:
    """Pictures drawn in 20 frames in which nothing changes."""
    hand.frames(2)
    before = app.stats.drawn
    hand.frames(20)
    return app.stats.drawn - before


def second_run(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """What the first run left behind."""
    hand.settle()
    found["background"] = app.settings.background
    found["fly_speed"] = app.preferences.fly_speed
    found["recent"] = list(app.preferences.recent)
    found["bookmarks"] = [bookmark.name for bookmark in app.bookmarks]
    found["said"] = hand.said


def trouble(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """A broken file, a cancelled load, a load overtaken by another, and an end in the middle of one."""
    hand.settle()
    kept = app.scene
    hand.drop(options["broken"])
    hand.wait(lambda: app.problem is not None, "the error")
    hand.frames(3)
    found["problem"] = app.problem
    found["scene_stays"] = app.scene is kept
    hand.ctx.item_click("//That did not work/OK")
    hand.frames(3)
    found["problem_closed"] = app.problem is None

    slow_down()
    hand.drop(options["slow"])
    hand.wait(lambda: app.loading is not None and (app.loading.progress or 0) > 0.05, "progress")
    before = imgui.get_frame_count()
    hand.frames(10)
    found["frames_while_loading"] = imgui.get_frame_count() - before
    hand.ctx.item_click("//Loading/Cancel")
    hand.frames(3)
    found["cancelled"] = app.loading is None and app.scene is kept

    hand.drop(options["slow"])
    hand.wait(lambda: app.loading is not None, "the slow load")
    overtaken = app.loading
    hand.drop(options["slow"], options["slow"])
    hand.wait(lambda: app.loading is not overtaken, "the second load")
    found["overtaken_cancelled"] = overtaken is not None and overtaken.cancelled
    # The window closes now, with a load under way.
    found["still_loading"] = app.loading is not None


def look(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """Which renderer shows what."""
    hand.settle()
    found["renderer"], found["software"] = app.picture.name, hand.is_software()
    found["camera"] = camera_json(app)
    found["pixel_sum"] = float(hand.picture()[..., :3].sum())


def slow_down() -> None:
    """Reading goes on from here until it is cancelled."""

    def slow(path, *, progress):
        for step in itertools.count():
            progress.step(min(step, 900) / 1000)
            time.sleep(0.01)

    loading.load_scene = slow


def turn(app: AppState, hand: Hand, options: dict[str, Any], found: dict[str, Any]) -> None:
    """The CPU renderer: coarse while moving, sharp at rest."""
    app.prefer(smooth=False)
    hand.settle()
    picture = app.picture
    found["renderer"] = picture.name
    found["rest_size"] = list(picture.texture.size)
    found["picture_size"] = list(app.picture_size)
    sizes = set()
    hand.point(0.5, 0.5)
    hand.ctx.mouse_down(0)
    for step in range(40):
        view = hand.ctx.window_info("//View").rect_full
        hand.ctx.mouse_teleport_to_pos(ImVec2(view.min.x + 100 + 4 * step, view.min.y + 150))
        hand.frames(1)
        sizes.add(tuple(picture.texture.size))
    hand.ctx.mouse_up(0)
    found["moving_sizes"] = sorted(map(list, sizes))
    hand.settle()
    found["rest_size_again"] = list(picture.texture.size)
    shown = np.frombuffer(hand.on_gl_thread(picture.texture.read), np.float32)
    found["largest_error"] = float(np.abs(shown - hand.picture().ravel()).max())
    found["drawn_idle"] = idle_draws(app, hand)


def without_frame_limit() -> None:
    """A person's 30 frames a second would be most of a test's time, as would be half a second a frame of a
    window beside a training that nobody touches."""
    window.SOFTWARE_FPS = window.MAX_FPS = 1000.0
    window.ATTENDED_SECONDS = 1e9


def main(drives: dict[str, Any]) -> int:
    """`drives`: name -> function, those of the script that was run."""
    name, result, options, *paths = sys.argv[1:]
    found: dict[str, Any] = {}
    given = json.loads(options)

    def act(app: AppState, ctx: Any) -> None:
        hand = Hand(app, ctx)
        hand.draw_little(not given.get("drawn"))
        try:
            drives[name](app, hand, given, found)
        finally:
            found["messages"] = hand.said

    without_frame_limit()
    code = run_window(
        [Path(path) for path in paths],
        size=tuple(given.get("size", (800, 500))),
        renderer=given.get("renderer", "quads"),
        starter=start_training,
        drive=act,
    )
    Path(result).write_text(json.dumps(found))
    return code


if __name__ == "__main__":
    sys.exit(main(globals()))
