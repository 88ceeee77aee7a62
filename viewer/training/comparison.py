"""A photo, what the scene shows from its camera, and their difference, made beside the frame loop."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import moderngl
import numpy as np

from splatview import raster
from splatview.measure.metrics import psnr
from splatview.scene import Gaussians, RenderSettings
from splatview.trainer.views import TrainView


@dataclass(frozen=True, eq=False, kw_only=True)
class Wish:
    """What is to be compared."""

    shot: TrainView
    gaussians: Gaussians
    settings: RenderSettings
    shrink: int
    """The photo's sides are divided by this: no more pixels than the panel has."""
    gain: float
    """By how much differences are brightened."""

    def same_as(self, other: Wish | None) -> bool:
        return (
            other is not None
            and (self.shot, self.gaussians) == (other.shot, other.gaussians)
            and (self.settings, self.shrink, self.gain) == (other.settings, other.shrink, other.gain)
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """Three pictures (H, W, 3) uint8 of one view."""

    wish: Wish
    photo: np.ndarray
    render: np.ndarray
    difference: np.ndarray
    """Absolute, per channel, times the gain."""
    psnr: float
    """dB, in this size."""


class Comparer:
    """Makes the latest wish come true, one at a time, in a thread of its own. For the GL thread."""

    def __init__(self, on_ready: Callable[[], object] = lambda: None) -> None:
        """`on_ready` is called, in the thread, when one has been made."""
        self.latest: Comparison | None = None
        self.problem: str | None = None
        """What went wrong the last time."""
        self._on_ready = on_ready
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="splatview-beside-photo")
        self._pending: tuple[Wish, Future[Comparison]] | None = None
        self._seen: Wish | None = None
        self._made: Comparison | None = None

    def want(self, wish: Wish, threads: int) -> None:
        """Called every frame while it is looked at; begins a comparison if none is being made."""
        self.collect()
        if self._pending is None and not wish.same_as(self._seen):
            self._seen = wish
            last = self._made
            self._pending = wish, self._executor.submit(self._make, wish, last, threads)

    def collect(self) -> None:
        """Takes over what has been finished."""
        if self._pending is None or not self._pending[1].done():
            return
        _, made = self._pending
        self._pending = None
        error = made.exception()
        self.problem = None if error is None else f"{type(error).__name__}: {error}"
        if error is None:
            self.latest = self._made = made.result()

    @property
    def busy(self) -> bool:
        return self._pending is not None

    def close(self) -> None:
        """Waits for what is being made."""
        self._executor.shutdown(wait=True, cancel_futures=True)

    def _make(self, wish: Wish, last: Comparison | None, threads: int) -> Comparison:
        try:
            return compare(wish, threads, last)
        finally:
            self._on_ready()


def compare(wish: Wish, threads: int | None = None, last: Comparison | None = None) -> Comparison:
    """The pictures of a wish. `last`: an earlier comparison, whose parts are taken where they fit."""
    same_view = last is not None and last.wish.shot is wish.shot and last.wish.shrink == wish.shrink
    shot = wish.shot.smaller(wish.shrink)
    photo = last.photo if last is not None and same_view else shot.pixels
    if last is not None and same_view and last.wish.gaussians is wish.gaussians:
        render, score = last.render, last.psnr
    else:
        picture = raster.render(wish.gaussians, shot.camera, wish.settings, threads=threads)[..., :3]
        render = (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
        exact = photo.astype(np.float32) / 255
        shown = picture if shot.mask is None else np.where(shot.mask[..., None], picture, exact)
        score = psnr(shown, exact)
    apart = np.abs(render.astype(np.float32) - photo) * wish.gain
    if shot.mask is not None:
        apart[~shot.mask] = 0
    difference = np.minimum(apart, 255).astype(np.uint8)
    return Comparison(wish=wish, photo=photo, render=render, difference=difference, psnr=score)


def shrink_for(width: int, height: int, room: tuple[float, float]) -> int:
    """The whole number by which a photo of width x height px is divided to have no more pixels than are
    seen in `room` px; 1 where it fits."""
    fit = min(room[0] / width, room[1] / height)
    return max(int(np.floor(1 / fit + 1e-6)), 1) if fit > 0 else 1


# ---- The pictures of a comparison as textures.


class Pictures:
    """The textures of the latest comparison. Only the GL thread may use them."""

    def __init__(self) -> None:
        self._shown: Comparison | None = None
        self._textures: list[moderngl.Texture] = []

    def of(self, comparison: Comparison) -> list[moderngl.Texture]:
        """Three textures that hold it."""
        if comparison is not self._shown:
            self.release()
            ctx = moderngl.get_context()
            for picture in (comparison.photo, comparison.render, comparison.difference):
                height, width = picture.shape[:2]
                data = np.ascontiguousarray(picture)
                self._textures.append(ctx.texture((width, height), 3, data, alignment=1))
            self._shown = comparison
        return self._textures

    def release(self) -> None:
        for texture in self._textures:
            texture.release()
        self._textures, self._shown = [], None
