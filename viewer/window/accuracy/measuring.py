"""The ladder of the view that is seen, climbed in a thread beside the frame loop. No ImGui in here."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from .... import raster
from ....measure.bill import Bill, bill_of
from ....measure.knobs import Plan
from ....measure.ladder import climb
from ....measure.rungs import Ladder, rungs_for
from ....raster.counting import count_work
from ....scene import Camera
from ....scene.effects import used_sh_degree
from ..navigation import orbit
from ..picture import scaled_camera
from .painter import Cancelled, Painter

if TYPE_CHECKING:
    from ..core import Core

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
        core: Core,
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
        self._painter = Painter(core, self._stop, wake)
        self._plan, self._seconds, self._rounds = Plan(settings=core.settings), seconds, rounds
        view, size, scale = core.view, core.picture_size, core.preferences.resolution_scale

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
