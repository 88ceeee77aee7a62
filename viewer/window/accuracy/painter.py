"""The window's own renderer, for a thread that measures: GL work is done on the GL thread, between two
frames, and everything else where it is asked for. No ImGui in here."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ....measure.enlarging import enlarged, reduced_size
from ....measure.knobs import KNOBS, Knob, Plan
from ....measure.paths import path_to_view
from ....scene import Camera, Gaussians
from ....scene.edits import SceneEdits
from ....scene.turning import turned_about
from ...reduced import with_rest_hidden
from ..picture import CpuPicture, Picture

if TYPE_CHECKING:
    from ..core import Core

PATIENCE = 0.05
"""Seconds between two looks at whether the work was cancelled, while the GL thread is waited for."""


class Cancelled(Exception):
    """The user has what was asked for no longer in mind."""


class Painter:
    """Draws the open scene by plans, with the edits that were in force when it was made. An `Artist`."""

    def __init__(self, core: Core, cancelled: threading.Event, wake: Callable[[], object]):
        if core.picture is None or core.scene is None:
            raise ValueError("nothing is open")
        self.name = renderer_name(core.picture)
        self.gaussians: Gaussians = core.scene.gaussians
        self.edits: SceneEdits | None = core.edits
        self._kept: dict[float, SceneEdits | None] = {}
        self._core, self._post, self._picture = core, core.post, core.picture
        self._anywhere = isinstance(core.picture, CpuPicture)
        self._cancelled, self._wake = cancelled, wake
        self._target = np.asarray(core.view.target, np.float64)
        """About which a camera turns, for pictures that depend on those before."""

    def can_draw(self, plan: Plan) -> bool:
        return applicable(plan) and self._picture.refusal(plan.settings) is None

    def prepare(self, camera: Camera, plan: Plan) -> None:
        """Finds out what the plan leaves out; the scene itself is there."""
        self._edits_by(plan)

    def draw(self, camera: Camera, plan: Plan) -> np.ndarray:
        return self._path(camera, plan)[-1][0]

    def follow(self, camera: Camera, plan: Plan) -> np.ndarray:
        return self._sorted(camera, plan)[0]

    def timed(self, camera: Camera, plan: Plan) -> float:
        """ms of one frame up to its pixels in memory, of a path the mean; waiting for the GL thread's turn
        is no part of it."""
        return float(np.mean([milliseconds for _, milliseconds in self._path(camera, plan)]))

    def memory(self, plan: Plan) -> int:
        return 0

    def _path(self, camera: Camera, plan: Plan) -> list[tuple[np.ndarray, float]]:
        """Pictures and their ms, the camera's last."""
        first, *others = (self._turned(camera, degrees) for degrees in path_to_view(plan.settings))
        begun = self._sorted(first, plan) if others else self._timed(first, plan)
        return [begun, *(self._timed(each, plan) for each in others)]

    def _sorted(self, camera: Camera, plan: Plan) -> tuple[np.ndarray, float]:
        """Of a frame whose order is its own, though the settings let it be older."""
        return self._timed(camera, plan, anew=True)

    def _turned(self, camera: Camera, degrees: float) -> Camera:
        return turned_about(camera, self._target, -camera.R_camera_world[1], degrees) if degrees else camera

    def _timed(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        size = reduced_size(camera.width, camera.height, plan.resolution)
        small = camera if size == (camera.width, camera.height) else camera.resized(*size)

        def work() -> tuple[np.ndarray, float]:
            if anew:
                self._picture.forget_order()
            begun = time.perf_counter()
            image = self._picture.read(small, plan.settings, "splats", self._edits_by(plan))
            return image, 1e3 * (time.perf_counter() - begun)

        try:
            image, milliseconds = work() if self._anywhere else self._on_gl_thread(work)
        except Exception:
            if self._overtaken:
                raise Cancelled from None
            raise
        return enlarged(image, camera.width, camera.height), milliseconds

    @property
    def _overtaken(self) -> bool:
        """Whether another scene has been loaded since this was made, or is about to be."""
        scene, loading = self._core.scene, self._core.loading
        same = scene is not None and scene.gaussians is self.gaussians
        return not same or (loading is not None and loading.done)

    def _edits_by(self, plan: Plan) -> SceneEdits | None:
        if plan.kept not in self._kept:
            self._kept[plan.kept] = with_rest_hidden(self.gaussians, plan.kept, self.edits)
        return self._kept[plan.kept]

    def _on_gl_thread(self, work: Callable[[], tuple[np.ndarray, float]]) -> tuple[np.ndarray, float]:
        done = threading.Event()
        answers: list[tuple[np.ndarray, float]] = []
        failures: list[Exception] = []

        def command(core: Core) -> None:
            try:
                if core.picture is self._picture and not self._overtaken and not self._cancelled.is_set():
                    answers.append(work())
            except Exception as error:  # the thread that asked must hear of it, not the frame loop
                failures.append(error)
            done.set()

        self._post(command)
        self._wake()
        while not done.wait(PATIENCE):
            if self._cancelled.is_set():
                raise Cancelled
        if failures:
            raise failures[0]
        if not answers:
            raise Cancelled
        return answers[0]


def renderer_name(picture: Picture) -> str:
    """As the knobs know it: "quads" or "cpu"."""
    return picture.name.split()[0]


def applicable(plan: Plan) -> bool:
    """Whether the window can draw by `plan` without loading the scene anew."""
    return plan == replace(plan, attributes="float32")


def unpriced_knobs(renderer: str) -> tuple[Knob, ...]:
    """Those of `renderer` that can be turned here, but are priced by `splatview ladder` only."""
    return tuple(
        knob
        for knob in KNOBS
        if renderer in knob.renderers and not all(applicable(v.apply(Plan())) for v in knob.values)
    )
