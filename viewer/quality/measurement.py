"""The ladder of the view that is seen, climbed in a thread beside the frame loop. No ImGui in here."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from splatview import raster
from splatview.measure.effect_costs import EffectPrice, price_effects
from splatview.measure.knobs import KNOBS, Knob, Plan, path_to_view
from splatview.measure.ladder import Ladder, climb, rungs_for
from splatview.measure.metrics import enlarged, reduced_size
from splatview.measure.work import Bill, bill_of
from splatview.raster.contributions import count_work
from splatview.renderers.headless import with_rest_hidden
from splatview.scene import Camera, Gaussians
from splatview.scene.camera import turned_about
from splatview.scene.edits import SceneEdits
from splatview.scene.effects import Effect, used_sh_degree
from splatview.viewer.navigation import orbit
from splatview.viewer.picture import CpuPicture, Picture, scaled_camera

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


# ---- The window's own renderer, for a thread that measures: GL work is done on the GL thread, between two
# frames, and everything else where it is asked for. No ImGui in here.


PATIENCE = 0.05
"""Seconds between two looks at whether the work was cancelled, while the GL thread is waited for."""


class Cancelled(Exception):
    """The user has what was asked for no longer in mind."""


class Painter:
    """Draws the open scene by plans, with the edits that were in force when it was made. An `Artist`."""

    def __init__(self, app: AppState, cancelled: threading.Event, wake: Callable[[], object]):
        if app.picture is None or not app.is_open:
            raise ValueError("nothing is open")
        self.name = renderer_name(app.picture)
        self.gaussians: Gaussians = app.scene.gaussians
        self.edits: SceneEdits | None = app.edits
        self._kept: dict[float, SceneEdits | None] = {}
        self._app, self._post, self._picture = app, app.post, app.picture
        self._anywhere = isinstance(app.picture, CpuPicture)
        self._cancelled, self._wake = cancelled, wake
        self._target = np.asarray(app.view.target, np.float64)
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
                if app.picture is self._picture and not self._overtaken and not self._cancelled.is_set():
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


SECONDS = 8.0
"""Of timing, where frames are quick."""

FRAMES = 240
"""That timing may take where they are slow: some for each shortcut, as many of the baseline, and the window's
own between them..."""

MOST_SECONDS = 90.0
"""... but no longer than this."""

FRAME_TURN = 1e-5
"""Radians by which timed frames differ: enough that nothing is kept from the one before."""

BEFORE_ALL = -2
"""Number of the frame that tells how quick they are: none of those that are timed."""


class Measurement:
    """Begins when made; `ladder` is there when `done`."""

    def __init__(
        self,
        app: AppState,
        *,
        seconds: float = SECONDS,
        rounds: int | None = None,
        wake: Callable[[], object] = lambda: None,
    ):
        self.progress = 0.0
        self.text = "the truth in float64"
        self.ladder: Ladder | None = None
        self.bill: Bill | None = None
        self.problem: str | None = None
        self._stop = threading.Event()
        self._wake = wake
        self._painter = Painter(app, self._stop, wake)
        self._plan, self._seconds, self._rounds = Plan(settings=app.settings), seconds, rounds
        view, size, scale = app.view, app.picture_size, app.preferences.resolution_scale

        def moved(_: int, number: int) -> Camera:
            return scaled_camera(orbit(view, FRAME_TURN * (number + 1), 0.0).camera(*size), scale)

        self.view = view
        self.gaussians = self._painter.gaussians
        self.camera = scaled_camera(view.camera(*size), scale)
        self._moved = moved
        self._thread = threading.Thread(target=self._work, name="splatview-accuracy", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()

    def cancel(self) -> None:
        self._stop.set()

    def join(self) -> None:
        self._thread.join()

    def _work(self) -> None:
        try:
            painter, plan = self._painter, self._plan
            workspace = raster.Workspace()
            exact = replace(plan.settings, sh_degree=None, early_stop=0.0)
            splats = raster.parameters_of(painter.gaussians)
            truth = raster.draw_frame(
                splats, self.camera, exact, workspace, edits=painter.edits, dtype=np.float64
            ).image
            if self._stop.is_set():
                return
            work = count_work(splats, self.camera, plan.settings, workspace, edits=painter.edits)
            self.bill = bill_of(painter.gaussians, work)
            slow = FRAMES * painter.timed(self._moved(0, BEFORE_ALL), plan) / 1000
            rungs = rungs_for([painter], plan, used_sh_degree=used_sh_degree(painter.gaussians))
            ladder = climb(
                rungs,
                [self.camera],
                [truth],
                moved=self._moved,
                seconds=max(self._seconds, min(slow, MOST_SECONDS)),
                rounds=self._rounds,
                on_progress=self._show,
                cancelled=self._stop.is_set,
            )
            if ladder.complete:
                self.ladder = ladder
        except Cancelled:
            pass
        except Exception as error:
            self.problem = f"measuring failed: {type(error).__name__}: {error}"
        finally:
            self._wake()

    def _show(self, share: float, text: str) -> None:
        self.progress, self.text = share, text
        self._wake()


# ---- Prices of effects in the view that is seen, found out beside the frame loop. No ImGui in here.


EFFECT_SECONDS = 5.0

EFFECT_FRAME_TURN = 1e-5
"""Radians by which timed frames differ: enough that nothing is kept from the one before."""


class Pricing:
    """Begins when made; `prices` are there when `done`."""

    def __init__(
        self,
        app: AppState,
        effects: Sequence[Effect],
        *,
        seconds: float = EFFECT_SECONDS,
        rounds: int | None = None,
        wake: Callable[[], object] = lambda: None,
    ):
        self.progress = 0.0
        self.text = ""
        self.prices: dict[str, EffectPrice] | None = None
        self.problem: str | None = None
        self._stop = threading.Event()
        self._wake = wake
        self._painter = Painter(app, self._stop, wake)
        self._unedited: Painter | None = None
        if app.edits is not None and app.edits.in_force:
            self._unedited = Painter(app, self._stop, wake)
            self._unedited.edits = None
        self.gaussians = self._painter.gaussians
        self._plan, self._effects = Plan(settings=app.settings), effects
        self._seconds, self._rounds = seconds, rounds
        view, size, scale = app.view, app.picture_size, app.preferences.resolution_scale

        def moved(_: int, number: int) -> Camera:
            return scaled_camera(orbit(view, EFFECT_FRAME_TURN * (number + 1), 0.0).camera(*size), scale)

        self._camera, self._moved = scaled_camera(view.camera(*size), scale), moved
        self._thread = threading.Thread(target=self._work, name="splatview-effects", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()

    def cancel(self) -> None:
        self._stop.set()

    def join(self) -> None:
        self._thread.join()

    def _work(self) -> None:
        try:
            self.prices = price_effects(
                self._painter,
                self._plan,
                self.gaussians,
                self._effects,
                self._camera,
                moved=self._moved,
                seconds=self._seconds,
                rounds=self._rounds,
                unedited=self._unedited,
                on_progress=self._show,
                cancelled=self._stop.is_set,
            )
        except Cancelled:
            pass
        except Exception as error:
            self.problem = f"measuring failed: {type(error).__name__}: {error}"
        finally:
            self._wake()

    def _show(self, share: float, text: str) -> None:
        self.progress, self.text = share, text
        self._wake()
