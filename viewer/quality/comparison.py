"""Exact beside chosen: both pictures of the view at rest, and maps of where they differ. No ImGui in here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import moderngl
import numpy as np

from splatview import raster
from splatview.measure.knobs import Plan
from splatview.measure.ladder import draw_by_path
from splatview.measure.metrics import heat, largest_error, perceptual_map, psnr, signed_map
from splatview.renderers.request import FrameRequest
from splatview.viewer.quality.measurement import Cancelled, WindowScene
from splatview.viewer.tasks import LatestTask, Task

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


Right = Literal["off", "chosen", "signed", "perceptual"]

RIGHTS: tuple[Right, ...] = ("off", "chosen", "signed", "perceptual")
"""What is shown on the right of the line."""

REST_SECONDS = 0.2
"""A view that has stayed the same for so long is compared."""

Pair = tuple[FrameRequest, FrameRequest, float]
"""The exact picture, the chosen one, and by how much their difference is brightened."""


def same_pair(one: Pair | None, other: Pair | None) -> bool:
    """Whether both give the same comparison."""
    if one is None or other is None:
        return False
    return one[0].same_picture(other[0]) and one[1].same_picture(other[1]) and one[2] == other[2]


@dataclass(frozen=True, eq=False, kw_only=True)
class Compared:
    """Pictures (H, W, 3) uint8 of one view."""

    of: Pair
    exact: np.ndarray
    chosen: np.ndarray
    signed: np.ndarray
    perceptual: np.ndarray
    psnr: float
    """dB of the chosen against the exact."""
    largest: float
    """Largest error of any pixel and colour."""
    noticed: float
    """Mean of the perceptual map."""


class Comparing:
    """The split view's state; for the GL thread."""

    def __init__(self) -> None:
        self.right: Right = "off"
        self.line = 0.5
        """Where the two sides meet, as a share of the picture's width."""
        self.gain = 8.0
        """By how much the signed difference is brightened."""
        self.dragging = False
        self._pair: Pair | None = None
        self._since = 0.0
        self._closed = False
        self._wake: Callable[[], object] = lambda: None
        self._task: LatestTask[tuple[Pair, WindowScene | None], Compared] = LatestTask(
            self._work,
            name="splatview-compare",
            same=lambda one, other: same_pair(one[0], other[0]),
            on_done=self._on_compared,
        )
        self._textures: dict[str, moderngl.Texture] = {}
        self._uploaded: Compared | None = None

    @property
    def busy(self) -> bool:
        waiting = self._pair is not None and not self._task.has_tried((self._pair, None))
        return self.right != "off" and (waiting or self._task.busy)

    @property
    def latest(self) -> Compared | None:
        return self._task.latest

    @property
    def problem(self) -> str | None:
        """Error of the last comparison, in one line."""
        return self._task.problem

    def want(self, app: AppState, by: Plan, wake: Callable[[], object]) -> Compared | None:
        """Called every frame while it is on: the comparison of what is seen now with the
        picture by the plan `by`, if there is one."""
        self._task.collect()
        if not app.is_open or app.mode != "splats":
            return None
        shown = app.scene.gaussians, app.camera
        exact, chosen = (
            FrameRequest.by_plan(*shown, plan, edits=app.edits)
            for plan in (Plan(settings=app.seen_settings), by)
        )
        pair = exact, chosen, self.gain
        now = app.now()
        if not same_pair(pair, self._pair):
            self._pair, self._since = pair, now
        rested = now - self._since >= REST_SECONDS
        if rested and not self._task.busy and not self._task.has_tried((pair, None)):
            self._wake = wake
            self._task.request((pair, WindowScene(app, lambda: self._closed, wake)))
        latest = self.latest
        return latest if latest is not None and same_pair(pair, latest.of) else None

    def textures(
        self, ctx: moderngl.Context, compared: Compared
    ) -> tuple[moderngl.Texture, moderngl.Texture]:
        """Left and right."""
        if self._uploaded is not compared:
            self._release_textures()
            for name in ("exact", "chosen", "signed", "perceptual"):
                pixels: np.ndarray = getattr(compared, name)
                height, width = pixels.shape[:2]
                self._textures[name] = ctx.texture((width, height), 3, pixels.tobytes(), alignment=1)
            self._uploaded = compared
        return self._textures["exact"], self._textures["chosen" if self.right == "off" else self.right]

    def end(self) -> None:
        self._closed = True
        self._task.close()
        self._release_textures()

    def _release_textures(self) -> None:
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()
        self._uploaded = None

    def _on_compared(self) -> None:
        self._wake()

    @staticmethod
    def _work(request: tuple[Pair, WindowScene | None], task: Task[Compared]) -> Compared:
        pair, scene = request
        assert scene is not None
        camera, plans = pair[0].camera, [each.plan for each in pair[:2]]
        try:
            if plans[0].attributes == plans[1].attributes:
                exact, _ = draw_by_path(scene, camera, plans[0])
            else:  # the renderer has the rounded scene only
                exact = raster.render(scene.gaussians, camera, plans[0].settings, edits=scene.edits)
            chosen = exact if plans[0] == plans[1] else draw_by_path(scene, camera, plans[1])[0]
        except Cancelled:
            task.cancel()
            raise
        return compare(pair, exact, chosen)


def compare(pair: Pair, exact: np.ndarray, chosen: np.ndarray) -> Compared:
    """Two pictures (H, W, 4) float of one view, and where they differ."""
    noticed = perceptual_map(chosen, exact)
    return Compared(
        of=pair,
        exact=eight_bit(exact[..., :3]),
        chosen=eight_bit(chosen[..., :3]),
        signed=eight_bit(signed_map(chosen, exact, gain=pair[2])),
        perceptual=eight_bit(heat(noticed)),
        psnr=psnr(chosen, exact),
        largest=largest_error(chosen, exact),
        noticed=float(noticed.mean()),
    )


def eight_bit(picture: np.ndarray) -> np.ndarray:
    return (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
