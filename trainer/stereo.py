"""Points on what the photos show, by our own stereo: a plane sweep for each photo, and what others confirm.

For each photo planes before it are tried from far to near: where the photo and its neighbours look alike when
the neighbours are seen through the plane (normalised cross-correlation of windows), there is a surface. What
others find at the same place is kept. Sources: Collins 1996 (plane sweep), Goesele et al. 2006 (windows, the
best of several views, confirmation by others); the idea of a dense start: EDGS (Kotovenko et al. 2026).

Chosen on `playbot RGBA 100` of the bench, which has no points (66 photos to train on, a minute, split 0):
random points score 33.35 dB on photos held out; those that one other photo confirms, beside the random ones,
34.76; by two others and alone 36.10. Judged on `skull RGBA 100`: 28.95 and 30.52 dB. Where a capture has
points enough of its own, more of them do not help: 21.49 and 21.33 dB on `miku 12 far`, 25.57 and 25.54 on
`miku 20 near`, 28.76 and 28.48 on `banana` (7,427 points) at half the size, 19.56 and 18.62 after three
minutes of `statue`. See `PIXELS_PER_POINT` for few.

Dropped: agreement of depths through training, 0.3 and 1 times the mean |d/s - 1| (at most 0.2) of the scene's
depth d and that s of the pixels that two other photos confirm. A minute each, the second picture of a step
free of charge: 24.02 dB without, 23.89 and 23.20 on `miku 12 far`; 27.25 and 27.17 on `banana`, 22.04 and
21.88 on `miku 20 far`, 29.60 and 29.82 on `miku 12 near`. Dropped, too: smooth inverse depth where photos are
smooth, by a weight of 0.01, -0.28 and -0.02 dB on `miku 12 far` and `near` (two splits each), or from places
between the photos, -0.61 and +0.13; by 0.1 -1.82 on one. Dropped, too: what a camera a little aside (up to a
twentieth of the depth) sees, warped to the photo by its depth and compared to it, by 0.2 from 0.3 of the run
on, for three times the time of a step: 22.4 and 19.2 dB on two splits of `miku 12 far`, 29.6 and 26.6 on
`near`, where three seeds without have 22.1, 19.2, 29.5 and 26.6.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from splatview.scene import Camera
from splatview.scene.captures.resample import undistorted
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.trainer import stereo_kernels as kernels
from splatview.trainer.views import TrainView

PIXELS = 60_000
"""Of a photo as it is matched, about."""

PIXELS_PER_POINT = 50
"""Pixels of a photo, as it is matched, for each point of the capture, beyond which its points are few:
splats begin where stereo finds surfaces, too. One run each with a third held out, half the bench's size,
of a choice of the points by chance, without and with stereo. Chosen: `banana` with 50 points 26.75 and
28.34 dB, with 300 27.64 and 28.54, with 1,000 28.30 and 28.47. Judged: `miku 12 near` with 50 27.40 and
28.98, with 300 28.23 and 28.74 (at the photos' exposures), `biker front 24` with 50 42.42 and 42.67,
`miku` with 1,000 29.61 and 29.71."""

PLANES = 96
"""Inverse depths that are tried."""

BAND = 4.0
"""Ratio of the depths that one sweep looks between at most, where no point tells how far away things are.
Each has neighbours at good angles, and the best match is taken."""

LEAST_OF_A_BAND, OUTERMOST = 0.002, 0.002
"""Of the points that a photo shows, by a first look: for how many of them depths are looked at closely, and
how many at both ends of all depths are taken for chance. What is behind an object has little texture, and few
photos that show it: with 0.02 and 0.01 there was nothing behind the table of `stitch`, 17.54 dB in place of
24.58. Where places of depths are known, more depths take next to no time."""

NEAREST_OF_PITCH = 1.4
"""Nearest depth of that look, in distances of a camera to the next one: nearer things are seen at angles of
more than MOST_ANGLE."""

CELLS = 24
"""Pieces of a photo, each way. In each, and in those about it, depths are looked at closely that the first
look has found there; where it has found none, those of the nearest pieces where it has."""

KNOWN_OUTERMOST = 0.01
"""Of points that are given, at both ends of their depths, that are left out of one sweep between these."""

LEAST_SURVEYED = 500
"""Points that such a look must find to go by."""

SOURCES = 4
"""Neighbours that a photo is matched with, at most."""

MOST_PHOTOS = 40
"""Photos that depths are found for; of more, an even choice. Dropped: all 66 of `gum` and 64 of `games`. Then
points are in 87 and 97 % of the pieces of held-out photos in place of 79 and 92 %, for 1.6 times the time,
but a minute has 25.36 and 26.65 dB in place of 25.37 and 26.60."""

BEST_ANGLE, NARROW, WIDE = 12.0, 6.0, 14.0
"""Degrees between the rays of two photos: where windows still look alike and depths are already known well;
the spread of their worth below and above."""

LEAST_ANGLE, MOST_ANGLE = 1.0, 40.0

LEAST_SCORE = 0.6
"""Correlation of a window that is a match."""

TOLERANCE = 0.012
"""Relative difference of depths that agree."""

WITNESSES = 2
"""Other photos that agree about a point."""

OPAQUE = 250
"""Of 255: what is fainter shows what is behind."""

NEARER, FARTHER = 0.8, 1.3
"""Factors of the nearest and farthest depths of known points: surfaces may lie beyond them."""

LEAST_SUPPORT, POINTS_A_CUBE = 3, 8
"""Points in a cube of space that is a surface and no chance match, where cubes hold so many on average."""

MOST_CUBES = 1 << 20
"""Along the longest side of the points' box."""


@dataclass(frozen=True, eq=False)
class _Matched:
    """A photo as it is matched."""

    camera: Camera
    colours: np.ndarray
    """(H, W, 3) uint8."""
    textured: np.ndarray
    """(H, W) bool, windows that can be matched."""
    grey: np.ndarray
    """Whole levels from 0 to 255, less `stereo_kernels.MIDDLE`; this and the next two are `padded`."""
    sums: np.ndarray
    """Over windows."""
    deviation: np.ndarray
    """49 times that of windows; 0 where nothing can be matched."""
    pieces: np.ndarray
    """(H - 1, W - 1) uint32, see `stereo_kernels.pieces_of`."""
    spans: np.ndarray
    """(2, H, 2) int32, where something can, see `stereo_kernels.spans_of`."""


class _How(NamedTuple):
    """How closely photos are matched."""

    pixels: int
    """Of a photo, about."""
    tolerance: float
    band: int | None = None
    """Planes of a sweep between depths whose ratio is BAND; None: one sweep of PLANES."""
    sources: int = SOURCES


SURVEY, CLOSELY = _How(PIXELS // 4, 0.03, 32), _How(PIXELS // 2, 0.015, 46)
"""A first look at all depths, and one at those where it has found something. In fewer pixels a step from
plane to plane moves what is seen by less, so that fewer planes do. With 2 neighbours in the first look, in
place of 4, `terrace` has 17.00 and 16.87 dB by two seeds in place of 17.42. Dropped for their time: PIXELS in
the second (17.41; 16.91 by 2 neighbours in the first), and 64 planes, too (17.54, 16.96; stereo_depths.json,
in which stereo costs nothing)."""


def stereo_points(
    views: Sequence[TrainView],
    known: np.ndarray | None,
    *,
    threads: int = 2,
    progress: Progress = NO_PROGRESS,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float64 and their colours (P, 3) uint8, on surfaces that photos agree about; there may be
    none. For equal arguments they are equal, whatever the threads.

    `known`: (K, 3) points, random ones perhaps, between whose depths surfaces are looked for; None: at all
    depths that cameras so far apart can tell, first in small photos, and then about what these have shown.
    Photos are taken out of their lenses, and matched with those of their own size. Raises Cancelled.
    """
    usable = [view for view in views if not view.camera.orthographic]
    if len(usable) > MOST_PHOTOS:
        usable = [usable[i] for i in np.linspace(0, len(usable) - 1, MOST_PHOTOS).round().astype(int)]
    with ThreadPoolExecutor(max(threads, 1)) as pool:
        if known is None:
            found = _agreed(usable, None, SURVEY, pool, progress.part(0.0, 0.3))
            if len(found[0]) < LEAST_SURVEYED:
                progress.step(1.0)
                return found
            return _agreed(usable, found[0], CLOSELY, pool, progress.part(0.3, 1.0))
        return _agreed(usable, known, _How(PIXELS, TOLERANCE), pool, progress)


def _agreed(
    views: Sequence[TrainView],
    known: np.ndarray | None,
    how: _How,
    pool: ThreadPoolExecutor,
    progress: Progress,
) -> tuple[np.ndarray, np.ndarray]:
    """Points and colours as of `stereo_points`."""
    photos = list(pool.map(lambda view: _matched(view, how.pixels), views))
    widest = _widest_depths(photos) if known is None else np.empty(0)
    outermost = KNOWN_OUTERMOST if how.band is None else OUTERMOST

    def swept(at: int) -> tuple[np.ndarray, np.ndarray]:
        progress.check()
        return _swept(
            at, photos, widest if known is None else _seen(photos[at].camera, known, outermost), how
        )

    depths = []
    for found in pool.map(swept, range(len(photos))):
        depths.append(found)
        progress.step(len(depths) / len(photos))
    confirmed = list(pool.map(lambda at: _confirmed(at, photos, depths, how.tolerance), range(len(photos))))
    places = np.concatenate([np.empty((0, 3)), *(own for own, _ in confirmed)])
    return places, np.concatenate([np.empty((0, 3), np.uint8), *(colours for _, colours in confirmed)])


def _widest_depths(photos: Sequence[_Matched]) -> np.ndarray:
    """(D,) from the nearest to the farthest depth that cameras so far apart can tell, evenly by their
    logarithms; none where they stand together."""
    eyes = np.array([photo.camera.eye for photo in photos])
    if len(eyes) < 2:
        return np.empty(0)
    apart = np.linalg.norm(eyes[:, None] - eyes[None], axis=2)
    farthest = float(apart.max()) / np.tan(np.radians(LEAST_ANGLE))
    np.fill_diagonal(apart, np.inf)
    nearest = NEAREST_OF_PITCH * float(np.median(apart.min(axis=1)))
    return np.geomspace(nearest, farthest, PLANES) if 0 < nearest < farthest else np.empty(0)


def _matched(view: TrainView, pixels: int) -> _Matched:
    view = view.smaller(max(1, round(np.sqrt(view.camera.width * view.camera.height / pixels))))
    camera, colours = view.camera, view.pixels
    usable = np.ones(colours.shape[:2], bool) if view.mask is None else view.mask.copy()
    if view.alpha is not None:
        usable &= view.alpha > OPAQUE
    if camera.lens is not None:
        marked = np.concatenate([colours, np.where(usable, 255, 0)[..., None].astype(np.uint8)], axis=2)
        marked, valid = undistorted(marked, camera)
        colours, usable = marked[..., :3], valid & (marked[..., 3] == 255)
        camera = replace(camera, lens=None)
    levels = np.rint(colours.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32))
    grey, count = levels - kernels.MIDDLE, (2 * kernels.RADIUS + 1) ** 2
    sums, squares = (np.empty(grey.shape) for _ in range(2))
    kernels.window_sums(grey, np.zeros(grey.shape[1]), sums)
    kernels.window_sums(grey * grey, np.zeros(grey.shape[1]), squares)
    spread = count * squares - sums * sums  # NaN at the rim
    textured = usable & (spread > kernels.LEAST_VARIANCE * count**2)
    deviation = np.sqrt(np.where(textured, spread, 0))
    return _Matched(
        camera=camera,
        colours=colours,
        textured=textured,
        grey=kernels.padded(grey),
        sums=kernels.padded(sums),
        deviation=kernels.padded(deviation),
        pieces=kernels.pieces_of(levels),
        spans=kernels.spans_of(textured),
    )


def _swept(at: int, photos: Sequence[_Matched], seen: np.ndarray, how: _How) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) float32 inverse depths of a photo between the least and the greatest that is `seen`, (S,) depths
    or (S, 3) with places in the photo, px, and how well they match, -1 where nothing does. By several sweeps
    those with next to none are left out, and places far from where such depths are seen."""
    photo = photos[at]
    found, confidence = (
        np.zeros(photo.textured.shape, np.float32),
        np.full(photo.textured.shape, -1, np.float32),
    )
    z = seen if seen.ndim == 1 else seen[:, 0]
    near, far = (float(z.min()), float(z.max())) if len(z) else (0.0, 0.0)
    if not 0 < near < far < np.inf:
        return found, confidence
    if how.band is None:
        return _swept_band(at, photos, np.linspace(1 / far, 1 / near, PLANES), how.sources, photo.spans)
    count = max(1, int(np.ceil(np.log(far / near) / np.log(BAND))))
    edges = near * (far / near) ** (np.arange(count + 1) / count)
    pieces = None if seen.ndim == 1 else _pieces(seen, edges, photo.textured.shape)
    for number, (nearest, farthest) in enumerate(pairwise(edges)):
        if ((z >= nearest) & (z <= farthest)).sum() < LEAST_OF_A_BAND * len(z):
            continue
        spans = photo.spans
        if pieces is not None:
            rows, columns = (np.arange(size) * CELLS // size for size in photo.textured.shape)
            spans = kernels.spans_of(photo.textured & pieces[number][np.ix_(rows, columns)])
        planes = 3 + int(np.ceil(how.band * (1 - nearest / farthest) / (1 - 1 / BAND)))
        # What matches best on the first or last plane is no match: two more, which sweeps share.
        step = (1 / nearest - 1 / farthest) / (planes - 3)
        least = 1 / farthest - min(step, 0.5 / farthest)
        band = np.linspace(least, 1 / nearest + step, planes)
        inverse_depth, score = _swept_band(at, photos, band, how.sources, spans)
        better = score > confidence
        found[better], confidence[better] = inverse_depth[better], score[better]
    return found, confidence


def _pieces(seen: np.ndarray, edges: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(B, CELLS, CELLS) bool: where in a photo (H, W) depths between two of the `edges`, (B + 1,), are looked
    for, by what is `seen`, (S, 3): depths, and places in px."""
    z, u, v = seen.T
    cells = (v * CELLS / shape[0]).astype(int) * CELLS + (u * CELLS / shape[1]).astype(int)
    found = np.zeros((len(edges) - 1, CELLS, CELLS), np.bool_)
    for number, (nearest, farthest) in enumerate(pairwise(edges)):
        within = cells[(z >= NEARER * nearest) & (z <= FARTHER * farthest)]
        found[number].flat[np.unique(within)] = True
    found = _grown(found)
    while not (known := found.any(axis=0)).all() and known.any():
        found |= _grown(found) & ~known
    return found


def _grown(cells: np.ndarray) -> np.ndarray:
    """(B, R, C) bool: cells, and those beside them."""
    padded = np.pad(cells, ((0, 0), (1, 1), (1, 1)))
    rows = padded[:, :-2] | padded[:, 1:-1] | padded[:, 2:]
    return rows[..., :-2] | rows[..., 1:-1] | rows[..., 2:]


def _swept_band(
    at: int, photos: Sequence[_Matched], inverse_depths: np.ndarray, most: int, spans: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same by planes at these inverse depths, (D,), rising evenly, and `most` so many neighbours, in
    `spans` of windows, as of `stereo_kernels.spans_of`."""
    photo = photos[at]
    height, width = photo.textured.shape
    room = height * width + kernels.LANES
    found, confidence = np.zeros(room, np.float32), np.full(room, -1, np.float32)
    middle = photo.camera.eye + photo.camera.forward * (2 / (inverse_depths[0] + inverse_depths[-1]))
    sources = _neighbours(at, photos, middle, most)
    if sources:
        pieces = np.stack([photos[j].pieces for j in sources])
        rotations, offsets = _through(photo.camera, [photos[j].camera for j in sources])
        scores = np.empty(len(inverse_depths) * height * width + kernels.LANES, np.float32)
        warped, second = (np.empty(room, np.float32) for _ in range(2))
        columns, shown = np.empty((3, width + kernels.LANES), np.float32), np.empty((height, 2), np.int32)
        for number, inverse_depth in enumerate(inverse_depths):
            kernels.plane_scores(
                *(photo.grey, photo.sums, photo.deviation, width, spans, pieces, rotations, offsets),
                *(float(inverse_depth), warped, second, columns, shown, scores[number * height * width :]),
            )
        kernels.best_planes(scores, inverse_depths.astype(np.float32), width, spans, found, confidence)
    found, confidence = (flat[: -kernels.LANES].reshape(height, width) for flat in (found, confidence))
    return found, confidence


def _seen(camera: Camera, points: np.ndarray, outermost: float) -> np.ndarray:
    """(S, 3): depth and place, px, of the points that a photo shows but for a share at both ends; the nearest
    and farthest depths with room on both sides, in its middle; none where it shows next to none."""
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    z = local[:, 2]
    with np.errstate(all="ignore"):
        u, v = camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy
        seen = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
    if np.count_nonzero(seen) < 8:
        return np.empty((0, 3))
    near, far = np.quantile(z[seen], [outermost, 1 - outermost])
    within = seen & (z >= near) & (z <= far)
    rim = [[depth, camera.width / 2, camera.height / 2] for depth in (NEARER * near, FARTHER * far)]
    return np.concatenate([np.stack([z, u, v], axis=1)[within], rim])


def _neighbours(at: int, photos: Sequence[_Matched], middle: np.ndarray, most: int) -> list[int]:
    """Photos of the same size that see `middle` (3,) at good angles, the best first, `most` at most."""
    own = photos[at]
    ray, worth = own.camera.eye - middle, []
    for other, photo in enumerate(photos):
        if other == at or photo.textured.shape != own.textured.shape:
            continue
        if not photo.camera.forward @ own.camera.forward > 0.5:
            continue
        theirs = photo.camera.eye - middle
        lengths = max(float(np.linalg.norm(ray) * np.linalg.norm(theirs)), 1e-12)
        angle = np.degrees(np.arccos(np.clip(float(ray @ theirs) / lengths, -1, 1)))
        if LEAST_ANGLE < angle < MOST_ANGLE:
            width = NARROW if angle < BEST_ANGLE else WIDE
            worth.append((-float(np.exp(-(((angle - BEST_ANGLE) / width) ** 2))), other))
    return [other for _, other in sorted(worth)[:most]]


def _through(camera: Camera, others: Sequence[Camera]) -> tuple[np.ndarray, np.ndarray]:
    """(S, 3, 3) and (S, 3): the pixel (u, v) of `camera` at inverse depth d is seen by each of `others` at
    rotation @ (u, v, 1) + d * offset, up to the third component, which is their depth times d."""
    back, inner = np.linalg.inv(_intrinsics(camera)), np.stack([_intrinsics(other) for other in others])
    ways = np.stack([other.world_to_camera for other in others]) @ np.linalg.inv(camera.world_to_camera)
    return inner @ ways[:, :3, :3] @ back, (inner @ ways[:, :3, 3:])[..., 0]


def _intrinsics(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def _confirmed(
    at: int, photos: Sequence[_Matched], depths: Sequence[tuple[np.ndarray, np.ndarray]], tolerance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Places and colours of a photo's pixels whose depth others share, be they its neighbours or not."""
    photo, (inverse_depth, confidence) = photos[at], depths[at]
    others = [j for j in range(len(photos)) if j != at and photos[j].textured.shape == photo.textured.shape]
    if not others:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    counts = np.empty(photo.textured.shape, np.int32)
    kernels.agreeing(
        *(inverse_depth, confidence, LEAST_SCORE),
        *(np.stack([depths[j][part] for j in others]) for part in (0, 1)),
        *_through(photo.camera, [photos[j].camera for j in others]),
        *(tolerance, counts),
    )
    rows, columns = np.nonzero(counts >= WITNESSES)
    camera = photo.camera
    u, v = (columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy
    local = np.stack([u, v, np.ones(len(u))], axis=1) / inverse_depth[rows, columns][:, None]
    matrix = np.linalg.inv(camera.world_to_camera)
    return local @ matrix[:3, :3].T + matrix[:3, 3], photo.colours[rows, columns]


def thinned(
    points: np.ndarray,
    colours: np.ndarray,
    count: int,
    seed: int = 0,
    *,
    places: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """At most `count` of points (P, 3) and their colours, evenly over space: one of each cube of a grid, by
    `places` (P, 3) where these are others.

    Points that lie alone are left out, see LEAST_SUPPORT.
    """
    order = np.random.default_rng(seed).permutation(len(points))
    places = points if places is None else places
    _, inverse, sizes = np.unique(
        _cells(places, len(places) // POINTS_A_CUBE), return_inverse=True, return_counts=True
    )
    order = order[sizes[inverse[order]] >= LEAST_SUPPORT]
    _, first = np.unique(_cells(places[order], count), return_index=True)
    kept = order[first]
    return points[kept], colours[kept]


def contracted(points: np.ndarray, middle: np.ndarray, unit: float) -> np.ndarray:
    """Points (P, 3) about `middle`, (3,), of which those beyond `unit` are drawn in, within twice as far, as
    by Barron et al. 2022: pieces of equal size look alike from amidst."""
    away = points - middle
    distances = np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12)
    return away * np.where(distances > unit, (2 - unit / distances) * unit / distances, 1.0)


def _cells(points: np.ndarray, count: int) -> np.ndarray:
    """(P,) int64: which cube of a grid each point is in, of cubes so large that at most `count` hold any."""
    if not len(points):
        return np.empty(0, np.int64)
    low, high = points.min(axis=0), points.max(axis=0)
    longest = max(float((high - low).max()), 1e-12)
    # Cubes along the longest side, each number some 9 % more than the one before.
    steps = np.unique(np.round(MOST_CUBES ** np.linspace(0, 1, 161)).astype(np.int64))
    coarse, fine, found = 0, len(steps), np.zeros(len(points), np.int64)
    while fine - coarse > 1:
        middle = (coarse + fine) // 2
        places = np.minimum((points - low) * (steps[middle] / longest), steps[middle] - 1).astype(np.int64)
        keys = (places[:, 0] * MOST_CUBES + places[:, 1]) * MOST_CUBES + places[:, 2]
        if len(np.unique(keys)) > count:
            fine = middle
        else:
            coarse, found = middle, keys
    return found
