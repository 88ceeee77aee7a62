"""A first view of a scene that nobody has looked at: where it is, how large, and which way is up."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splatview.scene.background import WORLD_UP
from splatview.scene.camera import Camera, look_at, orbited
from splatview.scene.gaussians import Gaussians
from splatview.scene.image_model import NEAR
from splatview.scene.projection import FLOAT32_MAX

VIEW_OFFSET = (0.4, -0.4, -1.0)
"""From the scene to the eye: in front (photos look along +z), a little above and beside."""

OUTLIERS = 5.0
"""Percent of the splats left out at either end of each axis: trained scenes have floaters far away."""

SAMPLE = 200_000
"""Splats looked at; their percentiles differ from those of all by less than a picture shows."""

SPLAT_SIGMAS = 3.0
"""A scene is at least so many standard deviations of its median splat large: a lone splat fills the view."""


def frame_camera(gaussians: Gaussians, width: int, height: int, *, fov_y: float = 50.0) -> Camera:
    """A camera that has the bulk of the scene in view, with -y up. `fov_y` in degrees, 0 to 180.

    Works for any scene, none or invalid splats included: see `bulk`.
    """
    centre, radius = bulk(gaussians)
    tan_y = math.tan(math.radians(fov_y) / 2)
    narrower = math.atan(min(tan_y, tan_y * width / height))
    # Scenes of millimetres must not vanish before the near plane, nor eye and target become one number.
    distance = max(radius / math.sin(narrower), radius + 2 * NEAR, 1e-9 * float(np.abs(centre).max()))
    offset = np.array(VIEW_OFFSET) / np.linalg.norm(VIEW_OFFSET)
    return look_at(centre + offset * distance, centre, up=WORLD_UP, fov_y=fov_y, width=width, height=height)


def pivot(camera: Camera, centre: np.ndarray) -> np.ndarray:
    """(3,): the point of the camera's viewing axis that is nearest to `centre` (3,); a unit ahead where that
    is behind it."""
    depth = float((centre - camera.eye) @ camera.forward)
    return camera.eye + camera.forward * (depth if depth > 0 else 1.0)


AROUND = (90.0, 180.0, 270.0)
"""Degrees from a view to others of the same scene."""


def views_around(camera: Camera, gaussians: Gaussians) -> list[Camera]:
    """The camera, and others from as far away on the other sides of what it looks at."""
    target = pivot(camera, robust_bounds(gaussians.means)[0])
    up = -camera.R_camera_world[1]
    return [camera, *(orbited(camera, target, up, degrees) for degrees in AROUND)]


def bulk(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """As `robust_bounds`, but not smaller than a splat of the scene is."""
    centre, radius = _bounds(gaussians.means)
    with np.errstate(over="ignore"):
        sizes = np.exp(gaussians.log_scales[:: _stride(len(gaussians))].max(axis=1, initial=-np.inf))
    sizes = sizes[(sizes > 0) & (sizes <= FLOAT32_MAX)]
    if len(sizes):
        radius = max(radius, SPLAT_SIGMAS * float(np.median(sizes)))
    return centre, radius or 1.0


def robust_bounds(means: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) float64 and radius > 0, in world units, of the bulk of `means` (N, 3).

    They belong to the box that leaves out OUTLIERS percent of the splats at either end of each axis; splats
    that are not finite do not count. The radius is 1 where no two splats are apart.
    """
    centre, radius = _bounds(means)
    return centre, radius or 1.0


SKY_GAP, IN_GAP, LEAST_SKY, ONE_SIDED = 3.5, 0.005, 0.01, 0.85
"""Of a shell of far splats: factor of the distance, share of the splats in between, least share of the splats
in it, and length of the mean direction to splats that are all on one side. See `sky_shell`."""

BOX_OUTLIERS, BOX_MARGIN = 0.1, 0.03
"""Of a box about nearly all splats: percent left out at either end of each axis, and share by which it is
wider there than the others."""


