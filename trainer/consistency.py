"""How wrong pictures are where a splat shows, as photos agree.

Density control by it adds splats where several photos ask for them, not where a single one does: FastGS (Ren
et al. 2025) counts a splat's wrong pixels over photos drawn at random. Here it is the mean error under the
splat in each of some photos, and of these the median: a wrong mask, somebody who walks by, or shine that only
one photo has, asks for nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.raster.gradients import weighted_contributions
from splatview.scene import RenderSettings
from splatview.trainer.views import TrainView

ERROR_VIEWS = 0
"""See `TrainSettings.error_views`."""

LEAST_PIXELS = 0.3
"""Sum of contributions, px, below which a photo says nothing of a splat."""


def error_rates(
    splats: Parameters,
    views: Sequence[TrainView],
    settings: RenderSettings,
    picture: Callable[[np.ndarray, TrainView], np.ndarray] = lambda image, view: image[..., :3],
    *,
    threads: int | None = None,
) -> np.ndarray:
    """(N,) float64: of each splat the median, over the views that show it, of the mean absolute difference
    to the photo under it, 0 to 1, weighted by its contributions; 0 where no view shows it. `picture` makes
    (H, W, 3) to be compared with a photo of what was drawn (H, W, 4)."""
    rates, workspace = np.full((len(views), len(splats.means)), np.nan), Workspace()
    for row, view in zip(rates, views, strict=True):
        frame = draw_frame(splats, view.camera, settings, workspace, threads=threads)
        shown = np.clip(picture(frame.image, view), 0, 1)
        weights = np.zeros((*shown.shape[:2], 3), frame.image.dtype)
        weights[..., 0] = np.abs(shown - view.pixels / np.float32(255)).mean(axis=2)
        weights[..., 1] = 1
        if view.mask is not None:
            weights[~view.mask] = 0
        wrong, whole, _ = weighted_contributions(frame, weights).T
        np.divide(wrong, whole, out=row, where=whole >= LEAST_PIXELS)
    known = ~np.isnan(rates).all(axis=0)
    medians = np.zeros(len(splats.means))
    medians[known] = np.nanmedian(rates[:, known], axis=0)
    return medians
