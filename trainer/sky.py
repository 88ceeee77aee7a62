"""Sky: what photos show at infinity becomes far splats before training, so that no view of it is black.

Where a photo shows a direction does not depend on the place that it was taken from, if what it shows is far
enough. So the sphere of directions is divided evenly (Fibonacci lattice, Gonzalez 2010), and a cell is
far where photos from places apart have one colour there, above the horizon, and no point of the capture is
near the cell in them. Where enough of the photos is far, two shells of opaque splats are added, many times
farther out than cameras and points: a fine one of the cells that photos have seen, whose colours are trained,
before a coarse one, as it is, of all directions down to the lowest of these, coloured smoothly from what was
seen: that is what a view shows that no photo had, and what comes out between trees as one walks on.

Found with these captures of the bench in view: `demo sky 40` (41 % of what photos show agrees at infinity,
and 4.3 times better than if it were nearer), `biker sky 30` (34 %, 5.6 times), and, without a sky, `biker
room 40` (31 %, 0.2 times), parts of `miku` (20 % and 0.9 times at most, or 6 % and 2.1 times), `banana`,
`biker front 24` and `train front 30` (none), `demo drift 40`, `demo hard 40` and `demo lens 40`, whose own
sky is splats (7 % and 0.7 times at most, or 1 %). Judged by captures that were made afterwards: `guitar sky
24` (42 %, 8.3 times) and `guitar room 24` (25 %, 0.3 times) are told apart.

Photographs came later. A bright sky is as even as a wall (`castle`: 7 to 12 %, 0.8 to 1.0 times), so what is
blue and brighter than the rest of the photos may agree as well if it were nearer; chosen on `castle`, with
all others in view. Its upper 60 % gain 2.2, 0.4 and 2.0 dB by the splats (three splits after a minute,
held-out photos as they are). The answer changes for no other capture of the bench, nor for `fox`, `tree`,
`kermit`, `toy`, `beach` and `bust`, which have no sky or hardly any. The sky over `street` (1 %) is not
found: points in clouds and behind houses lie before it, and photos walk into the view. Nor is that of
`building` (3 %), burnt out to white behind a house on all sides of which photos were taken: what splats show
for it there is white as well.

Dropped: far splats for what no photo shows of a room, too (`--sky on`). A minute, three splits each, held-out
photos as they are and after fits of exposure: `miku 12 far` -0.82 and -0.13 dB, `kermit` -0.73 and -0.05.
What stands for it is one colour, see `backdrop`.

Density control, regularisers and dropout leave these splats alone (`hold`): a regulariser of scales would
shrink a splat that is a hundred radii large before it did anything else, and noise, which grows with the
covariance, would fling it away.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np
from PIL import Image, ImageFilter

from splatview.edit.kernels import kdtree
from splatview.raster import Parameters
from splatview.scene import Camera
from splatview.scene.camera import likely_ups
from splatview.scene.captures import Capture
from splatview.scene.sh import SH_C0
from splatview.trainer.views import TrainView

Mode = Literal["auto", "on", "off"]

CELLS = 16_000
"""Directions that evidence is found in: 1.6 degrees apart. Photographs have points up to the edge of the sky:
of `castle`, a quarter of whose photos is sky, 7.0 % agree at infinity with these, 2.4 % with a fourth."""

MOST_PHOTOS = 60
"""Photos that are looked at; of more, an even choice."""

PIXELS_A_CELL = 2.0
"""Pixels of a photo along a cell, as its colours are compared."""

NEAR_POINT = 1.5
"""Cells about a point that are taken for what is near."""

FAR_EXTENTS = 40.0
"""Extents of the scene beyond which a point is as far as the sky."""

TOLERANCE = 0.08
"""Largest difference of a colour channel, of 1, of photos that agree."""

AGREEING = 0.6
"""Share of the photos without a point near that have to agree about a cell."""

APART = 0.15
"""Extents between two photos at least that agree."""

DARKEST = 0.06
"""Largest channel of a sky that is worth adding, apart from the background behind the scene."""

LEAST_COMMON_UP = 0.3
"""Length of the mean of the photos' ups from which on they have one in common."""

