"""Exact beside chosen: both pictures of the view at rest, and maps of where they differ. No ImGui in here."""

from __future__ import annotations

import threading
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
from splatview.scene.progress import Cancelled
from splatview.viewer.quality.measurement import WindowScene

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
        self.latest: Compared | None = None
        self.problem: str | None = None
        self.dragging = False
        self._pair: Pair | None = None
        self._since = 0.0
        self._tried: Pair | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._textures: dict[str, moderngl.Texture] = {}
        self._uploaded: Compared | None = None

    @property
    def busy(self) -> bool:
        waiting = self._pair is not None and not same_pair(self._pair, self._tried)
        return self.right != "off" and (waiting or self._thread is not None)

    def want(self, app: AppState, wake: Callable[[], object]) -> Compared | None:
        """Called every frame while it is on: the comparison of what is seen now, if there is one."""
        if self._thread is not None and not self._thread.is_alive():
            self._thread = None
        if app.scene is None or app.picture is None or app.mode != "splats":
            return None
        shown = app.scene.gaussians, app.camera
        exact, chosen = (
            FrameRequest.by_plan(*shown, plan, edits=app.edits)
            for plan in (Plan(settings=app.settings), app.accuracy.plan(app))
        )
        pair = exact, chosen, self.gain
        now = app.now()
        if not same_pair(pair, self._pair):
            self._pair, self._since = pair, now
        rested = now - self._since >= REST_SECONDS
        if self._thread is None and rested and not same_pair(pair, self._tried):
            self._tried, self.problem = pair, None
            scene = WindowScene(app, self._stop, wake)
            self._thread = threading.Thread(
                target=self._work, args=(scene, pair, wake), name="splatview-compare", daemon=True
            )
            self._thread.start()
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
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._release_textures()

    def _release_textures(self) -> None:
        for texture in self._textures.values():
            texture.release()
        self._textures.clear()
        self._uploaded = None

    def _work(self, scene: WindowScene, pair: Pair, wake: Callable[[], object]) -> None:
        camera, plans = pair[0].camera, [request.plan for request in pair[:2]]
        try:
            if plans[0].attributes == plans[1].attributes:
                exact, _ = draw_by_path(scene, camera, plans[0])
            else:  # the renderer has the rounded scene only
                exact = raster.render(scene.gaussians, camera, plans[0].settings, edits=scene.edits)
            chosen = exact if plans[0] == plans[1] else draw_by_path(scene, camera, plans[1])[0]
            self.latest = compare(pair, exact, chosen)
        except Cancelled:
            pass
        except Exception as error:
            self.problem = f"{type(error).__name__}: {error}"
        finally:
            wake()


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
