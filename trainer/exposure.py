"""Photos of different exposure: a gain and an offset for each photo and colour, learnt beside the scene.

The scene is drawn, gain·x + offset is compared to the photo, and both are trained by Adam: the scene comes to
the photos' average exposure. Only captures whose photos differ need this, and elsewhere it harms: `skull RGBA
100` of the bench, which shines and has one exposure, scores 29.96 dB without (20,000 splats), and 27.46 where
it was learnt (35,000), as the scene is then right for no photo.

So photos are compared with one another before the first step: of the places where splats begin, which are the
capture's points or found by stereo, those in front are the same in both of two photos, and the median of the
log ratios of their colours is what the exposures differ by. Only where splats begin at random, or too few
photos share places, that waits for an early moment of the run. For each photo the gain that explains its
pairs best (least absolute differences), and how sure it is by what gains leave unexplained: surfaces that
look brighter from one side make ratios that no gain for each photo explains, and they do so more in one
colour than in another, where exposures are grey.

Gains that explain nearly all are exposure, 15 times what they leave and more: `demo drift 40`, whose drift is
known (28 to 36 by its splits), `castle` (20 to 52) and a split of `toy` (31). The next are `miku 20 near`
(13), `toy` (13) and `miku 12 near` (11). Where splats stand after a thirtieth of the run, which is what
decided before, splits of `castle` have 8 to 17 and fell on either side by chance and by the length of the
run: one scored 14.9 dB after a minute, where exposures were learnt, and 12.6 after three, where they were
not. Others, as on `miku` and `fox` (3 to 5), may be light, or a camera that adapts to where it looks: learnt
gains are a smooth function of the camera's place there (neighbours explain 96 % of them on `fox`, 93 % on
`miku`), which colours by direction learn as well, and a scene at the average exposure is right for no photo
as it is. Chosen by what a minute scores, after a fit and as it is, docs/training-recipe.md has the table:
kept, `fox` gains 0.2 and loses 3.4 dB, `miku` gains 0.6 and loses 1.6, and `spot RGBA 60`, of one exposure,
loses 1.2 as it is; a split of `castle` gains 0.5 and 1.3, one of `toy` 0.2 and 0.8. Judged: `desk` (11)
gains 0.2 and loses 3.7. `train front 30`, lights on black, differed by 16 % (known to 0.8 %) until places
beside the bare background were left out, with which blurred colours mix: 45.12 dB after three minutes where
it was on.

Light that changes from photo to photo leaves much that no gain explains: `liberty`, a statue in many people's
photos, in any weather, differs by 33 %, known to 14 %. What tells that from shine is that photos from nearly
the same place differ too, which see the same shine, and the same surroundings if the camera adapts to these:
by a median of 25 % on `liberty`, where `demo drift 40`, whose drift is slow, has 11, `skull close 80` 7, and
most others less than 4 (assets/benchmarks/exposure_evidence.json). With it a minute of `liberty`, on one
split of which that was chosen, has 22.66 and 21.54 dB after a fit and as it is, 21.98 and 21.47 without.

Dropped: to learn gains that may be light, too, and to let them fade out when half of the run is over. Over 15
splits of 9 captures that scores 0.04 dB more than none after a fit (standard error 0.07), and 0.09 (0.08) as
it is; and to tell shine by how far the places that two photos share disagree about their ratio, which 15
times makes needless (6 to 15 % on these photographs, 22 to 54 % on `skull`, `guitar` and `playbot`).

Nor are they learnt where photos are few (a minute, three splits, after a fit and as they are): `miku 12 far`
21.41 and 20.70 dB, 21.00 and 19.65 with them.

Dropped: to compare photos with the scene as it stands, which takes shine for exposure (11 % on `playbot RGBA
18`, known to 2.6 %) and has learnt exposures itself where photos are few (3 % on `miku 12 far`).

Dropped: what EXIF says (time, aperture, ISO) as evidence: photos were developed since. Logs of the gains by
which those of `museum` differ (0.34, standard deviation) correlate with it by -0.04, of `liberty` by 0.21.

Dropped: to learn vignetting too. After a minute photos are darker than the scene at their corners by 1.1 %
(`banana`, 0.2 % standard error) and 0.9 % (`miku`, 0.4 %), a third of what would call for a gain.

Nor do places that photos share tell vignetting before the first step. By them corners are darker by 21 % on
`banana` (3 % standard error), 10 % on `miku` (2 %) and 38 % on `desk` (5 %), but also by 16 % on `playbot
close 80` (5 %) and -96 % on `guitar front 36` (22 %), which have none. With photos brightened by that, and
pictures darkened again, a minute of split 0 of `desk` has 31.48 dB after a fit in place of 33.14, and of
three splits of `banana` 26.98 in place of 26.78 and an SSIM of 0.704 in place of 0.717.

A held-out photo has an exposure too, which nobody has trained. Where gains are learnt it is measured after
a fit to most of its pixels: those of the white tiles of a chessboard with the gain and offset of the black
ones, and the other way round, so that no pixel is measured by a fit that has seen it. Where none are learnt
pictures are measured as they are. Dropped: the left half with the exposure of the right
one (Martin-Brualla et al. 2021, NeRF in the Wild), which is less true the less the halves show the same: two
splits of `miku 20 near` score 26.84 and 28.54 dB so, by tiles 27.77 and 30.11, and by a fit to all pixels,
which has six numbers to choose for 90,000 pixels, 27.79 and 30.12.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, ImageFilter

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.scene import Camera, RenderSettings
from splatview.scene.captures.capture import astray
from splatview.trainer.adam_kernels import PhotoAdam
from splatview.trainer.views import TrainView, opacities

Mode = Literal["auto", "on", "off"]

DECIDED_AT, DECIDED_BY = 1 / 30, 0.1
"""Shares of the run: the first, once photos were looked at `LEAST_ROUNDS` times; the second in any case."""

LEAST_ROUNDS = 4
"""Before, gains would be taken from a scene that is not there yet."""

LEAST_SPREAD = 0.03
"""Standard deviation of log gains that there must be. That of `banana` is 0.028; there correction loses 0.2
dB after a fit, 0.7 as it is."""

LEAST_CERTAINTY = 15.0
"""Standard deviations of what gains leave unexplained, see `unexplained`, that the spread must be."""

MOST_UNEVEN = 1.5
"""Ratio of the spreads of the colours that differ most and least."""

LEAST_NEAR, NEARLY, FEWEST_NEAR = 0.15, 15.0, 5
"""Median log ratio of photos from nearly the same place that calls for correction whatever gains explain:
twice the largest that a capture of one exposure has. Degrees between their rays to most of the places that
they share, at most, and the pairs that there must be."""

MOST_PHOTOS = 40
"""Photos that are compared: spread over all."""

MOST_POINTS, LEAST_SHARED = 5000, 30
"""Splats whose places are compared, and those that two photos share at least."""

CELLS, IN_FRONT = 24, 1.05
"""Along a photo's longer side, in each of which the nearest splat is in front, and so are those no farther
than so many times its depth."""

BLUR = 0.012
"""Standard deviation of the blur of photos, in longer sides: places are not known to the pixel."""

DARKEST, BRIGHTEST, OPAQUE = 12, 243, 250
"""Of 255: colours from which a ratio can be told, and opacity of what hides what is behind."""

RATE, RATE_END = 1.5e-2, 1e-3
"""Of log gains and offsets at the start and the end of the run, exponentially in between."""

LARGEST_LOG_GAIN = 1.5
"""Fits beyond a factor of 4.5 are those of pictures that show nothing yet."""

GREY_GAINS = np.exp(np.linspace(-LARGEST_LOG_GAIN, LARGEST_LOG_GAIN, 61))[
    np.argsort(np.abs(np.arange(61) - 30))
]
TILES = 8
"""Along a photo's longer side, see `fitted_by_tiles`."""