LOWEST = math.radians(-4)
"""Height above the horizon of what may be sky: the horizon itself is known to some degrees."""

LEAST_SHARE, LEAST_SHARE_OF_ANY_COLOUR = 0.05, 0.12
"""Share of the photos' area that has to be far where it has the colours of a sky, see `has_sky_colours`, and
where not."""

LEAST_BLUE, LEAST_BRIGHT = 0.06, 0.7
"""Of what is far: mean of blue less red, of 1 (0.11 and more for `castle`, whose sky is white in places), and
the share of the rest of the photos that is darker than its median. A white wall in cool light must not pass:
a sky behind the wall of `miku 20 near` costs 0.6 and 0.05 dB (two splits)."""

AROUND, ROUNDS, LEAST_AROUND_ONE, LEAST_AROUND = 12, 12, 0.3, 0.6
"""Neighbours of a cell, how often is looked for more, and the share of them that has to be far, for cells of
one photo and others. With a fourth of the cells and half the rounds 2 of 154 so added had a wrong colour on
`demo sky 40` (chosen), 10 of 305 on `biker sky 30` and 46 of 378, at the misty horizon, on `guitar sky 24`
(judged)."""

NEARER, LEAST_COMPARED = (1.5, 2.0, 3.0, 4.0), 12
"""Distances at which photos are compared too, in median depths of the points, and cells at least."""

MOST_LEFT, MOST_LEFT_OF_SKY = 0.7, 1.25
"""See `FarCells.left`; of what has the colours of a sky, which may be as even as a wall."""

RADIUS_EXTENTS, RADIUS_REACHES = 100.0, 10.0
"""Radius of the shell, in extents of the cameras and in distances of the points: whichever is more. A walk
as long as the extent turns the sky by half a degree. Files that share bits out over all positions lose some:
a landscape of 60,000 splats has 57.9 dB as .sog without a sky, 53.8, 52.3 and 51.5 with one at 30, 100 and
300 extents; .spz does not (48.1 to 49.7); for .compressed.ply see `sky_last` there."""

REACH = 0.98
"""Share of the points that are within the distance of the points."""

COARSE_CELLS, BEHIND = 1000, 2.0
"""Cells of the coarse shell over a whole sphere, at most one for ten splats of the scene, and its radius in
radii of the fine one. Splats are sorted by depth along the view: at 1.1 radii those beside the view are drawn
over what is in it."""

FINE_SHARE, MOST_FINE = 0.3, 30_000
"""Share of `max_splats` that the fine shell may have, and its splats at all. What it is too coarse for,
splats before it explain, each of one photo: they hang in the next one's air, and the longer a run is the
sharper. One run each, held-out photos as they are, with 0.12 and at most 0.6 splats for each point to begin
with (8 px a cell), 0.3 and 2 (5 px), and 0.5 and 4 with cells of 2 px at least, all with a `SIGMA` of 0.6.
Chosen: `biker sky 30` after a minute 29.64, 30.56 and 30.53 dB (split 0), 28.37, 29.31 and 29.30 (split 2),
after three 28.46 and 30.83. Judged, a minute: `guitar sky 24` 33.17, 33.51 and 33.04, `demo sky 40` 25.12,
25.35 and 25.12, after three 25.59 and 26.07. With 2 and 4 splats a point, and a `SIGMA` of 0.5, ten
minutes of `biker sky 30` score 30.18 and 31.41: now points are no limit. In splits 1 fog before one held-out
camera, which is chance, hid the gain at first: 28.80 and 28.29 there, 31.47 and 30.99 on `guitar sky 24`.
With a `SIGMA` of 0.5 these have 29.43 and 31.68, splits 1 and 2 of `demo sky 40` 23.92 and 24.33 in place
of 23.73 and 24.46."""

LEAST_FINE = 1000
"""Splats over a whole sphere, of fewer there is no fine shell."""

