"""The plain colour that photos of one object may stand before: white, as shops and renderers have it.

No splat is needed to show it: it is put behind the scene, in training as in what held-out photos are compared
with. Splats would have to stand somewhere, and they stood before the cameras, as fog that hides the object
from any other side.

One run each with a third held out, half the bench's size, photos laid over white: `guitar RGBA 24`,
`playbot RGBA 18` and `playbot RGBA 100` score 20.8, 10.7 and 16.2 dB after a minute with black behind the
scene, 34.0, 29.4 and 35.2 with white; over grey, `playbot RGBA 100` 38.4 (38.6 where photos say what is
transparent). No rule was chosen on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from splatview.trainer.views import TrainView

BORDER = 0.02
"""Of the shorter side: how far from a photo's edge its border goes, one pixel at least."""

TOLERANCE = 8 / 255
"""Largest difference of any channel to the colour, which compression and noise make."""

LEAST_OF_A_PHOTO, LEAST_OF_ALL = 0.4, 0.6
"""Share of a photo's border, and of all photos' on the average, that has the colour. A sky has the upper half
at most; an object that is cut off leaves more than that."""

LEAST_PHOTOS = 0.9
"""Share of the photos of which that is true."""

DARKEST = 0.1
"""A colour with no channel above this is as good as black, which is behind the scene anyway."""

MOST_PHOTOS = 60
"""Photos that are looked at, spread over all."""


class Backdrop(NamedTuple):
    """What photos stand before."""

    colour: tuple[float, float, float]
    """0 to 1, a multiple of 1/255."""
    share: float
    """Of the photos' borders."""


def find_backdrop(views: Sequence[TrainView]) -> Backdrop | None:
    """The plain colour before which nearly all photos stand; None where there is none but black, and where
    photos are transparent, which says more."""
    if any(view.alpha is not None for view in views):
        return None
    borders = [_border(view) for view in views[:: -(-len(views) // MOST_PHOTOS)]]
    borders = [border for border in borders if len(border)]
    if not borders:
        return None
    colour = np.median([np.median(border, axis=0) for border in borders], axis=0).round()
    if not colour.max() > 255 * DARKEST:
        return None
    shares = np.array([(np.abs(border - colour).max(axis=1) <= 255 * TOLERANCE).mean() for border in borders])
    if not (shares.mean() >= LEAST_OF_ALL and (shares >= LEAST_OF_A_PHOTO).mean() >= LEAST_PHOTOS):
        return None
    red, green, blue = (float(part) for part in colour / 255)
    return Backdrop((red, green, blue), float(shares.mean()))


def _border(view: TrainView) -> np.ndarray:
    """(P, 3) float64: the pixels of a photo's border that show the scene."""
    height, width = view.pixels.shape[:2]
    deep = max(round(BORDER * min(height, width)), 1)
    is_border = np.ones((height, width), np.bool_)
    is_border[deep : height - deep, deep : width - deep] = False
    if view.mask is not None:
        is_border &= view.mask
    return view.pixels[is_border].astype(np.float64)
