"""How good a scene is where nobody trained it: PSNR and SSIM on the held-out photos."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from PIL import Image

from splatview.measure.metrics import psnr
from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import RenderSettings
from splatview.trainer.exposure import fitted_by_tiles
from splatview.trainer.loss import mean_ssim
from splatview.trainer.views import TrainView

DIFFERENCE_GAIN = 4
"""By how much differences are brightened in side-by-side pictures."""


class Score(NamedTuple):
    """One photo's; NaN where its mask leaves nothing to measure."""

    name: str
    psnr: float
    """dB"""
    ssim: float


class Evaluation(NamedTuple):
    """Scores of held-out photos, and their means."""

    scores: tuple[Score, ...]

    @property
    def psnr(self) -> float:
        return float(np.mean([score.psnr for score in self.scores]))

    @property
    def ssim(self) -> float:
        return float(np.mean([score.ssim for score in self.scores]))

    def among(self, names: Collection[str]) -> Evaluation:
        """Those of the photos of these names, one at least, all that a run looks at on its way."""
        return Evaluation(tuple(score for score in self.scores if score.name in names))


def pictures(
    parameters: Parameters,
    views: Sequence[TrainView],
    settings: RenderSettings,
    *,
    threads: int | None = None,
    exposures_differ: bool = False,
) -> Iterator[np.ndarray]:
    """What the scene shows of each photo, in turn: (H, W, 3), float32, not clipped.

    `exposures_differ`: each tile of a picture is at the exposure that fits its neighbours, see `exposure`;
    else pictures are as they are.
    """
    workspace = Workspace()
    for view in views:
        picture = draw_frame(parameters, view.camera, settings, workspace, threads=threads).image[..., :3]
        yield fitted_by_tiles(picture, view) if exposures_differ else picture


def evaluation_of(
    views: Sequence[TrainView], pictures: Iterable[np.ndarray], *, threads: int | None = None
) -> Evaluation:
    """Scores of pictures (H, W, 3) of photos' views. PSNR is over the pixels that the mask leaves; for SSIM,
    whose windows reach over its edge, the others are grey in picture and photo."""
    workspace, scores = Workspace(), []
    for view, picture in zip(views, pictures, strict=True):
        similarity = mean_ssim(picture, view.pixels, workspace, mask=view.mask, threads=threads)
        scores.append(Score(view.camera.name, masked_psnr(picture, view), similarity))
    return Evaluation(tuple(scores))


def evaluate(
    parameters: Parameters,
    views: Sequence[TrainView],
    settings: RenderSettings,
    *,
    threads: int | None = None,
    exposures_differ: bool = False,
) -> Evaluation:
    """Scores of a scene on photos; arguments as of `pictures`."""
    drawn = pictures(parameters, views, settings, threads=threads, exposures_differ=exposures_differ)
    return evaluation_of(views, drawn, threads=threads)


def masked_psnr(picture: np.ndarray, view: TrainView) -> float:
    """dB of a picture (H, W, 3), float, of a photo's view, over the pixels that its mask leaves; NaN where it
    leaves none."""
    truth = view.pixels.astype(np.float32) / 255
    if view.mask is None:
        return psnr(picture, truth)
    return psnr(picture[view.mask][None], truth[view.mask][None]) if view.mask.any() else np.nan


def side_by_side(view: TrainView, picture: np.ndarray) -> Image.Image:
    """Photo, picture, and the size of their difference, next to one another."""
    shown = (np.clip(np.nan_to_num(picture), 0, 1) * 255 + 0.5).astype(np.uint8)
    difference = np.abs(shown.astype(np.int16) - view.pixels) * DIFFERENCE_GAIN
    columns = [view.pixels, shown, np.minimum(difference, 255).astype(np.uint8)]
    return Image.fromarray(np.concatenate(columns, axis=1))