FINEST = 3.0
"""Pixels of the photos that a cell of the fine shell has at least along its side."""

SIGMA, COARSE_SIGMA = 0.6, 0.8
"""Standard deviations of the shells' splats, in distances of cells. Alone 0.6 leaves up to 5 % open, 0.8
0.2 %. With 0.42, 0.5, 0.6 and 0.75 for the fine one, a minute, one split: `biker sky 30` 30.59, 30.67, 30.56
and 30.07 dB, `guitar sky 24` 32.75, 33.58, 33.51 and 32.21; but photographs, `castle`, have 0.28 dB less with
0.5 than with 0.6 after a minute and 0.38 less after three, and no more in any of three splits."""

OPACITY = 0.99


class SkyEvidence(NamedTuple):
    """What speaks for a sky."""

    share: float
    """Share of the photos' area that is far, above the horizon."""
    left: float = math.inf
    """See `FarCells.left`."""
    coloured: bool = False
    """Whether it has the colours of a sky."""
    why_not: str = ""
    """Reason why nothing can be said; empty where it can."""

    @property
    def least_share(self) -> float:
        return LEAST_SHARE if self.coloured else LEAST_SHARE_OF_ANY_COLOUR

    @property
    def most_left(self) -> float:
        return MOST_LEFT_OF_SKY if self.coloured else MOST_LEFT

    @property
    def calls_for_sky(self) -> bool:
        return not self.why_not and self.share >= self.least_share and self.left <= self.most_left

    def __str__(self) -> str:
        if self.why_not:
            return self.why_not
        found = f"photos agree about {self.share:.1%} of what they show as if it were at infinity"
        if not self.share >= self.least_share:
            of_any = "" if self.coloured else " without the colours of a sky"
            return f"{found}, less than {self.least_share:.0%}{of_any}"
        if not self.left <= self.most_left:
            return f"{found}, and no less as if it were nearer: a plain wall does that"
        if self.left > MOST_LEFT:
            return f"{found}, about as well as nearer, but in the colours of a sky"
        return f"{found}, {1 / max(self.left, 0.01):.1f} times better than nearer"


@dataclass(frozen=True, eq=False)
class Sky:
    """The decision about a sky, and its splats."""

    mode: Mode
    evidence: SkyEvidence
    parameters: Parameters | None
    """Splats of both shells, degree 0; None where there are none."""
    fine: int = 0
    """How many of them, the first ones, have colours that are trained."""
    radius: float = 0.0
    """World units."""

    @property
    def count(self) -> int:
        return 0 if self.parameters is None else len(self.parameters.means)

    def flags(self, count: int) -> np.ndarray:
        """(count,) uint8: TRAINED and FIXED for the last splats, which are the sky's, 0 for the others."""
        flags = np.zeros(count, np.uint8)
        first = count - self.count
        flags[first : first + self.fine], flags[first + self.fine :] = TRAINED, FIXED
        return flags


TRAINED, FIXED = 1, 2
"""In the trainer's state "sky": splats of which colours alone are trained, and such that stay as they are."""


def with_sky(parameters: Parameters, sky: Sky) -> Parameters:
    """The splats, of degree 0, and those of the sky behind them."""
    if sky.parameters is None:
        return parameters
    return Parameters(*(np.concatenate(pair) for pair in zip(parameters, sky.parameters, strict=True)))


def hold(parameters: Parameters, state: Mapping[str, Any]) -> Parameters | None:
    """What a step must leave alone of the sky's splats: a copy of their rows, the colours of those that
    are FIXED. None where there are none."""
    if "sky" not in state:
        return None
    rows = np.flatnonzero(state["sky"])
    return Parameters(*(array[rows] for array in parameters[:4]), sh=parameters.sh[state["sky"] == FIXED])


def restore(parameters: Parameters, state: Mapping[str, Any], held: Parameters | None) -> None:
    """Puts back what was held, wherever the sky's splats are by now: in the same order, and none is gone."""
    if held is None:
        return
    rows = np.flatnonzero(state["sky"])
    for array, values in zip(parameters[:4], held[:4], strict=True):
        array[rows] = values
    parameters.sh[state["sky"] == FIXED] = held.sh


