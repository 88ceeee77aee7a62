"""What is behind the scene: the plain colour that photos of one object may stand before, as shops and
renderers have it, or the mean colour of photos that show something everywhere.

No splat is needed to show a plain colour: it is put behind the scene, in training as in what held-out
photos are compared with. Splats would have to stand somewhere, and they stood before the cameras, as fog
that hides the object from any other side. Fog that has the colour itself costs nothing where that is behind.
So a photo is known to be empty where it shows the colour and is connected to its border by it: what is
plain within the object may be a part of it, and of that nothing is known.

One run each with a third held out, half the bench's size, a minute, photos laid over a plain colour. Over
white `guitar RGBA 24`, `playbot RGBA 18` and `playbot RGBA 100` score 20.8, 10.7 and 16.2 dB with black
behind the scene, 34.0, 29.4 and 35.2 with white, 34.1, 29.2 and 35.6 where it is known what is empty, too.
Over black `playbot RGBA 100` scores 34.3 and 38.2 dB without and with that, `train front 30`, lights on
black, 36.9 and 40.1; over grey 38.4 without (38.6 where photos say what is transparent). No number here
was chosen on them.

Photos that show something everywhere were compared before black, where a bright splat that is half
transparent is as good as a dark one that is not: of what photos of `beach` show 32 % had an opacity below
0.7, and from any other place something else shone through. A colour that differs from step to step leaves
nothing to gain by holes. It does so about the photos' mean colour, which then stands for what no photo shows.
Where many photos show each place that only costs, see ENOUGH_PHOTOS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import kernel
from splatview.trainer.views import TrainView, TrainViews

BORDER = 0.02
"""Of the shorter side: how far from a photo's edge its border goes, one pixel at least."""

TOLERANCE = 8 / 255
"""Largest difference of any channel to the colour, which compression and noise make."""

LEAST_OF_A_PHOTO, LEAST_OF_ALL = 0.4, 0.6
"""Share of a photo's border, and of all photos' on the average, that has the colour. A sky has the upper half
at most; an object that is cut off leaves more than that."""

LEAST_PHOTOS = 0.9
"""Share of the photos of which that is true."""

DARKEST, FRAME = 0.1, 0.97
"""A colour with no channel above the first may be a frame, as around what a fisheye lens sees, rather than a
backdrop: where what is within has one shape, by this share of what either of two photos has within. It is
0.90, 0.77, 0.51 and 0.14 for the four captures of the bench that have a backdrop."""

MOST_PHOTOS = 60
"""Photos that are looked at, spread over all."""

MOST_PIXELS = 10_000
"""Of a photo, by some less than twice, that its mean colour is of: it is known to 0.005 of 1 and better."""

ENOUGH_PHOTOS = 20
"""Photos that show a place, see `TrainViews.photos_of_a_place`, from which on photos are compared before the
background: many photos of it leave few holes, and a colour that differs from step to step only disturbs.
Three minutes, what is gained over black after fits of exposure. Chosen: `miku 40 far` (22 photos show a
place) -0.71, -0.17, -0.14 dB, and 2.1 % holes without. Judged: `fox` (28) -0.03, 0.7 %; `miku 20 near` (12)
+0.31, +0.48, 0.1 %, `miku 20 far` (10) +0.34, -0.54 (+0.74, -0.07 as they are), 3.4 %; `demo lens` (4) +0.21,
none. Of an object that all photos show, before a room that few do, the room counts little. With the mean
colour a minute of `stitch` has 25.15 dB in place of 24.58, but `gum` 25.25 of 25.37, `games` 26.31 of 26.60.
"""

