"""Prices of shortcuts and of effects in the view that is seen, measured in a thread beside the frame loop.

The window's own renderer draws: OpenGL's work is done on its thread, between two frames, and everything else
where it is asked for. No ImGui in here.
"""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from splatview import raster
from splatview.measure.effect_costs import EffectPrice, price_effects
from splatview.measure.knobs import KNOBS, Knob, Plan
from splatview.measure.ladder import Ladder, draw_by_path, run_ladder, rungs_for
from splatview.measure.metrics import enlarged, psnr
from splatview.measure.work import Bill, bill_of
from splatview.raster.contributions import count_work
from splatview.renderers import VisualMode
from splatview.renderers.headless import ANY_CAMERA
from splatview.renderers.quality import with_rest_hidden
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians
from splatview.scene.camera import orbited
from splatview.scene.edits import SceneEdits
from splatview.scene.effects.effect import Effect
from splatview.scene.effects.sh_bands import used_sh_degree
from splatview.scene.framing import views_around
from splatview.scene.progress import Cancelled
from splatview.viewer.navigation import orbit
from splatview.viewer.picture import scaled_camera
from splatview.viewer.tasks import Task

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


PATIENCE = 0.05
"""Seconds between two looks at whether the work was cancelled, while the GL thread is waited for."""


class WindowScene:
    """The open scene in the window's renderer, with the edits that were in force when it was made: a
    `measure.ladder.SceneRenderer` for a thread that measures."""

    def __init__(
        self,
        app: AppState,
        cancelled: Callable[[], bool],
        wake: Callable[[], object],
        *,
        mode: VisualMode = "splats",
    ):
        if not app.is_open:
            raise ValueError("nothing is open")
        self.name = app.picture.backend
        self.mode: VisualMode = mode
        self.gaussians: Gaussians = app.scene.gaussians
        self.edits: SceneEdits | None = app.edits
        self._kept: dict[float, SceneEdits | None] = {}
        self._app, self._post, self._picture = app, app.post, app.picture
        self._cancelled, self._wake = cancelled, wake
        self._target = np.asarray(app.view.target, np.float64)
        """About which a camera turns, for pictures that depend on those before."""

    def supports(self, plan: Plan) -> bool:
        request = FrameRequest.by_plan(self.gaussians, ANY_CAMERA, plan)
        return applicable(plan) and self._picture.unsupported(request) is None

    def turned(self, camera: Camera, degrees: float) -> Camera:
        return orbited(camera, self._target, -camera.R_camera_world[1], degrees)

    def prepare(self, plan: Plan) -> None:
        """Finds out what the plan leaves out; the scene itself is there."""
        self._edits_by(plan)

    def draw(self, camera: Camera, plan: Plan, *, anew: bool = False) -> tuple[np.ndarray, float]:
        """Waiting for the turn of the OpenGL thread is no part of the milliseconds."""
        request = FrameRequest(
            None,
            camera,
            plan.settings,
            mode=self.mode,
            edits=self._edits_by(plan),
            resolution=plan.resolution,
        )

        def work() -> tuple[np.ndarray, float]:
            if anew:
                self._picture.forget_order()
            begun = time.perf_counter()
            image = self._picture.read(request)
            return image, 1e3 * (time.perf_counter() - begun)

        try:
            image, milliseconds = work() if self._picture.draws_anywhere else self._on_gl_thread(work)
        except Exception:
            if self._overtaken:
                raise Cancelled from None
            raise
        return enlarged(image, camera.width, camera.height), milliseconds

    def memory(self) -> int:
        return 0

    @property
    def _overtaken(self) -> bool:
        """Whether another scene has been loaded since this was made, or is about to be."""
        scene, loading = self._app.scene, self._app.loading
        same = scene.gaussians is self.gaussians
        return not same or (loading is not None and loading.done)

    def _edits_by(self, plan: Plan) -> SceneEdits | None:
        if plan.kept not in self._kept:
            self._kept[plan.kept] = with_rest_hidden(self.gaussians, plan.kept, self.edits)
        return self._kept[plan.kept]

    def _on_gl_thread(self, work: Callable[[], tuple[np.ndarray, float]]) -> tuple[np.ndarray, float]:
        done = threading.Event()
        answers: list[tuple[np.ndarray, float]] = []
        failures: list[Exception] = []

        def command(app: AppState) -> None:
            try:
                if app.picture is self._picture and not self._overtaken and not self._cancelled():
                    answers.append(work())
            except Exception as error:  # the thread that asked must hear of it, not the frame loop
                failures.append(error)
            done.set()

        self._post(command)
        self._wake()
        while not done.wait(PATIENCE):
            if self._cancelled():
                raise Cancelled
        if failures:
            raise failures[0]
        if not answers:
            raise Cancelled
        return answers[0]


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


SECONDS, EFFECT_SECONDS = 8.0, 5.0
"""Of timing, where frames are quick: of shortcuts, and of effects."""

FRAMES = 240
"""That timing shortcuts may take where frames are slow: some for each, as many of the baseline, and the
window's own between them..."""

MOST_SECONDS = 90.0
"""... but no longer than this."""

