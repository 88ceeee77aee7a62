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
from splatview.measure.metrics import heat, largest_error, perceptual_map, psnr, signed_map
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import SceneEdits
from splatview.viewer.quality.measurement import Cancelled, Painter

if TYPE_CHECKING:
    from splatview.viewer.state import AppState


Right = Literal["off", "chosen", "signed", "perceptual"]

RIGHTS: tuple[Right, ...] = ("off", "chosen", "signed", "perceptual")
"""What is shown on the right of the line."""

REST_SECONDS = 0.2
"""A view that has stayed the same for so long is compared."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Wish:
    """What is to be compared."""

    gaussians: Gaussians
    edits: SceneEdits | None
    camera: Camera
    exact: Plan
    chosen: Plan
    gain: float

    def same_as(self, other: Wish | None) -> bool:
        return (
            other is not None
            and self.gaussians is other.gaussians
            and self.edits is other.edits
            and self.camera.same_view(other.camera)
            and (self.exact, self.chosen, self.gain) == (other.exact, other.chosen, other.gain)
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Compared:
    """Pictures (H, W, 3) uint8 of one view."""

    wish: Wish
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
        self._wish: Wish | None = None
        self._since = 0.0
        self._tried: Wish | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._textures: dict[str, moderngl.Texture] = {}
        self._uploaded: Compared | None = None

    @property
    def busy(self) -> bool:
        waiting = self._wish is not None and not self._wish.same_as(self._tried)
        return self.right != "off" and (waiting or self._thread is not None)

    def want(self, app: AppState, chosen: Plan, wake: Callable[[], object]) -> Compared | None:
        """Called every frame while it is on: the comparison of what is seen now with the
        picture by the plan `chosen`, if there is one."""
        if self._thread is not None and not self._thread.is_alive():
            self._thread = None
        if not app.is_open or app.picture is None or app.mode != "splats":
            return None
        wish = Wish(
            gaussians=app.scene.gaussians,
            edits=app.edits,
            camera=app.camera,
            exact=Plan(settings=app.settings),
            chosen=chosen,
            gain=self.gain,
        )
        now = app.now()
        if not wish.same_as(self._wish):
            self._wish, self._since = wish, now
        rested = now - self._since >= REST_SECONDS
        if self._thread is None and rested and not wish.same_as(self._tried):
            self._tried, self.problem = wish, None
            painter = Painter(app, self._stop, wake)
            self._thread = threading.Thread(
                target=self._work, args=(painter, wish, wake), name="splatview-compare", daemon=True
            )
            self._thread.start()
        latest = self.latest
        return latest if latest is not None and wish.same_as(latest.wish) else None

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

    def _work(self, painter: Painter, wish: Wish, wake: Callable[[], object]) -> None:
        try:
            if wish.chosen.attributes == wish.exact.attributes:
                exact = painter.draw(wish.camera, wish.exact)
            else:  # the renderer has the rounded scene only
                exact = raster.render(wish.gaussians, wish.camera, wish.exact.settings, edits=wish.edits)
            chosen = exact if wish.exact == wish.chosen else painter.draw(wish.camera, wish.chosen)
            self.latest = compare(wish, exact, chosen)
        except Cancelled:
            pass
        except Exception as error:
            self.problem = f"{type(error).__name__}: {error}"
        finally:
            wake()


def compare(wish: Wish, exact: np.ndarray, chosen: np.ndarray) -> Compared:
    """Two pictures (H, W, 4) float of one view, and where they differ."""
    noticed = perceptual_map(chosen, exact)
    return Compared(
        wish=wish,
        exact=eight_bit(exact[..., :3]),
        chosen=eight_bit(chosen[..., :3]),
        signed=eight_bit(signed_map(chosen, exact, gain=wish.gain)),
        perceptual=eight_bit(heat(noticed)),
        psnr=psnr(chosen, exact),
        largest=largest_error(chosen, exact),
        noticed=float(noticed.mean()),
    )


def eight_bit(picture: np.ndarray) -> np.ndarray:
    return (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
