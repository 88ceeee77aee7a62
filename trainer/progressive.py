"""Progressive resolution by evidence: which size of the photos a run trains on, as long as it teaches.

A picture of half the size takes a third of the time and moves large structures as well, so a run begins on
smaller photos. They have nothing more to teach once what the scene gets wrong in them is no more than what
they leave out of the full photos, or once an epoch brings nothing. Both are measured in the same unit, the
mean absolute difference: of pictures to their photos over whole epochs, and of full photos to themselves
without what the smaller size cannot show.

A fixed share of the run was too long for small, sharp photos: 66 transparent pictures of 200x200
(`playbot`) had 33.0 dB after a minute in place of 31.5. By the recipe as it stands that is gone: a minute of
five captures ends 0.65 dB lower to 0.5 higher than by half the size for 30 % of the run, in all lower, and so
do eight by half the size on this evidence, but for 30 % at most (coarse.json): few photos gain by being
blurred for longer. So it is an option, and no default.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from PIL import Image

from splatview.trainer.views import TrainView, TrainViews

FACTORS = (4, 2)
"""By which photos may be smaller, in order."""

SMALLEST_SIDE = 64
"""px: photos are not made smaller than this; windows of SSIM are 11 px."""

SAMPLED_PHOTOS = 12
"""Photos that say what a smaller size leaves out: spread over all."""

DETAIL_LEFT = 1.0
"""A size is left when the mean difference in it is below so many times the detail that it leaves out."""

LEAST_PROGRESS = 0.02
"""Or when it went down by less than this share from one round of photos to the next."""

ROUND_PHOTOS = 100
"""A round is the whole number of epochs with at least so many photos."""

LATEST = 0.5
"""Share of the run at which full size comes at the latest."""


def detail_lost(views: Sequence[TrainView], factor: int) -> float:
    """Mean |difference|, 0 to 1, of photos to themselves at a smaller size, enlarged bilinearly."""
    differences = []
    for view in views[:: -(-len(views) // SAMPLED_PHOTOS)]:
        small = view.smaller(factor)
        size = (view.camera.width, view.camera.height)
        enlarged = np.asarray(Image.fromarray(small.pixels).resize(size, Image.Resampling.BILINEAR))
        difference = np.abs(enlarged.astype(np.int16) - view.pixels)
        if view.mask is not None:
            difference = difference[view.mask]
        if difference.size:
            differences.append(float(difference.mean()) / 255)
    return float(np.mean(differences)) if differences else 0.0


class ProgressiveResolution:
    """The factor by which a run's photos are smaller, from step to step."""

    def __init__(self, views: TrainViews) -> None:
        sides = [min(view.camera.width, view.camera.height) for view in views.all]
        self._factors = [factor for factor in FACTORS if min(sides) // factor >= SMALLEST_SIDE]
        self._views = views
        self._round = math.ceil(ROUND_PHOTOS / len(views)) * len(views)
        self._details: dict[int, float] = {}
        self.level = 0
        """Place in `factors`; beyond the last: full size."""
        self._sum, self._count, self._before = 0.0, 0, math.inf

    def factor_at(self, progress: float) -> int:
        """The factor for the next step, 1 in full size."""
        if progress >= LATEST:
            self.level = len(self._factors)
        return self._factors[self.level] if self.level < len(self._factors) else 1

    def note(self, difference: float, photos: int) -> None:
        """Takes the mean |difference| of a step's pictures to their photos, so many, in the present size."""
        if self.level >= len(self._factors):
            return
        self._sum += difference * photos
        self._count += photos
        if self._count < self._round:
            return
        mean, factor = self._sum / self._count, self._factors[self.level]
        if factor not in self._details:
            self._details[factor] = detail_lost(self._views.all, factor)
        teaches = mean > DETAIL_LEFT * self._details[factor] and mean < (1 - LEAST_PROGRESS) * self._before
        self._sum, self._count, self._before = 0.0, 0, mean
        if not teaches:
            self.level, self._before = self.level + 1, math.inf

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""
        return {"progressive": np.array([self.level, self._sum, self._count, self._before])}

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where another's `state` was taken, of the same photos."""
        level, total, count, before = state["progressive"].tolist()
        self.level, self._sum, self._count, self._before = int(level), total, int(count), before


def mean_difference(image: np.ndarray, photo: np.ndarray, mask: np.ndarray | None) -> float:
    """Mean |difference|, 0 to 1, of every other pixel each way of a picture (H, W, 4) to its photo
    (H, W, 3) uint8, over the pixels that the mask (H, W) leaves; 0 where that leaves none."""
    difference = np.abs(image[::2, ::2, :3] * 255 - photo[::2, ::2])
    if mask is not None:
        difference = difference[mask[::2, ::2]]
    return float(difference.mean()) / 255 if difference.size else 0.0
