"""Transients: parts of photos that the others contradict, as somebody who walks past; a run masks them.

Early in a run, once there is a scene, and before single photos are learnt by heart, each photo is compared
with what the scene shows from its camera without the splats that this photo alone shows. Where low
frequencies differ by much more than those of other photos do at the same places, and what others show is
opaque, the photo shows something else than they do. Masks then keep it from the scene; without them it
becomes a floater before other cameras.

That a place is hard to learn all its photos say, so that each pixel has what is usual there: every splat's
mean difference over the other photos, by its contributions to them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from splatview.raster import Parameters, Workspace, draw_frame
from splatview.raster.gradients import differentiate
from splatview.scene import RenderSettings
from splatview.scene.sh import SH_C0
from splatview.trainer.distributed import Group
from splatview.trainer.exposure import least_absolute
from splatview.trainer.outliers import FEWEST_PHOTOS, compared_as, is_time_to_compare, window_sums
from splatview.trainer.views import TrainView

Mode = Literal["auto", "off"]

RADIUS = 3
"""px of windows over which differences are means: edges that a scene has not learnt yet cancel out."""

LEAST_RATIO = 4.0
"""Of a difference to what is usual at its place, and `USUAL`, from which on it is a transient.

Chosen on states at a tenth of runs of a minute. With spots before a fifth of the photos of `fox`, `desk`,
`carton`, `gum` and `stitch` 41 of 44 are found, and one other photo. As they are, `statue` and `field` have
none, `queen` 1 of 15, `mug` 2 of 51, and `beer`, half of whose poses are wrong, 15 of 47. Dropped: ratios of
2.5 and differences of 0.05, by which 43 are found and six others, but 12 of `queen`, 8 of `mug`, the shade of
whoever took them, and 10 of `field`, tractors and clouds. A minute of these, as their photos are, those held
out included: `mug` 29.82 dB without masks and 29.66 with them, `field` 28.57 and 28.36; with spots `banana`,
two of which are found then, 26.97 and 27.30. With 5 and 0.1 31 are found.
"""

USUAL = 0.02
"""Of 1: by so much photos differ anywhere."""

LEAST_DIFFERENCE = 0.08
"""Of 1, that it must be besides."""

LEAST_OPACITY = 0.9
"""Of what others show there."""

EDGE = 0.3
"""Share of `LEAST_RATIO` and `LEAST_DIFFERENCE` that all of a transient has which reaches them somewhere.
With 0.4 and 0.5 masks cover 83 and 76 % of the spots of `desk` in place of 95, 86 and 80 of `fox` in place of
92."""

LEAST_PART = 0.003
"""Of a photo, that must reach them: less is noise."""

LARGEST_SHARE = 1 / 4
"""Of the photos that may have transients: where more do, the scene is not what photos agree on."""

SUSPECT, SUSPECT_RATIO = 0.75, 2.0
"""Share of `LEAST_DIFFERENCE`, and ratio, by which a photo must differ from the scene as a whole to be looked
at for what its own splats hide."""

MOST_TOLD = 100
"""Photos that say what is usual, besides those that are looked at."""

ALONE = 0.9
"""Share of a splat's contributions to all photos, of which a photo that has more shows it alone."""

LEAST_OTHERS = 0.02
"""Share of a splat's contributions that other photos must have to know it."""