SPREAD = 0.3
"""Of 1, by which a channel differs from the mean in a step at most. Three splits after a minute,
held-out photos after fits of exposure, what is gained over black: 0, always the mean, 0.15, 0.3, 0.5 and
any colour at all. `miku 12 far` +0.38, +0.88, +0.97, -0.10, +0.55 dB; 0, 0.3 and any colour: `kermit` -0.26,
+0.59, -0.29, `toy` +0.62, +0.36, +0.18, `bust` -0.60, -0.35, -1.19, and `beach` after three minutes +0.31,
+0.54, +0.56. With 0 a fourth of what the photos of `beach` show are holes still, with 0.3 none.

Dropped, for captures with ENOUGH_PHOTOS: black first, and this in the second half or the last fifth of a
minute: `statue` (split 0) 20.48 and 20.08 dB in place of 21.50, `miku 40 far` 28.02 in place of 28.09 by the
half. Nor does it help behind a scene that was trained before black: 18.29 and 24.37 dB, for a fourth of what
held-out photos of `statue` show has an opacity below 0.9.

Dropped: less of it in the second half of a run, down to none as it ends. `banana` 26.93, 25.18 and 26.81 in
place of 26.90, 25.18 and 26.73 dB, as they are (27.38, 24.11 and 26.98 before black).

Dropped: a colour by direction, a fit of second order to what photos show. Put behind scenes of `miku 12 far`
that were trained before the mean colour, it brings 0.00 and 0.12 dB (splits 1 and 2): 86 and 72 % of what
held-out photos show has an opacity above 0.99, smeared splats where no photo looked.

Dropped: the mean colour as 300 far splats, so that it is in every file. Held-out photos score as with it
behind the scene, but over each pixel that is empty some twenty of them lie: a frame of 19,500 splats that
fills a half of 1280x720 took `cpu` 37 ms in place of 15. Before black a scene so trained scores 0.1 to 0.5 dB
less than before its colour (`toy`, `miku 12 far`)."""


class Backdrop(NamedTuple):
    """What photos stand before."""

    colour: tuple[float, float, float]
    """0 to 1, a multiple of 1/255."""
    share: float
    """Of the photos' borders."""


def checked_colour(name: str, colour: Sequence[float]) -> tuple[float, float, float]:
    """A setting's colour, RGB from 0 to 1, in any sequence. Raises ValueError, which calls it `name`."""
    try:
        red, green, blue = map(float, colour)
    except (TypeError, ValueError):
        red = green = blue = math.nan
    if not all(0 <= part <= 1 for part in (red, green, blue)):
        raise ValueError(f"{name} must be three numbers from 0 to 1, got {colour!r}")
    return red, green, blue


