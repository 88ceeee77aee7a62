"""A user at the window who keeps an eye on everything."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import moderngl
import numpy as np
from checks import Mishap, Pictures, Undone, wait_for_threads
from drives import Hand

from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import LOCKED, PREVIEW, SELECTED, SceneEdits
from splatview.viewer.editing.saving import Saving, leave_unsaved
from splatview.viewer.editing.session import Editing, at_rest, session_of
from splatview.viewer.quality.state import Accuracy
from splatview.viewer.state import AppState
from splatview.viewer.training.live import LiveTraining

EXPECTED = (
    r"^broken\.ply|/broken\.ply",
    r"still under way; wait for it or cancel it$",
    r"everything is deleted or cropped away; there is nothing to export$",
    r"no crop is in force that could be made permanent$",
    r"crops already; remove one first$",
    r"the scene was edited in the meantime; do it again$",
    r"are hidden, locked or cropped away and cannot be deleted$",
)
"""What the program may refuse, in its own words; any other dialog is a mishap."""

INSIDE = "inside the program"
"""In every message about a defect of ours."""

SETTLE_SECONDS = 120.0


class User(Hand):
    """Hands, eyes, and what was seen so far."""

    def __init__(self, app: AppState, ctx: Any, folder: Path, *, small: bool):
        super().__init__(app, ctx)
        self.folder, self.small = folder, small
        self.pictures = Pictures(folder)
        self.undone = Undone()
        self.exports = 0
        self._told = 0

    @property
    def at_rest(self) -> bool:
        """Whether every edit can be made."""
        return at_rest(self.app) and self.app.loading is None

    def post(self, command: Any, *args: Any) -> None:
        """As a menu entry does; returns when it has run."""
        done: list[bool] = []
        self.app.post(command, *args)
        self.app.post(lambda app: done.append(True))
        self.wait(lambda: bool(done), "the frame loop")
        self.frames(1)
        self.give_edits_up()

    def drop(self, *paths: str) -> None:
        super().drop(*paths)
        self.frames(2)
        self.give_edits_up()

    def give_edits_up(self) -> None:
        """Answers the question that unsaved edits ask where another scene is to be opened."""
        if self.app.feature(Saving).question == "leave":
            self.app.post(leave_unsaved)
            self.wait(lambda: self.app.feature(Saving).question == "", "the answer")
            self.frames(1)

    def calm(self) -> None:
        """Until nothing is under way any more."""
        self.frames(2)
        try:
            self.wait(lambda: not self._under_way(), "the window to come to rest", SETTLE_SECONDS)
        except AssertionError as error:
            raise Mishap(f"never at rest: {', '.join(self._under_way())}") from error
        self.frames(2)

    def _under_way(self) -> list[str]:
        app, session = self.app, session_of(self.app)
        waits = {
            "loading": app.loading is not None,
            "a turn of the view": app.transition is not None,
            "looking at the splats": not app.examined or app.feature(Editing).examining is not None,
            "an edit": session is not None and session.job is not None,
            "a changed scene": session is not None and session.loading is not None,
            "a picture": app.picture.busy and not self._trains,
            "measuring": app.feature(Accuracy).measurement is not None,
        }
        return [name for name, under_way in waits.items() if under_way]

    @property
    def _trains(self) -> bool:
        """New pictures come all the time."""
        training = self.app.find(LiveTraining)
        return training is not None and training.followed_by(self.app) and training.status.state == "training"

    # ---- looking

    def look_for_harm(self) -> None:
        """After every action. Raises Mishap."""
        app = self.app
        self.frames(1)
        session = session_of(app)
        self.undone.follow(session.document if session is not None and at_rest(app) else None)
        if self.undone.wrong:
            raise Mishap(self.undone.wrong)
        problem, app.problem = app.problem, None
        if problem is not None and not any(re.search(pattern, problem) for pattern in EXPECTED):
            raise Mishap(f"a dialog: {problem}")
        new, self._told = list(app.messages)[-20:], len(app.messages)
        for message in new:
            if INSIDE in message.text:
                raise Mishap(message.text)
        error = self.on_gl_thread(lambda: moderngl.get_context().error)
        if error != "GL_NO_ERROR":
            raise Mishap(f"OpenGL says {error}")
        training = app.find(LiveTraining)
        if training is not None and training.status.state == "failed":
            raise Mishap(f"training failed: {training.status.failure}")

    def look_at_everything(self) -> None:
        """Now and then: pictures and threads. Raises Mishap."""
        app = self.app
        resumed = False
        if (training := app.find(LiveTraining)) is not None and training.status.state == "training":
            training.thread.pause()
            resumed = True
            self.wait(
                lambda: (
                    (training := app.find(LiveTraining)) is not None and training.status.state == "paused"
                ),
                "the pause",
            )
        session = session_of(app)
        if session is not None and session.job is not None:
            session.job.cancel()
        if app.feature(Accuracy).measurement is not None:
            app.feature(Accuracy).cancel_measuring()
        self.calm()
        self.look_for_harm()
        session = session_of(app)  # another one, where a scene was being opened
        if app.is_open and session is not None and session.gaussians is not app.scene.gaussians:
            raise Mishap("the panels look at other splats than the edits")
        self.look_at_the_picture()
        wait_for_threads(lambda: self.frames(1))
        if resumed and training is not None:
            training.thread.resume()
            self.wait(
                lambda: (
                    (training := app.find(LiveTraining)) is not None and training.status.state != "paused"
                ),
                "training",
            )

    def look_at_the_picture(self) -> None:
        """What is shown, and what would be saved, are what the CPU draws of the baked scene."""
        app = self.app
        picture = app.picture
        if picture is None or not app.is_open:
            return
        gaussians, edits, camera, settings = self._what_is_shown()
        if app.mode == "splats":
            saved = self.on_gl_thread(lambda: picture.read(FrameRequest(None, camera, settings, edits=edits)))
            if self._what_is_shown()[0] is not gaussians:
                self.look_at_the_picture()
                return
            self.pictures.compare("a saved picture", saved, gaussians, camera, settings, edits)
        else:
            saved = self.on_gl_thread(
                lambda: picture.read(FrameRequest(None, camera, settings, mode=app.mode, edits=edits))
            )
            if not np.isfinite(saved).all():
                raise Mishap(f"{app.mode}: numbers that are not finite")
        self.calm()
        gaussians, edits, camera, settings = self._what_is_shown()
        lit = edits is not None and edits.flags & (SELECTED | LOCKED | PREVIEW)
        exact = not app.feature(Accuracy).choices and app.feature(Accuracy).budget_ms is None
        if app.mode == "splats" and exact and not lit and app.preferences.resolution_scale == 1:
            texture = picture.texture
            if texture.size != (camera.width, camera.height):
                raise Mishap(
                    f"what is shown at rest has {texture.size} px of {(camera.width, camera.height)}"
                )
            shown = self.on_gl_thread(lambda: read_texture(texture))
            self.frames(2)
            if self._what_is_shown()[0] is not gaussians:  # the snapshot of a pause came: it is looked at
                self.look_at_the_picture()
                return
            self.pictures.compare("what is shown", shown, gaussians, camera, settings, edits)

    def _what_is_shown(self) -> tuple[Gaussians, SceneEdits | None, Camera, RenderSettings]:
        """Splats, edits, camera and settings of the picture as they are now."""
        app = self.app
        gaussians = session.document.gaussians if (session := session_of(app)) else app.scene.gaussians
        return gaussians, app.edits, app.camera, app.seen_settings

    @property
    def renderer(self) -> str:
        picture = self.app.picture
        return "" if picture is None else picture.name.split()[0]


def read_texture(texture: moderngl.Texture) -> np.ndarray:
    """(H, W, 4) float32."""
    dtype = {"f1": np.uint8, "f2": np.float16, "f4": np.float32}[texture.dtype]
    values = np.frombuffer(texture.read(), dtype).reshape(texture.height, texture.width, 4)
    return values.astype(np.float32) / (255 if dtype is np.uint8 else 1)