@dataclass(eq=False)
class Transients:
    """Which parts of a run's photos are masked."""

    names: Sequence[str]
    """Names of the photos, by camera."""
    mode: Mode = "auto"
    is_decided: bool = False

    def __post_init__(self) -> None:
        self.regions: list[np.ndarray | None] = [None] * len(self.names)
        """(h, w) bool for each photo, made smaller: true where it is masked; None: nowhere."""
        self.found = 0
        """Photos that have some, whether they are masked or not."""

    def is_due(self, progress: float, rounds: float) -> bool:
        """Whether it is to be decided now, at this share of the run and after so many looks at each photo."""
        open_yet = self.mode == "auto" and not self.is_decided and len(self.names) >= FEWEST_PHOTOS
        return open_yet and is_time_to_compare(progress, rounds)

    def decide(self, regions: Sequence[np.ndarray]) -> None:
        """Masks these parts of the photos, (h, w) bool each; none where too many photos have some."""
        self.is_decided = True
        self.found = sum(bool(region.any()) for region in regions)
        if self.found <= LARGEST_SHARE * len(self.names):
            self.regions = [region if region.any() else None for region in regions]

    @property
    def masked(self) -> int:
        """Photos of which a part is masked."""
        return sum(region is not None for region in self.regions)

    @property
    def evidence(self) -> str:
        """What was found, for the user; "" where nobody has looked."""
        if not self.is_decided:
            return ""
        if not self.found:
            return "photos agree with one another"
        if not self.masked:
            return f"{self.found} of {len(self.names)} photos contradict others somewhere, too many to mask"
        shares = [0.0 if region is None else region.mean() for region in self.regions]
        most = int(np.argmax(shares))
        return (
            f"{self.masked} of {len(self.names)} photos show something that others do not, in"
            f" {100 * np.sum(shares) / self.masked:.1f} % of their pixels; most of all {self.names[most]}"
        )

    def blocks(self, views: Sequence[TrainView]) -> list[np.ndarray | None] | None:
        """(H, W) bool for each of the photos, in full size, or None where all of it is trained on; None where
        all of all are."""
        if not self.masked:
            return None
        pairs = zip(views, self.regions, strict=True)
        return [
            None if region is None else enlarged(region, *view.pixels.shape[:2]) for view, region in pairs
        ]

    def state(self) -> dict[str, np.ndarray]:
        """Arrays that `restore` takes."""
        numbers = np.array([self.is_decided, self.found, len(self.names)], np.int64)
        parts = {f"transients.{row}": part for row, part in enumerate(self.regions) if part is not None}
        return {"transients": numbers} | parts

    def restore(self, state: dict[str, np.ndarray]) -> None:
        """Goes on from the `state` of another run of the same photos. Raises ValueError: it was of others."""
        numbers = state["transients"]
        if numbers.shape != (3,) or numbers[2] != len(self.names):
            raise ValueError("its transients are not those of its photos")
        parts = [state.get(f"transients.{row}") for row in range(len(self.names))]
        if any(part is not None and (part.ndim != 2 or part.dtype != np.bool_) for part in parts):
            raise ValueError("its transients are no masks")
        self.is_decided, self.found, self.regions = bool(numbers[0]), int(numbers[1]), parts