def find_backdrop(views: Sequence[TrainView]) -> Backdrop | None:
    """The plain colour before which nearly all photos stand; None where there is none, and where photos are
    transparent, which says more."""
    if any(view.alpha is not None for view in views):
        return None
    some = views[:: -(-len(views) // MOST_PHOTOS)]
    borders = [_border(view) for view in some]
    borders = [border for border in borders if len(border)]
    if not borders:
        return None
    colour = np.median([np.median(border, axis=0) for border in borders], axis=0).round()
    shares = np.array([(np.abs(border - colour).max(axis=1) <= 255 * TOLERANCE).mean() for border in borders])
    if not (shares.mean() >= LEAST_OF_ALL and (shares >= LEAST_OF_A_PHOTO).mean() >= LEAST_PHOTOS):
        return None
    if not colour.max() > 255 * DARKEST and _is_frame([_plain(view, colour) for view in some]):
        return None
    red, green, blue = (float(part) for part in colour / 255)
    return Backdrop((red, green, blue), float(shares.mean()))


def automatic_surround(views: Sequence[TrainView], shown: float) -> tuple[float, float, float] | None:
    """The surround of photos that stand before no plain colour, of which so many show a place, see
    `TrainViews.photos_of_a_place`; None where it has nothing to do."""
    return None if shown >= ENOUGH_PHOTOS else mean_colour(views)


def mean_colour(views: Sequence[TrainView]) -> tuple[float, float, float] | None:
    """Of photos that show something everywhere, 0 to 1; None where they are transparent or all masked."""
    if any(view.alpha is not None for view in views):
        return None
    some = views[:: -(-len(views) // MOST_PHOTOS)]
    shown = [view.pixels.reshape(-1, 3) if view.mask is None else view.pixels[view.mask] for view in some]
    shown = [pixels[:: max(len(pixels) // MOST_PIXELS, 1)] for pixels in shown]
    means = [pixels.mean(axis=0) / 255 for pixels in shown if len(pixels)]
    if not means:
        return None
    red, green, blue = (float(part) for part in np.mean(means, axis=0).round(3))
    return red, green, blue


def surround_of_a_step(colour: Sequence[float], seed: Sequence[int]) -> np.ndarray:
    """(3,) float64, 0 to 1: what is behind the scene for one photo, about the surround's colour."""
    return np.clip(colour + SPREAD * np.random.default_rng(seed).uniform(-1, 1, 3), 0, 1)


def standing_in(view: TrainView, surround: Sequence[float], colour: np.ndarray) -> TrainView:
    """A picture that was drawn in front of the surround, with its opacity, in front of another colour, (3,)
    0 to 1; opaque from then on."""
    if view.alpha is None:
        return view
    empty = 1 - view.alpha[..., None] * np.float32(1 / 255)
    changed = view.pixels + empty * np.subtract(colour, surround).astype(np.float32) * 255
    return replace(view, pixels=(np.clip(changed, 0, 255) + 0.5).astype(np.uint8), alpha=None)


def standing_before(views: TrainViews, colour: Sequence[float]) -> TrainViews:
    """The photos with what is known to be empty, where `colour` is the backdrop that they have; else they
    themselves."""
    found = find_backdrop(views.all)
    if found is None or not np.abs(np.subtract(found.colour, colour)).max() <= TOLERANCE:
        return views
    level = np.array(found.colour) * 255
    return views.changed([_with_emptiness(view, level) for view in views.all])


def _is_frame(plain: list[np.ndarray]) -> bool:
    """Whether what photos show within the colour has one shape; photos of other sizes than most are left
    out."""
    shapes = [one.shape for one in plain]
    usual = max(set(shapes), key=shapes.count)
    within = ~np.stack([one for one in plain if one.shape == usual])
    other = np.roll(within, max(len(within) // 3, 1), axis=0)  # frames of a film are like their neighbours
    either, both = within | other, within & other
    return len(within) > 1 and both.sum() >= FRAME * either.sum()


def _plain(view: TrainView, level: np.ndarray) -> np.ndarray:
    """(H, W) bool: what has the colour and is connected to the border by it."""
    plain = (np.abs(view.pixels - level) <= 255 * TOLERANCE).all(axis=2)
    if view.mask is not None:
        plain &= view.mask
    flooded = np.zeros(plain.shape, np.bool_)
    flood(plain, flooded)
    return flooded


def _with_emptiness(view: TrainView, level: np.ndarray) -> TrainView:
    flooded = _plain(view, level)
    # A pixel at the rim shows some of the object.
    inner = np.pad(flooded, 1, constant_values=True)
    height, width = view.pixels.shape[:2]
    for y in range(3):
        for x in range(3):
            flooded &= inner[y : y + height, x : x + width]
    alpha = np.where(flooded, 0, 255).astype(np.uint8)
    return replace(view, alpha=alpha, alpha_known=0)


@kernel(allocates=True)
def flood(plain, flooded):
    """Sets in `flooded` (H, W) bool what is connected to the border by pixels of `plain` (H, W) bool."""
    height, width = plain.shape
    waiting, count = np.empty(height * width, np.int64), 0
    for y in range(height):
        for x in range(width):
            if (y in (0, height - 1) or x in (0, width - 1)) and plain[y, x]:
                flooded[y, x] = True
                waiting[count] = y * width + x
                count += 1
    while count > 0:
        count -= 1
        y, x = waiting[count] // width, waiting[count] % width
        for dy, dx in ((0, 1), (0, -1), (1, 0), (-1, 0)):
            row, column = y + dy, x + dx
            if not (0 <= row < height and 0 <= column < width):
                continue
            if plain[row, column] and not flooded[row, column]:
                flooded[row, column] = True
                waiting[count] = row * width + column
                count += 1


def _border(view: TrainView) -> np.ndarray:
    """(P, 3) float64: the pixels of a photo's border that show the scene."""
    height, width = view.pixels.shape[:2]
    deep = max(round(BORDER * min(height, width)), 1)
    is_border = np.ones((height, width), np.bool_)
    is_border[deep : height - deep, deep : width - deep] = False
    if view.mask is not None:
        is_border &= view.mask
    return view.pixels[is_border].astype(np.float64)