MOST_FITTED, SAME, FITS = 20_000, 0.1, 4
"""How the exposure of a held-out photo is found: the gain by which most pixels differ by less than `SAME`, of
1, of so many, the one nearest to 1 first; and lines for the colours of such pixels, time and again. One photo
of `castle` has a tree on half of its left half, which no other shows: least squares over all pixels, and
least absolute differences, made the right half a third as bright (6.9 and 6.7 dB; as it is 8.5, so 8.6)."""


class Evidence(NamedTuple):
    """What speaks for correcting exposures."""

    spread: float
    """Standard deviation of the photos' log gains, root mean square over colours."""
    error: float
    """Standard deviation of what gains leave unexplained, root mean square over colours."""
    unevenness: float = 1.0
    """Ratio of the spreads of the colours that differ most and least."""
    near: float = 0.0
    """Median log ratio of photos from nearly the same place; 0 where there are too few."""

    @property
    def calls_for_correction(self) -> bool:
        known = self.spread > LEAST_CERTAINTY * self.error and self.unevenness < MOST_UNEVEN
        return self.spread > LEAST_SPREAD and (known or self.near > LEAST_NEAR)

    def __str__(self) -> str:
        if not np.isfinite(self.error):
            return "nothing that several photos show tells whether they differ in exposure"
        found = f"photos differ in exposure by {self.spread:.0%} (known to {self.error:.1%})"
        found += f", from nearly the same place by {self.near:.0%}" if self.near > LEAST_NEAR else ""
        uneven = self.spread > LEAST_SPREAD and not self.unevenness < MOST_UNEVEN
        return found + (f", {self.unevenness:.1f} times more in one colour than in another" if uneven else "")