NO_SKY = Sky("off", SkyEvidence(0.0, why_not="as asked for"), None)


def find_sky(
    capture: Capture,
    views: Sequence[TrainView],
    points: np.ndarray,
    *,
    mode: Mode,
    most: int,
    background: Sequence[float] = (0.0, 0.0, 0.0),
    random_points: bool = False,
) -> Sky:
    """Looks for a sky in the photos, and makes its splats. `points` (P, 3) are those that training starts
    from, in the world of the views; `most`: splats that the whole scene may have; `background`: what is
    behind the scene anyway."""
    if mode == "off":
        return NO_SKY
    some = views[:: -(-len(views) // MOST_PHOTOS)]
    extent, ups = capture.scene_radius, likely_ups([view.camera for view in some], LEAST_COMMON_UP)
    why_not = _why_not(views, random_points and mode == "auto")
    if not ups or why_not:
        return Sky(mode, SkyEvidence(0.0, why_not=why_not or "photos have no common up"), None)
    if random_points:
        points = points[:0]
    looks = [Look.of(view, points, spacing_of(CELLS), FAR_EXTENTS * extent) for view in some]
    tried = [FarCells.of(looks, sphere(CELLS), up, extent, background) for up in ups]
    up, found = max(zip(ups, tried, strict=True), key=lambda pair: pair[1].share)
    left = found.left(looks, points) if found.far.any() and len(points) else math.inf
    evidence = SkyEvidence(found.share, left, found.has_sky_colours(looks))
    if not found.far.any() or (mode == "auto" and not evidence.calls_for_sky):
        return Sky(mode, evidence, None)
    found = found.grown(looks, up)
    radius = max(RADIUS_EXTENTS * extent, RADIUS_REACHES * reach_of(points, looks))
    most_fine = int(min(FINE_SHARE * most, MOST_FINE))
    coarse = sphere(int(np.clip(most / 10, COARSE_CELLS / 10, COARSE_CELLS)))
    parameters, fine = shells(found, some, points, up, extent, radius, most_fine, coarse)
    return Sky(mode, evidence, parameters, fine, radius)


def _why_not(views: Sequence[TrainView], random_points: bool) -> str:
    if any(view.alpha is not None for view in views):
        return "photos say where nothing is"
    if any(view.camera.orthographic for view in views):
        return "photos without perspective see no direction twice"
    if random_points:
        return "the capture has random points, which do not say what is near"
    return ""


def sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors, evenly over the sphere."""
    i = np.arange(count)
    z = 1 - (2 * i + 1) / count
    angle = np.pi * (3 - math.sqrt(5)) * i
    across = np.sqrt(1 - z * z)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)


def spacing_of(count: int) -> float:
    """Radians between neighbours of so many over the whole sphere."""
    return math.sqrt(4 * math.pi / count)


@dataclass(frozen=True, eq=False)
class Look:
    """A photo as directions are looked up in it."""

    camera: Camera
    pixels: np.ndarray
    """(H, W, 3) uint8, in which a cell is some PIXELS_A_CELL wide."""
    usable: np.ndarray
    """(H, W) bool: neither masked nor near a point that is not far."""
    masked: np.ndarray | None
    """(H, W) bool, false where masked; None: nowhere."""

    @classmethod
    def of(cls, view: TrainView, points: np.ndarray, spacing: float, far: float) -> Look:
        """`points` (P, 3) less than `far` away hide what is behind them; `spacing` of cells in radians."""
        view = view.smaller(max(1, round(view.camera.fx * spacing / PIXELS_A_CELL)))
        camera, near = view.camera, np.zeros(view.pixels.shape[:2], np.uint8)
        local = points @ camera.R_camera_world.T + camera.t_camera_world
        inside, x, y = placed(camera, local)
        close = np.linalg.norm(local[inside], axis=1) < far
        near[y[close], x[close]] = 255
        size = 2 * max(1, round(NEAR_POINT * spacing * camera.fx)) + 1
        usable = np.asarray(Image.fromarray(near).filter(ImageFilter.MaxFilter(size))) == 0
        return cls(camera, view.pixels, usable, view.mask)

    def colours(self, places: np.ndarray, infinite: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """(D, 3) float32, 0 to 1, at places (D, 3) in the world, or in directions of infinite ones; NaN where
        the photo does not show them; and (D,) bool: shown, with nothing near."""
        found, free = np.full(places.shape, np.nan, np.float32), np.zeros(len(places), np.bool_)
        local = places @ self.camera.R_camera_world.T
        inside, x, y = placed(self.camera, local if infinite else local + self.camera.t_camera_world)
        if self.masked is not None:
            use = self.masked[y, x]
            inside, x, y = inside[use], x[use], y[use]
        found[inside] = self.pixels[y, x] / np.float32(255)
        free[inside] = self.usable[y, x]
        return found, free


def free_colours(
    looks: Sequence[Look], places: np.ndarray, infinite: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """(P, D, 3) float32 colours that photos have at places, NaN where something is near, and (P, D) bool: the
    photos that show them, something near or not."""
    found = [look.colours(places, infinite) for look in looks]
    colours = np.stack([np.where(free[:, None], own, np.float32(np.nan)) for own, free in found])
    return colours, np.stack([np.isfinite(own[:, 0]) for own, _ in found])


@dataclass(frozen=True, eq=False)
class FarCells:
    """Directions, and which of them are far."""

    directions: np.ndarray
    """(D, 3) unit."""
    far: np.ndarray
    """(D,) bool: photos from places apart have one colour there, without a point near, above the horizon."""
    colours: np.ndarray
    """(D, 3) float32, 0 to 1: median of the photos that have no point near; NaN where there are none."""
    share: float
    """Share of the photos' area that is far."""

    @classmethod
    def of(
        cls,
        looks: Sequence[Look],
        directions: np.ndarray,
        up: np.ndarray,
        extent: float,
        background: Sequence[float],
    ) -> FarCells:
        colours, seen = free_colours(looks, directions)
        median, deviations = agreement(colours)
        with np.errstate(invalid="ignore"):
            agree = deviations <= TOLERANCE
            coloured = np.abs(median - np.asarray(background)).max(axis=1) > DARKEST
        free, count = (np.count_nonzero(which, axis=0) for which in (np.isfinite(deviations), agree))
        eyes = np.array([look.camera.eye for look in looks])
        low, high = np.full(directions.shape, np.inf), np.full(directions.shape, -np.inf)
        for eye, which in zip(eyes, agree, strict=True):
            low[which], high[which] = np.minimum(low[which], eye), np.maximum(high[which], eye)
        apart = (high - low).max(axis=1)
        far = (count >= 2) & (count >= AGREEING * free) & (apart >= APART * extent) & coloured
        far &= directions @ up > math.sin(LOWEST)
        share = np.count_nonzero(agree & far) / max(np.count_nonzero(seen), 1)
        return cls(directions, far, median, float(share))

    def has_sky_colours(self, looks: Sequence[Look]) -> bool:
        """Whether what is far is brighter than most of what photos show, and blue rather than warm."""
        if not self.far.any():
            return False
        colours = self.colours[self.far]
        photos = np.concatenate([look.pixels.max(axis=2).ravel() for look in looks]) / 255
        # Half of what is far itself is darker than its median.
        darker = float(np.mean(photos < np.median(colours.max(axis=1)))) - self.share / 2
        blue = float(np.mean(colours[:, 2] - colours[:, 0]))
        return blue >= LEAST_BLUE and darker >= LEAST_BRIGHT * (1 - self.share)

    def grown(self, looks: Sequence[Look], up: np.ndarray) -> FarCells:
        """The same with cells that one photo alone shows without a point near, or that photos differ about,
        where most cells around are far: where there is a sky at all they are likely to be, too."""
        colours, _ = free_colours(looks, self.directions)
        free = np.count_nonzero(np.isfinite(colours[..., 0]), axis=0)
        usable, far = (free > 0) & (self.directions @ up > math.sin(LOWEST)), self.far.copy()
        around = neighbours(self.directions, AROUND)
        for _ in range(ROUNDS):
            share = far[around].mean(axis=1)
            far |= usable & (share >= np.where(free == 1, LEAST_AROUND_ONE, LEAST_AROUND))
        return replace(self, far=far)

    def left(self, looks: Sequence[Look], points: np.ndarray) -> float:
        """How much photos differ at infinity, where they are far, relative to how much they do at the nearer
        distance that suits them best: well below 1 for a sky, 1 and more for plain walls."""
        centre = np.mean([look.camera.eye for look in looks], axis=0)
        directions = self.directions[self.far]
        at_infinity, largest = differences(free_colours(looks, directions)[0]), 0.0
        depth = float(np.median(np.linalg.norm(points - centre, axis=1)))
        for factor in NEARER:
            nearer = differences(free_colours(looks, centre + factor * depth * directions, infinite=False)[0])
            both = np.isfinite(nearer) & np.isfinite(at_infinity)
            if np.count_nonzero(both) >= LEAST_COMPARED:
                largest = max(largest, float(at_infinity[both].sum() / max(nearer[both].sum(), 1e-9)))
        return largest or math.inf


def differences(colours: np.ndarray) -> np.ndarray:
    """(D,) float32: median difference of photos' colours (P, D, 3) from their median; NaN where fewer than
    three have any."""
    _, deviations = agreement(colours)
    count = np.count_nonzero(np.isfinite(deviations), axis=0)
    ordered = np.sort(deviations, axis=0)
    middle = np.take_along_axis(ordered, np.maximum(count - 1, 0)[None] // 2, axis=0)[0]
    return np.where(count >= 3, middle, np.float32(np.nan))


def agreement(colours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median colours (D, 3) of photos' colours (P, D, 3), NaN where none has any, and (P, D) float32: the
    largest difference of a photo's channels from them."""
    count = np.count_nonzero(np.isfinite(colours[..., 0]), axis=0)
    ordered = np.sort(colours, axis=0)  # NaN come last
    middle = np.maximum(count - 1, 0)
    at = np.stack([middle // 2, (middle + 1) // 2])[..., None]
    low, high = np.take_along_axis(ordered, at, axis=0)
    median = (low + high) / 2
    return median, np.abs(colours - median).max(axis=2)


def placed(camera: Camera, local: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Indices of the rows of local (N, 3), in camera coordinates, that are in the picture, and the columns
    and rows of their pixels."""
    ahead = np.flatnonzero(local[:, 2] > 1e-6)
    x, y = camera.image_points(local[ahead]).T
    with np.errstate(invalid="ignore"):
        inside = (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return ahead[inside], x[inside].astype(np.int64), y[inside].astype(np.int64)


def reach_of(points: np.ndarray, looks: Sequence[Look]) -> float:
    """Distance of nearly all points from the cameras' mean, world units."""
    centre = np.mean([look.camera.eye for look in looks], axis=0)
    distances = np.linalg.norm(points - centre, axis=1)
    distances = distances[np.isfinite(distances)]
    return float(np.quantile(distances, REACH)) if len(distances) else 0.0


def shells(
    found: FarCells,
    views: Sequence[TrainView],
    points: np.ndarray,
    up: np.ndarray,
    extent: float,
    radius: float,
    most: int,
    coarse: np.ndarray,
) -> tuple[Parameters, int]:
    """Splats of the fine shell, `most` or so at most, and of the coarse one, of `coarse` (C, 3) directions of
    a whole sphere; and how many the fine one has."""
    centre = np.mean([view.camera.eye for view in views], axis=0)
    heights = found.directions[found.far] @ up
    lowest = min(float(np.quantile(heights, 0.02)), 0.0)
    apart = spacing_of(len(coarse))
    coarse = coarse[coarse @ up > lowest - apart]
    share = np.count_nonzero(found.far) / len(found.far)
    finest = FINEST / float(np.median([view.camera.fx for view in views]))
    count = int(min(most / max(share, 1e-6), 4 * math.pi / finest**2))
    fine, colours = np.empty((0, 3)), np.empty((0, 3), np.float32)
    if count >= LEAST_FINE:
        fine = sphere(count)
        fine = fine[found.far[nearest(found.directions, fine)]]
        looks = [Look.of(view, points, spacing_of(count), FAR_EXTENTS * extent) for view in views]
        colours, _ = agreement(free_colours(looks, fine)[0])
        known = np.isfinite(colours[:, 0])
        fine, colours = fine[known], colours[known]
    filled = spread(found.directions[found.far], found.colours[found.far], coarse, up)
    means = np.concatenate([radius * fine, BEHIND * radius * coarse]) + centre
    sizes = np.concatenate(
        [
            np.full(len(fine), SIGMA * radius * spacing_of(max(count, 1))),
            np.full(len(coarse), COARSE_SIGMA * BEHIND * radius * apart),
        ]
    )
    rgb, total = np.concatenate([colours, filled]), len(means)
    quats = np.zeros((total, 4), np.float32)
    quats[:, 0] = 1
    return Parameters(
        means=means.astype(np.float32),
        quats=quats,
        log_scales=np.repeat(np.log(sizes).astype(np.float32)[:, None], 3, axis=1),
        opacity_logits=np.full(total, math.log(OPACITY / (1 - OPACITY)), np.float32),
        sh=((rgb.astype(np.float32) - np.float32(0.5)) / np.float32(SH_C0))[:, None, :].copy(),
    ), len(fine)


def neighbours(directions: np.ndarray, count: int) -> np.ndarray:
    """(D, count) int32: the nearest others of each of directions (D, 3)."""
    return kdtree.nearest(directions, count)[0]


def nearest(known: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(D,) int64: which of the known directions (K, 3), of a whole sphere, is nearest to each of directions
    (D, 3)."""
    found, block = np.zeros(len(directions), np.int64), spacing_of(len(known))
    # In bands of heights: all that is nearer than a cell is in the own band or the next ones.
    band = np.floor(known[:, 2] / (2 * block)), np.floor(directions[:, 2] / (2 * block))
    for height in np.unique(band[1]):
        own, near = np.flatnonzero(band[1] == height), np.flatnonzero(np.abs(band[0] - height) <= 1)
        found[own] = near[(directions[own] @ known[near].T).argmax(axis=1)]
    return found


FILL_POWER, HEIGHTS, FILL_SPACING = 6, 8.0, 0.056
"""Of `spread`: power of the distance, weight of the square of a difference in height, and twice the distance,
in radians, below which all are as near. In 221 directions
that no photo of `demo sky 40` shows colours are wrong by 0.092 with 4 and 0, by 0.081 so (chosen); in 262 of
`biker sky 30` by 0.105 and 0.098 (judged). Black is wrong by 0.66 and 0.31. Dropped: a line by height
and differences from it spread so, 0.067 and 0.153."""


def spread(known: np.ndarray, colours: np.ndarray, directions: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(D, 3) colours of directions (D, 3) from those of known ones (K, 3): means weighted by a power of the
    distance (Shepard 1968), in which a height above the horizon counts more than a turn about `up`."""
    filled, least = np.empty((len(directions), 3), np.float32), FILL_SPACING**2 / 4
    for start in range(0, len(directions), 256):
        part = directions[start : start + 256]
        heights = (part @ up)[:, None] - known @ up
        squares = np.maximum(2 - 2 * part @ known.T + HEIGHTS * heights**2, least)
        weights = (least / squares) ** (FILL_POWER / 2)
        filled[start : start + 256] = (weights @ colours) / weights.sum(axis=1, keepdims=True)
    return filled
