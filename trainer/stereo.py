"""Points on what the photos show, by our own stereo: a plane sweep for each photo, and what neighbours confirm.

For each photo planes before it are tried from near to far: where the photo and its neighbours look alike when
the neighbours are seen through the plane (normalised cross-correlation of windows), there is a surface. What
a second photo finds at the same place is kept. Sources: Collins 1996 (plane sweep), Goesele et al. 2006
(windows in the best of several views), Kotovenko et al. 2026 (EDGS: dense starts).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from splatview.scene import Camera
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.trainer import stereo_kernels as kernels
from splatview.trainer.views import TrainView

PIXELS = 60_000
"""Of a photo as it is matched, about."""

PLANES = 96
"""Inverse depths that are tried."""

SOURCES = 4
"""Neighbours of a photo at most."""

MOST_PHOTOS = 40
"""Photos that depths are found for; of more, an even choice."""

BEST_ANGLE, NARROW, WIDE = 12.0, 6.0, 14.0
"""Degrees between the rays of two photos: where windows still look alike and depths are already known well;
the spread of their worth below and above."""

FARTHEST_ANGLE = 40.0

LEAST_SCORE = 0.6
"""Correlation of a window that is a match."""

TOLERANCE = 0.012
"""Relative difference of depths that agree."""


@dataclass(eq=False)
class _Matched:
    """A photo as it is matched."""

    camera: Camera
    grey: np.ndarray
    """(H, W) float32, 0..255."""
    colours: np.ndarray
    """(H, W, 3) uint8."""
    usable: np.ndarray
    """(H, W) bool."""
    mean: np.ndarray
    deviation: np.ndarray
    """(H, W) float32 each, of windows; the deviation is 0 where nothing can be matched."""


def _matched(view: TrainView) -> _Matched:
    factor = max(1, round(np.sqrt(view.camera.width * view.camera.height / PIXELS)))
    view = view.smaller(factor)
    colours = view.pixels
    grey = (colours.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)).astype(np.float32)
    usable = np.ones(grey.shape, bool) if view.mask is None else view.mask.copy()
    if view.alpha is not None:
        usable &= view.alpha > 250
    mean, square = np.empty_like(grey), np.empty_like(grey)
    kernels.window_means(grey, np.zeros(grey.shape[1]), mean)
    kernels.window_means(grey * grey, np.zeros(grey.shape[1]), square)
    with np.errstate(invalid="ignore"):
        variance = square - mean * mean
        textured = usable & (variance > kernels.LEAST_VARIANCE)
        deviation = np.where(textured, np.sqrt(np.maximum(variance, 0)), 0).astype(np.float32)
    return _Matched(view.camera, grey, colours, usable, mean, deviation)


def _intrinsics(camera: Camera) -> np.ndarray:
    return np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])


def _through(camera: Camera, other: Camera) -> tuple[np.ndarray, np.ndarray]:
    """(3, 3) and (3,): pixel (u, v) of `camera` at inverse depth d is at rotation @ (u, v, 1) + d * offset of
    `other`, up to the third component."""
    motion = other.world_to_camera @ np.linalg.inv(camera.world_to_camera)
    inner = _intrinsics(other)
    return inner @ motion[:3, :3] @ np.linalg.inv(_intrinsics(camera)), inner @ motion[:3, 3]


def _depth_range(camera: Camera, points: np.ndarray, fallback: tuple[float, float]) -> tuple[float, float]:
    """Near and far depths of the points that a photo shows, with room on both sides."""
    if len(points):
        local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        z = local[:, 2]
        with np.errstate(all="ignore"):
            u, v = camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy
            seen = (z > 0) & (u >= 0) & (v >= 0) & (u < camera.width) & (v < camera.height)
        if np.count_nonzero(seen) >= 8:
            near, far = np.quantile(z[seen], [0.01, 0.99])
            return 0.8 * float(near), 1.3 * float(far)
    return fallback


def _neighbours(at: int, cameras: Sequence[Camera], middle: np.ndarray) -> list[int]:
    """The photos that see `middle` under good angles, the best first."""
    eye = cameras[at].eye
    worth = []
    for other, camera in enumerate(cameras):
        if other == at:
            continue
        a, b = eye - middle, camera.eye - middle
        cosine = float(a @ b / max(np.linalg.norm(a) * np.linalg.norm(b), 1e-12))
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        if 1.0 < angle < FARTHEST_ANGLE and float(cameras[at].forward @ camera.forward) > 0.5:
            width = NARROW if angle < BEST_ANGLE else WIDE
            worth.append((np.exp(-(((angle - BEST_ANGLE) / width) ** 2)), other))
    return [other for _, other in sorted(worth, reverse=True)[:SOURCES]]


def stereo_points(
    views: Sequence[TrainView],
    points: np.ndarray,
    *,
    centre: np.ndarray,
    radius: float,
    threads: int = 2,
    least_witnesses: int = 1,
    progress: Progress = NO_PROGRESS,
) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 3) float64 and their colours (P, 3) uint8, on surfaces that at least two photos agree about.

    `points`: those that are known already, which tell how far surfaces are; without them that is taken
    from a ball about `centre`. Photos through a lens are left out. Raises Cancelled.
    """
    usable = [view for view in views if view.camera.lens is None and not view.camera.orthographic]
    chosen = usable if len(usable) <= MOST_PHOTOS else [usable[i] for i in np.linspace(0, len(usable) - 1, MOST_PHOTOS).astype(int)]
    photos = [_matched(view) for view in chosen]
    cameras = [photo.camera for photo in photos]
    ranges, neighbours = [], []
    for at, camera in enumerate(cameras):
        away = float(np.linalg.norm(camera.eye - centre))
        near, far = _depth_range(camera, points, (max(away - radius, 0.1 * away), away + radius))
        ranges.append((near, far))
        middle = camera.eye + camera.forward * (2 / (1 / near + 1 / far))
        neighbours.append(_neighbours(at, cameras, middle))

    def swept(at: int) -> tuple[np.ndarray, np.ndarray]:
        photo, (near, far) = photos[at], ranges[at]
        shape = photo.grey.shape
        inverse_depths = np.linspace(1 / far, 1 / near, PLANES)
        found, confidence = np.zeros(shape, np.float32), np.full(shape, -1, np.float32)
        if neighbours[at]:
            # One array for all sources: those of another size are left out.
            same = [j for j in neighbours[at] if photos[j].grey.shape == photos[neighbours[at][0]].grey.shape]
            ways = [_through(photo.camera, photos[j].camera) for j in same]
            sources = np.stack([photos[j].grey for j in same])
            rotations, offsets = (np.stack(part) for part in zip(*ways, strict=True))
            scores = np.empty((PLANES, *shape), np.float32)
            warped, second, scratch = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty((3, shape[1]))
            for plane, inverse_depth in enumerate(inverse_depths):
                kernels.plane_scores(
                    *(photo.grey, photo.mean, photo.deviation, sources, rotations, offsets),
                    *(float(inverse_depth), warped, scratch, second, scores[plane]),
                )
            kernels.best_planes(scores, inverse_depths, found, confidence)
        progress.check()
        return found, confidence

    with ThreadPoolExecutor(max(threads, 1)) as pool:
        depths = list(pool.map(swept, range(len(photos))))
    places, colours = [], []
    for at, photo in enumerate(photos):
        inverse_depth, confidence = depths[at]
        # All photos that see about the same may confirm it, not only those it was found with.
        witnesses = [j for j in range(len(photos)) if j != at and photos[j].grey.shape == photo.grey.shape]
        if not witnesses:
            continue
        ways = [_through(photo.camera, photos[j].camera) for j in witnesses]
        rotations, offsets = (np.stack(part) for part in zip(*ways, strict=True))
        counts = np.empty(photo.grey.shape, np.int32)
        kernels.agreeing(
            *(inverse_depth, confidence, LEAST_SCORE),
            np.stack([depths[j][0] for j in witnesses]),
            np.stack([depths[j][1] for j in witnesses]),
            *(rotations, offsets, TOLERANCE, counts),
        )
        rows, columns = np.nonzero(counts >= least_witnesses)
        camera = photo.camera
        rays = np.stack(
            [(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))], axis=1
        )
        local = rays / inverse_depth[rows, columns][:, None]
        matrix = np.linalg.inv(camera.world_to_camera)
        places.append(local @ matrix[:3, :3].T + matrix[:3, 3])
        colours.append(photo.colours[rows, columns])
    if not places:
        return np.empty((0, 3)), np.empty((0, 3), np.uint8)
    return np.concatenate(places), np.concatenate(colours)


LEAST_SUPPORT = 3
"""Points in a cube that is a surface and no chance match."""


def thinned(points: np.ndarray, colours: np.ndarray, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """At most `count` of the points, evenly over space: one of each cube of a grid that has at least
    LEAST_SUPPORT of them."""
    if not len(points):
        return points, colours
    order = np.random.default_rng(seed).permutation(len(points))
    points, colours = points[order], colours[order]
    extent = np.quantile(points, 0.98, axis=0) - np.quantile(points, 0.02, axis=0)
    low, high, found = 1e-4, 1.0, np.empty(0, np.int64)
    for _ in range(20):
        middle = float(np.sqrt(low * high))
        cells = np.floor(points / (middle * float(extent.max()))).astype(np.int64)
        _, first, sizes = np.unique(cells, axis=0, return_index=True, return_counts=True)
        first = first[sizes >= LEAST_SUPPORT]
        if len(first) > count:
            low = middle
        else:
            high = middle
            if len(first) > len(found):
                found = first
    return points[found], colours[found]