FRAME_TURN = 1e-5
"""Radians by which timed frames differ: enough that nothing is kept from the one before."""

BEFORE_ALL = -2
"""Number of the frame that tells how quick they are: none of those that are timed."""


class Measuring(Task[None], ABC):
    """A measurement of the view that is seen. Begins when made."""

    def __init__(
        self, app: AppState, *, seconds: float, rounds: int | None, wake: Callable[[], object], text: str
    ):
        self.text = text
        self._wake = wake
        self._scene = WindowScene(app, lambda: self.cancelled, wake)
        self._plan, self._seconds, self._rounds = Plan(settings=app.seen_settings), seconds, rounds
        self.view, self._size, self._scale = app.view, app.picture_size, app.preferences.resolution_scale
        self.gaussians = self._scene.gaussians
        self.camera = scaled_camera(self.view.camera(*self._size), self._scale)

    def _begin(self) -> None:
        """Starts the thread; for subclasses to call when all is set."""
        super().__init__(lambda _: self._measure(), name="splatview-measure", on_done=self._wake)

    @property
    def problem(self) -> str | None:
        """Error of the measurement, in one line; None where it was cancelled."""
        if self.error is None or isinstance(self.error, Cancelled):
            return None
        return f"measuring failed: {type(self.error).__name__}: {self.error}"

    def _moved(self, _: int, number: int) -> Camera:
        turned = orbit(self.view, FRAME_TURN * (number + 1), 0.0)
        return scaled_camera(turned.camera(*self._size), self._scale)

    @abstractmethod
    def _measure(self) -> None: ...

    def report(self, share: float, text: str = "") -> None:
        super().report(share, text)
        self._wake()


class Measurement(Measuring):
    """Prices of shortcuts; `ladder` is there when `done`."""

    def __init__(
        self,
        app: AppState,
        *,
        seconds: float = SECONDS,
        rounds: int | None = None,
        wake: Callable[[], object] = lambda: None,
    ):
        super().__init__(app, seconds=seconds, rounds=rounds, wake=wake, text="the truth in float64")
        self.ladder: Ladder | None = None
        self.bill: Bill | None = None
        self._moves_by_own_prices = app.picture is not None and app.picture.draws_anywhere
        self._begin()

    def _measure(self) -> None:
        scene, plan = self._scene, self._plan
        workspace = raster.Workspace()
        exact = replace(plan.settings, sh_degree=None, early_stop=0.0)
        splats = raster.parameters_of(scene.gaussians)
        truth = raster.draw_frame(
            splats, self.camera, exact, workspace, edits=scene.edits, dtype=np.float64
        ).image
        if self.cancelled:
            return
        work = count_work(splats, self.camera, plan.settings, workspace, edits=scene.edits)
        self.bill = bill_of(scene.gaussians, work)
        used = used_sh_degree(scene.gaussians, scene.edits.palette if scene.edits else ())
        slow = FRAMES * draw_by_path(scene, self._moved(0, BEFORE_ALL), plan)[1] / 1000
        ladder = run_ladder(
            rungs_for([scene], plan, used_sh_degree=used),
            [self.camera],
            [truth],
            moved=self._moved,
            seconds=max(self._seconds, min(slow, MOST_SECONDS)),
            rounds=self._rounds,
            on_progress=self.report,
            cancelled=lambda: self.cancelled,
        )
        if ladder.complete and (self._moves_by_own_prices or self._look_around(ladder)):
            self.ladder = ladder

    def _look_around(self, ladder: Ladder) -> bool:
        """Compares the shortcuts in other views too, as many as there is time for, so that badges of moving
        pictures are true there; False where cancelled."""
        begun = time.perf_counter()
        for number, camera in enumerate(views_around(self.camera, self.gaussians)[1:]):
            spent = time.perf_counter() - begun
            if number and spent + spent / number > self._seconds:
                break
            exact, _ = self._scene.draw(camera, self._plan, anew=True)
            for one in ladder.rungs:
                if self.cancelled:
                    return False
                one.elsewhere.append(psnr(draw_by_path(self._scene, camera, one.rung.plan)[0], exact))
        return True


class Pricing(Measuring):
    """Prices of effects; `prices` are there when `done`."""

    def __init__(
        self,
        app: AppState,
        effects: Sequence[Effect],
        *,
        seconds: float = EFFECT_SECONDS,
        rounds: int | None = None,
        wake: Callable[[], object] = lambda: None,
    ):
        super().__init__(app, seconds=seconds, rounds=rounds, wake=wake, text="")
        self.prices: dict[str, EffectPrice] | None = None
        self._effects = effects
        self._unedited: WindowScene | None = None
        if app.edits is not None and app.edits.in_force:
            self._unedited = WindowScene(app, lambda: self.cancelled, wake)
            self._unedited.edits = None
        self._begin()

    def _measure(self) -> None:
        self.prices = price_effects(
            self._scene,
            self._plan,
            self.gaussians,
            self._effects,
            self.camera,
            moved=self._moved,
            seconds=self._seconds,
            rounds=self._rounds,
            unedited=self._unedited,
            on_progress=self.report,
            cancelled=lambda: self.cancelled,
        )
