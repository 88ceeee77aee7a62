"""A photo, what the scene shows from its camera, and their difference, made beside the frame loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import moderngl
import numpy as np

from splatview import raster
from splatview.scene import Gaussians, RenderSettings
from splatview.trainer.evaluate import masked_psnr
from splatview.trainer.exposure import fitted_by_tiles
from splatview.trainer.views import TrainView
from splatview.viewer.tasks import LatestTask

NOT_TRAINED = 0.3
"""Brightness of what is not trained on of a photo."""


@dataclass(frozen=True, kw_only=True)
class ComparisonRequest:
    """A photo to be compared with the scene."""

    shot: TrainView
    gaussians: Gaussians
    settings: RenderSettings
    shrink: int
    """Divisor of the photo's sides: no more pixels than the panel has."""
    gain: float
    """Factor by which differences are brightened."""
    exposures_differ: bool = False
    """Whether the score is that of the exposure that fits."""
    in_part: TrainView | None = None
    """The photo without what is not trained on, which is dark; None: all of it is."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Comparison:
    """Three pictures (H, W, 3) uint8 of one view."""

    request: ComparisonRequest
    photo: np.ndarray
    render: np.ndarray
    difference: np.ndarray
    """Absolute, per channel, times the gain."""
    psnr: float
    """dB, in this size, measured as held-out photos are."""


class Comparer(LatestTask[ComparisonRequest, Comparison]):
    """Comparisons of the latest request, one at a time in a thread. For the GL thread."""

    def __init__(self, on_ready: Callable[[], object] = lambda: None) -> None:
        """`on_ready` is called, in the thread, when one has been made."""
        self.threads = 1
        """Cores that drawing may take."""
        super().__init__(
            lambda request, _: compare(request, self.threads, self.latest),
            name="splatview-beside-photo",
            on_done=on_ready,
        )


def compare(
    request: ComparisonRequest, threads: int | None = None, last: Comparison | None = None
) -> Comparison:
    """The pictures of a request. `last`: an earlier comparison, whose parts are taken where they fit."""
    same_view = (
        last is not None
        and last.request.shot is request.shot
        and last.request.in_part is request.in_part
        and last.request.shrink == request.shrink
    )
    shot = request.shot if request.in_part is None else replace(request.shot, mask=request.in_part.mask)
    shot = shot.smaller(request.shrink)
    photo = last.photo if last is not None and same_view else shot.pixels
    if request.in_part is not None and shot.mask is not None and not same_view:
        photo = np.where(shot.mask[..., None], photo, (photo * NOT_TRAINED).astype(np.uint8))
    if last is not None and same_view and last.request.gaussians is request.gaussians:
        render, score = last.render, last.psnr
    else:
        picture = raster.render(request.gaussians, shot.camera, request.settings, threads=threads)[..., :3]
        render = (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
        score = masked_psnr(fitted_by_tiles(picture, shot) if request.exposures_differ else picture, shot)
    apart = np.abs(render.astype(np.float32) - photo) * request.gain
    if shot.mask is not None:
        apart[~shot.mask] = 0
    difference = np.minimum(apart, 255).astype(np.uint8)
    return Comparison(request=request, photo=photo, render=render, difference=difference, psnr=score)


def shrink_for(width: int, height: int, room: tuple[float, float]) -> int:
    """The whole number by which a photo of width x height px is divided to have no more pixels than are
    seen in `room` px; 1 where it fits."""
    fit = min(room[0] / width, room[1] / height)
    return max(int(np.floor(1 / fit + 1e-6)), 1) if fit > 0 else 1


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
