"""Prices of effects in the view that is seen, found out beside the frame loop. No ImGui in here."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from ....measure.effect_prices import EffectPrice, price_effects
from ....measure.knobs import Plan
from ....scene import Camera
from ....scene.effects import Effect
from ..accuracy.painter import Cancelled, Painter
from ..navigation import orbit
from ..picture import scaled_camera

if TYPE_CHECKING:
    from ..core import Core

SECONDS = 5.0

FRAME_TURN = 1e-5
"""Radians by which timed frames differ: enough that nothing is kept from the one before."""


class Pricing:
    """Begins when made; `prices` are there when `done`."""

    def __init__(
        self,
        core: Core,
        effects: Sequence[Effect],
        *,
        seconds: float = SECONDS,
        rounds: int | None = None,
        wake: Callable[[], object] = lambda: None,
    ):
        self.progress = 0.0
        self.text = ""
        self.prices: dict[str, EffectPrice] | None = None
        self.problem: str | None = None
        self._stop = threading.Event()
        self._wake = wake
        self._painter = Painter(core, self._stop, wake)
        self._unedited: Painter | None = None
        if core.edits is not None and core.edits.in_force:
            self._unedited = Painter(core, self._stop, wake)
            self._unedited.edits = None
        self.gaussians = self._painter.gaussians
        self._plan, self._effects = Plan(settings=core.settings), effects
        self._seconds, self._rounds = seconds, rounds
        view, size, scale = core.view, core.picture_size, core.preferences.resolution_scale

        def moved(_: int, number: int) -> Camera:
            return scaled_camera(orbit(view, FRAME_TURN * (number + 1), 0.0).camera(*size), scale)

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