@dataclass(eq=False)
class Exposures:
    """The exposures of a run's photos. Nothing is computed where it is off."""

    names: Sequence[str]
    """Names of the photos, by camera."""
    mode: Mode = "auto"
    is_decided: bool = False
    is_on: bool = False
    evidence: Evidence | None = None
    """What the decision is made by, once there is something to tell from."""

    def __post_init__(self) -> None:
        shape = (len(self.names), 3, 2)
        self.table = np.zeros(shape)
        """(P, 3, 2): log gain and offset of each photo and colour; their means over photos are 0."""
        self.gradients = np.zeros(shape)
        """Of the loss by the table in this step, 0 for photos that are not part of it."""
        self._adam = PhotoAdam(shape)
        self._rows = {name: row for row, name in enumerate(self.names)}

    def is_due(self, progress: float, rounds: float) -> bool:
        """Whether it is to be decided now, at this share of the run and after so many looks at each photo."""
        if self.mode == "off" or self.is_decided:
            return False
        return progress >= (DECIDED_AT if rounds >= LEAST_ROUNDS else DECIDED_BY)

    def measure(
        self, places: np.ndarray, views: Sequence[TrainView], background: tuple[float, float, float]
    ) -> None:
        """Compares photos, one for each name and in any size, at places (N, 3) of the scene, where that is
        what decides and has not been done; as if nothing had been done where they share too few places."""
        if self.mode == "auto" and self.evidence is None and not self.is_decided:
            found = measured_evidence(places, views, background)
            self.evidence = found if found.error < np.inf else None

    def decide(
        self,
        parameters: Parameters,
        views: Sequence[TrainView],
        settings: RenderSettings,
        workspace: Workspace,
        threads: int,
        places: np.ndarray | None = None,
    ) -> None:
        """Decides by what `measure` has found, or finds now where the scene's splats are, or at `places`
        (N, 3); gains begin at what the scene says about photos, one for each name and in any size."""

        def picture(view: TrainView) -> np.ndarray:
            return draw_frame(parameters, view.camera, settings, workspace, threads=threads).image[..., :3]

        means = parameters.means if places is None else places
        background = settings.background if isinstance(settings.background, tuple) else (0.0, 0.0, 0.0)
        self.measure(means, views, background)
        if self.mode == "auto" and self.evidence is None:
            self.evidence = Evidence(0.0, np.inf)
        self.is_decided = True
        self.is_on = self.mode == "on" or (self.evidence is not None and self.evidence.calls_for_correction)
        if self.is_on:
            for row, view in enumerate(views):
                self.table[row, :, 0] = np.nan_to_num(log_gain(picture(view), view))
            self.table -= self.table.mean(axis=0)

    def of(self, name: str) -> np.ndarray:
        """(3, 2): log gain and offset of a photo's colours, see `functional.expose`."""
        return self.table[self._rows[name]]

    def row(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """A photo's rows (3, 2) of `table` and `gradients`, not copies."""
        return self.table[self._rows[name]], self.gradients[self._rows[name]]

    def step(self, progress: float, batch: int) -> None:
        """One step of Adam for the photos that `gradients`, sums over a batch of so many, name."""
        rows = np.flatnonzero((self.gradients != 0).any(axis=(1, 2)))
        rate = RATE * (RATE_END / RATE) ** progress
        self.table[rows] += self._adam.moves(rows, self.gradients[rows] / batch, rate)
        # Brighter splats and lower gains look the same: the scene keeps the average exposure.
        self.table -= self.table.mean(axis=0)
        self.gradients[:] = 0

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""
        return {
            "decision": np.array([self.is_decided, self.is_on]),
            "table": self.table,
            "evidence": np.array(self.evidence or (np.nan,) * 3),
            **self._adam.state(),
        }

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on where another's `state` was taken, of the same photos."""
        self.is_decided, self.is_on = (bool(value) for value in state["decision"])
        self.table[:] = state["table"]
        self._adam.restore(state)
        found = state.get("evidence", np.full(3, np.nan))
        # Checkpoints of older versions have three numbers.
        self.evidence = None if np.isnan(found).any() else Evidence(*found.tolist())


def log_gain(picture: np.ndarray, view: TrainView) -> np.ndarray:
    """Of the gain that takes a picture (H, W, 3) nearest to its photo: (3,), NaN where it shows nothing."""
    use = np.ones(picture.shape[:2], np.bool_) if view.mask is None else view.mask
    pictures, photo = picture[use].astype(np.float64), view.pixels[use] / 255.0
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log((pictures * photo).sum(axis=0) / (pictures * pictures).sum(axis=0))
    return np.where(np.abs(logs) < LARGEST_LOG_GAIN, logs, np.nan)


def measured_evidence(
    means: np.ndarray, views: Sequence[TrainView], background: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Evidence:
    """By the colours of what is at means (N, 3); photos that share too little are left out."""
    usable = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    points = usable[:: max(-(-len(usable) // MOST_POINTS), 1)]
    far = astray(np.array([view.camera.eye for view in views]))  # what one shows there is not what it is
    views = [view for view, is_far in zip(views, far, strict=True) if not is_far]
    some = views[:: -(-len(views) // MOST_PHOTOS)]
    logs = [log_colours(points, view, background) for view in some]
    pairs, ratios, near = [], [], []
    for i, j in combinations(range(len(some)), 2):
        differences = logs[i] - logs[j]
        shared = np.isfinite(differences[:, 0])
        if np.count_nonzero(shared) >= LEAST_SHARED:
            pairs.append((i, j))
            ratios.append(np.median(differences[shared], axis=0))
            if angle_between(some[i].camera, some[j].camera, points[shared]) <= NEARLY:
                near.append(np.abs(ratios[-1]))
    design = np.zeros((len(pairs), len(some)))
    for row, (i, j) in zip(design, pairs, strict=True):
        row[i], row[j] = 1, -1
    design = design[:, design.any(axis=0)]
    freedom = len(pairs) - (np.linalg.matrix_rank(design) if len(pairs) else 0)
    if freedom < 1:
        return Evidence(0.0, np.inf)
    spreads, errors = [], []
    for ratio in np.transpose(ratios):
        gains = least_absolute(design, ratio)
        spreads.append(np.std(gains))
        errors.append(unexplained(design @ gains - ratio, freedom))
    spread, error = (float(np.sqrt(np.mean(np.square(values)))) for values in (spreads, errors))
    uneven = float(max(spreads) / max(min(spreads), 1e-9))
    return Evidence(spread, error, uneven, float(np.median(near)) if len(near) >= FEWEST_NEAR else 0.0)


def unexplained(differences: np.ndarray, freedom: int) -> float:
    """Standard deviation of what gains, by least absolute differences, leave of ratios of pairs of photos:
    differences (R,), with so many degrees of freedom. By their median, 1.48 of which are a standard
    deviation, or half of what the upper quartile says, 1.15 standard deviations, where that is more.

    Most pairs may be of photos side by side, which agree on any light, and gains meet as many pairs as there
    are photos: by the median alone split 2 of `rose`, rendered by one exposure, whose spread is 15.6 times
    what they leave (of other splits 3.5 and 4.8), learnt exposures and had 42.1 dB after a minute and 41.1
    after three, as pictures are, in place of 44.8 and 44.9. By the quartile it is 4.5 times, and 26 to 30 of
    `demo drift 40`, 13 to 23 of `castle`, 8 of the split of `toy` that learns them. Chosen so that none but
    `rose` changes. Dropped: the quartile alone, twelve times, where split 0 of `castle` learns exposures (13
    times) and split 1 of `toy` does not, after a fit and as pictures are: three minutes of `castle` 19.24 and
    17.87 dB in place of 19.82 and 18.73, a minute 18.96 and 17.65 of 18.75 and 17.69, a minute of `toy` 21.92
    and 18.15 of 22.66 and 19.06."""
    left = np.sort(np.abs(differences))
    middle = 1.48 * np.median(left) * np.sqrt(len(left) / freedom)
    upper = np.quantile(left[len(left) - freedom :], 0.75) / 1.15
    return float(max(middle, upper / 2))


def angle_between(one: Camera, other: Camera, points: np.ndarray) -> float:
    """Degrees between the rays of two cameras to points (N, 3), the median; NaN where one is in a camera."""
    a, b = points - one.eye, points - other.eye
    with np.errstate(invalid="ignore"):
        cosines = (a * b).sum(axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
    return float(np.degrees(np.arccos(np.clip(np.median(cosines), -1, 1))))


def least_absolute(design: np.ndarray, values: np.ndarray) -> np.ndarray:
    """x (K,) for which the absolute differences of design (R, K) @ x to values (R,) are least together, by
    least squares with weights that follow the differences."""
    weights = np.ones(len(values))
    for _ in range(20):
        x = np.linalg.lstsq(design * weights[:, None], values * weights, rcond=None)[0]
        weights = 1 / np.sqrt(np.maximum(np.abs(design @ x - values), 1e-3))
    return x  # pyright: ignore[reportPossiblyUnboundVariable]


def log_colours(points: np.ndarray, view: TrainView, background: tuple[float, float, float]) -> np.ndarray:
    """(P, 3): logs of a photo's colours where it shows points (P, 3); NaN where one is behind another, at the
    rim, masked or see-through, so near to the bare background that it mixes with it, or so dark or bright
    that its ratio to others says nothing."""
    camera, found = view.camera, np.full(points.shape, np.nan)
    local = points @ camera.R_camera_world.T + camera.t_camera_world
    ahead = np.flatnonzero(local[:, 2] > 0)
    x, y = camera.image_points(local[ahead]).T
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    ahead, x, y = ahead[inside], x[inside].astype(np.int64), y[inside].astype(np.int64)
    side = max(camera.width, camera.height)
    cells = (y * CELLS // side) * CELLS + x * CELLS // side
    depths, nearest = local[ahead, 2], np.full(CELLS * CELLS, np.inf)
    np.minimum.at(nearest, cells, depths)

    def blurred(pixels: np.ndarray) -> np.ndarray:
        return np.asarray(Image.fromarray(pixels).filter(ImageFilter.GaussianBlur(BLUR * side)))[y, x]

    colours = blurred(view.pixels)
    use = depths <= IN_FRONT * nearest[cells]
    use &= ((colours > DARKEST) & (colours < BRIGHTEST)).all(axis=1)
    if view.mask is not None:
        use &= view.mask[y, x]
    use &= blurred(opacities(view, background)) > OPAQUE
    found[ahead[use]] = np.log(colours[use].astype(np.float64))
    return found


def fitted(
    picture: np.ndarray, photo: np.ndarray, mask: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Gain (3,) and offset (3,) that take a picture (H, W, 3) nearest to a photo (H, W, 3) uint8, by least
    squares over those pixels of the mask (H, W) that show the same; 1 and 0 for a colour that is the same all
    over."""
    use = np.ones(photo.shape[:2], np.bool_) if mask is None else mask.copy()
    use &= np.isfinite(picture).all(axis=2)
    x, y = picture[use].astype(np.float64), photo[use] / 255.0
    gains, offsets = np.ones(3), np.zeros(3)
    if len(x) == 0:
        return gains, offsets
    some = slice(None, None, -(-len(x) // MOST_FITTED))
    agreeing = [np.count_nonzero(alike(gain * x[some], y[some])) for gain in GREY_GAINS]
    gains[:] = GREY_GAINS[int(np.argmax(agreeing))]
    for _ in range(FITS):
        same = alike(gains * x + offsets, y)
        found = [line(x[same, channel], y[same, channel]) for channel in range(3)]
        gains, offsets = np.array(found).T
    return gains, offsets


def alike(picture: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """(N,) bool: pixels of a picture (N, 3) that may show the same as those of a photo (N, 3)."""
    return np.abs(picture - photo).max(axis=1) < SAME


def line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Gain and offset of least squares that take x (N,) to y (N,); 1 and 0 where x is the same all over."""
    variance = np.var(x) if len(x) else 0.0
    if not variance > 1e-12:
        return 1.0, 0.0
    gain = np.mean((x - x.mean()) * (y - y.mean())) / variance
    gain = float(np.clip(gain, np.exp(-LARGEST_LOG_GAIN), np.exp(LARGEST_LOG_GAIN)))
    return gain, float(y.mean() - gain * x.mean())


def fitted_by_tiles(picture: np.ndarray, view: TrainView) -> np.ndarray:
    """The picture (H, W, 3) as a chessboard of tiles: white ones at the exposure that fits black ones best,
    and the other way round."""
    height, width = picture.shape[:2]
    side = -(-max(height, width) // TILES)
    white = np.add.outer(np.arange(height) // side, np.arange(width) // side) % 2 == 0
    out = np.empty_like(picture)
    for here in (white, ~white):
        gain, offset = fitted(picture, view.pixels, ~here if view.mask is None else ~here & view.mask)
        out[here] = picture[here] * gain.astype(picture.dtype) + offset.astype(picture.dtype)
    return out