def find_transients(
    parameters: Parameters,
    views: Sequence[TrainView],
    taken: np.ndarray,
    settings: RenderSettings,
    threads: int | None = None,
) -> list[np.ndarray]:
    """(h, w) bool for each photo, as large as it is compared: where it shows something that the others
    contradict, by the scene as it is. `taken` (P,) bool: the photos that are trained on, of which the scene
    tells.

    On one core 1.1 s for `fox` (33 photos, 16,700 splats), 1.6 for `mug` (51, 11,800), 4.5 for `stitch` (58,
    20,400), nearly all photos of which are suspects, as a minute is short for it."""
    small = [compared_as(view) for view in views]
    regions = [np.zeros(view.pixels.shape[:2], np.bool_) for view in small]
    rows, usual = np.flatnonzero(taken), replace(settings, sh_degree=0, background=(0.0, 0.0, 0.0))
    told = rows[:: -(-len(rows) // MOST_TOLD) or 1]
    workspace, fits, lows, differences = Workspace(), {}, {}, {}
    for row in rows:
        picture = draw_frame(parameters, small[row].camera, settings, workspace, threads=threads).image
        fits[row] = exposure_between(picture, small[row])
        apart = difference(picture, small[row], fits[row])
        lows[row] = np.abs(mean_about(apart)).mean(axis=2).astype(np.float16)
        differences[row] = np.abs(apart).mean(axis=2).astype(np.float16)
    known = np.zeros((2, len(parameters.means)))
    for row in told:
        known += by_splat(parameters, small[row], usual, differences[row], workspace, threads)
    coloured = with_usual(parameters, known)
    for row in rows:
        view = small[row]
        if not (lows[row] > SUSPECT * LEAST_DIFFERENCE).mean() >= LEAST_PART:
            continue
        drawn = draw_frame(coloured, view.camera, usual, workspace, threads=threads).image
        if not is_suspect(lows[row].astype(np.float64), drawn):
            continue
        own = by_splat(parameters, view, usual, differences[row], workspace, threads)
        others = known - own if row in told else known
        whole = own[0] + others[0]
        alone, others = own[0] > ALONE * whole, others * (others[0] > LEAST_OTHERS * whole)
        rest = Parameters(*(np.ascontiguousarray(array[~alone]) for array in parameters))
        picture = draw_frame(rest, view.camera, settings, workspace, threads=threads).image
        rest = with_usual(rest, others[:, ~alone])
        drawn = draw_frame(rest, view.camera, usual, workspace, threads=threads).image
        regions[row] = contradicted(picture, view, fits[row], drawn)
    return regions


def agreed(regions: Sequence[np.ndarray], group: Group) -> list[np.ndarray]:
    """What most processes have found, to the last pixel: the same for each."""
    votes = [region.astype(np.float64) for region in regions]
    group.add_up(votes)
    return [vote > group.size / 2 for vote in votes]


def by_splat(
    parameters: Parameters,
    view: TrainView,
    settings: RenderSettings,
    values: np.ndarray,
    workspace: Workspace,
    threads: int | None,
) -> np.ndarray:
    """(2, N) float64: each splat's contributions to a photo's view, and their sum with `values` (H, W):
    gradients by its colour, which nothing else changes."""
    grey = parameters._replace(sh=np.zeros((len(parameters.means), 1, 3), np.float32))
    frame = draw_frame(grey, view.camera, settings, workspace, threads=threads)
    weights = np.zeros_like(frame.image)
    weights[..., 0], weights[..., 1] = 1, values
    if view.mask is not None:
        weights *= view.mask[..., None]
    found = differentiate(grey, frame, weights, by_view=False).parameters.sh[:, 0, :2].T / SH_C0
    return np.maximum(found, 0).astype(np.float64)


def with_usual(parameters: Parameters, known: np.ndarray) -> Parameters:
    """The same with how much photos differ at a splat as its red, and whether that is known as its green.
    `known` (2, N): contributions to photos, and their sums with differences, see `by_splat`."""
    shown, noted = known
    colours = np.stack([noted / np.maximum(shown, 1e-12), shown > 0, np.zeros(len(shown))], axis=1)
    return parameters._replace(sh=((colours - 0.5) / SH_C0)[:, None].astype(np.float32))


def is_suspect(low: np.ndarray, usual: np.ndarray) -> bool:
    """Whether a photo, which differs from the scene as a whole by (H, W) in low frequencies, differs by so
    much more than is usual (H, W, 4) that a look at what others show is worth its time."""
    strong = (low > SUSPECT * LEAST_DIFFERENCE) & (low_ratio(low, usual) > SUSPECT_RATIO)
    return bool(strong.mean() >= LEAST_PART)


def low_ratio(low: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """(H, W): of a difference to what is usual, as `with_usual` is drawn (H, W, 4), and `USUAL`."""
    red, green = np.moveaxis(mean_about(usual[..., :2].astype(np.float64)), -1, 0)
    return low / (red / np.maximum(green, LEAST_KNOWN) + USUAL)


def exposure_between(picture: np.ndarray, view: TrainView) -> np.ndarray:
    """(3, 2) gain and offset by which a picture (H, W, 4) meets its photo, by the least absolute difference
    where it is opaque; 1 and 0 where too little is."""
    known = picture[..., 3] > LEAST_OPACITY
    if view.mask is not None:
        known &= view.mask
    known[np.arange(len(known)) % FITTED_OF > 0], known[:, np.arange(known.shape[1]) % FITTED_OF > 0] = 0, 0
    found = np.tile((1.0, 0.0), (3, 1))
    if known.sum() < FEWEST_PIXELS:
        return found
    for channel in range(3):
        shown = np.clip(picture[known, channel], 0, 1).astype(np.float64)
        design = np.stack([shown, np.ones(len(shown))], axis=1)
        gain, offset = least_absolute(design, view.pixels[known, channel] / 255)
        if LEAST_GAIN < gain < 1 / LEAST_GAIN:
            found[channel] = gain, offset
    return found


FEWEST_PIXELS = 100
"""From which exposures can be told."""

FITTED_OF = 3
"""Rows and columns of which one is looked at for that."""

LEAST_GAIN = 0.5
"""Gains beyond which it is no exposure that differs."""


def difference(picture: np.ndarray, view: TrainView, fit: np.ndarray) -> np.ndarray:
    """(H, W, 3) of a picture (H, W, 4), after a fit of exposures, to its photo; 0 where that is masked."""
    found = np.clip(np.nan_to_num(picture[..., :3]), 0, 1) * fit[:, 0] + fit[:, 1] - view.pixels / 255
    return found if view.mask is None else found * view.mask[..., None]


def contradicted(picture: np.ndarray, view: TrainView, fit: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """(H, W) bool: where a photo shows something else than what others do. `picture` (H, W, 4): what they
    show from its camera; `usual` (H, W, 4): in red how much they differ at the same places, in green how
    much of that is known."""
    low = np.abs(mean_about(difference(picture, view, fit))).mean(axis=2)
    ratio = low_ratio(low, usual)
    sure = mean_about(picture[..., 3].astype(np.float64)) > LEAST_OPACITY
    if view.mask is not None:
        sure &= view.mask
    weak = sure & (ratio > EDGE * LEAST_RATIO) & (low > EDGE * LEAST_DIFFERENCE)
    strong = weak & (ratio > LEAST_RATIO) & (low > LEAST_DIFFERENCE)
    if not strong.mean() >= LEAST_PART:
        return np.zeros(strong.shape, np.bool_)
    return closed(about(grown(strong, weak)))


LEAST_KNOWN = 0.05
"""Of what is usual in a pixel, below which it counts as less than it is."""


def mean_about(values: np.ndarray) -> np.ndarray:
    """Means of (H, W, ...) over windows of `RADIUS`, cut off at the border."""
    return window_sums(values, RADIUS) / window_sums(
        np.ones((*values.shape[:2], *(1,) * (values.ndim - 2))), RADIUS
    )


def about(pixels: np.ndarray, radius: int = 1) -> np.ndarray:
    """(H, W) bool: these pixels and those up to `radius` px beside them."""
    return window_sums(pixels.astype(np.float64), radius) > 0.5


def closed(pixels: np.ndarray) -> np.ndarray:
    """(H, W) bool: these pixels and gaps between them into which no square of `GAP` fits."""
    wide = about(np.pad(pixels, GAP), GAP)
    return ~about(~wide, GAP)[GAP:-GAP, GAP:-GAP]


GAP = 10
"""px, half a side: in a part of it what passes may look like what is behind. Without it masks and spots have
0.55 to 0.78 of what either covers in common, with 6 px 0.56 to 0.78, with 10 px 0.57 to 0.79 (`fox`, `desk`,
`carton`, `gum`, `stitch`)."""


def grown(seeds: np.ndarray, within: np.ndarray) -> np.ndarray:
    """(H, W) bool: the pixels of `within` that are connected to `seeds`, which are some of them."""
    while True:
        more = about(seeds) & within
        if (more == seeds).all():
            return seeds
        seeds = more


def enlarged(region: np.ndarray, height: int, width: int) -> np.ndarray:
    """(height, width) bool of (h, w), the nearest pixel of which each is."""
    rows, columns = (
        np.minimum(np.arange(large) * small // large, small - 1)
        for large, small in zip((height, width), region.shape, strict=True)
    )
    return region[np.ix_(rows, columns)]