def robust_box(means: np.ndarray, most: float) -> tuple[np.ndarray, np.ndarray]:
    """Low and high corner (3,) float64, world units, of a box about nearly all of `means` (N, 3), no wider
    than all are, nor than `most` times as wide along an axis as all would be if spread as the middle ones."""
    least, low, first, last, high, greatest = _percentiles(
        means, (0, BOX_OUTLIERS, OUTLIERS, 100 - OUTLIERS, 100 - BOX_OUTLIERS, 100)
    )
    margin = BOX_MARGIN * (high - low)
    middle, half = (first + last) / 2, most * (last - first) / 2 * 100 / (100 - 2 * OUTLIERS)
    return (
        np.maximum(np.maximum(low - margin, middle - half), least),
        np.minimum(np.minimum(high + margin, middle + half), greatest),
    )


def _bounds(means: np.ndarray) -> tuple[np.ndarray, float]:
    """As `robust_bounds`, with a radius of 0 where no two splats are apart."""
    _, low, high, _ = _percentiles(means)
    return (low + high) / 2, float(np.linalg.norm(high - low) / 2)


def _percentiles(
    means: np.ndarray, shares: tuple[float, ...] = (0, OUTLIERS, 100 - OUTLIERS, 100)
) -> np.ndarray:
    """(len(shares), 3) float64: x, y, z that so many percent of the finite `means` (N, 3) are below; 0 for no
    means."""
    with np.errstate(invalid="ignore"):
        finite = means[(np.abs(means) <= FLOAT32_MAX).all(axis=1)]
    if not len(finite):
        return np.zeros((len(shares), 3))
    sample = without_sky(finite[:: _stride(len(finite))].astype(np.float64))
    return np.percentile(sample, shares, axis=0)


def without_sky(means: np.ndarray) -> np.ndarray:
    """`means` (N, 3), finite, but for those of a sky, see `sky_shell`."""
    shell = sky_shell(means)
    return means if shell is None else means[~shell.holds(means)]


def in_sky(means: np.ndarray) -> np.ndarray:
    """Which of `means` (N, 3), any values, are those of a sky, see `sky_shell`: (N,) bool."""
    with np.errstate(invalid="ignore", over="ignore"):
        finite = (np.abs(means) <= FLOAT32_MAX).all(axis=1)
        some = means[finite]
        shell = sky_shell(some[:: _stride(len(some))]) if len(some) else None
        return np.zeros(len(means), np.bool_) if shell is None else finite & shell.holds(means)


class Shell(NamedTuple):
    """What surrounds a scene from a distance on."""

    middle: np.ndarray
    """(3,) float64, world."""
    radius: float
    """Distance of its nearest splat from the middle, world units."""

    def holds(self, means: np.ndarray) -> np.ndarray:
        """Which of `means` (N, 3) belong to it: (N,) bool."""
        return np.linalg.norm(means - self.middle, axis=1) >= self.radius


def sky_shell(means: np.ndarray) -> Shell | None:
    """The shell of far splats around `means` (N, 3), finite, which is their sky; None where there is none.

    Between its nearest splat, and places SKY_GAP times nearer to the middle, is next to nothing; it holds at
    least LEAST_SKY of the splats and at most half, and is on more than one side: two objects far apart are
    none. Trained skies are ten times as far as the rest; the demo's, at three times, counts as scene.
    """
    middle = np.median(means.astype(np.float64), axis=0)
    offsets = means - middle
    with np.errstate(over="ignore"):
        distances = np.linalg.norm(offsets, axis=1)
    ordered, count = np.sort(distances), len(means)
    in_gap = np.arange(count) - np.searchsorted(ordered, ordered / SKY_GAP)
    found = np.flatnonzero((np.arange(count) >= count / 2) & (in_gap <= IN_GAP * count))
    if not len(found) or not count - found[0] >= LEAST_SKY * count:
        return None
    shell = Shell(middle, float(ordered[found[0]]))
    far = distances >= shell.radius
    with np.errstate(invalid="ignore", divide="ignore"):
        side = np.linalg.norm((offsets[far] / distances[far, None]).mean(axis=0))
    return shell if side < ONE_SIDED else None


def _stride(count: int) -> int:
    return max(1, count // SAMPLE)
