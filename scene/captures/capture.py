"""What a trainer learns from: photos with known cameras, and points on the surfaces that they show."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ..camera import Camera
from .evidence import PhotoEvidence

LensUse = Literal["undistort", "through"]
"""What is done about photos whose lens is no pinhole: their distortion is taken out when they are read, or
they stay as they are and are compared with pictures that are rendered through their lens."""

DEFAULT_LENS_USE: LensUse = "through"
"""By measurement (tests/benchmarks/bench_lens.py), as all of the photo is used and no pixel interpolated: as
good with a lens that bends little, some dB better with one that bends much, at all but equal times a step.
The exception are very wide pinhole views of a scene that a fisheye saw: undistorted photos are such views."""

EXTENT_MARGIN = 1.1
"""How far a scene reaches beyond its cameras, by Kerbl et al. 2023."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Pixels:
    """A photo as training compares it, at its final size."""

    image: np.ndarray
    """(H, W, 3) uint8, read-only."""
    mask: np.ndarray | None
    """(H, W) bool, read-only: which pixels show the scene; None where all do."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Photo:
    name: str
    """As the capture names it, sub-folders with forward slashes."""
    camera: Camera
    """Of the image's size: after downscaling, and a pinhole after undistortion. Its name is the photo's."""
    held_out: bool
    """Kept from training, to measure it by."""
    pixels: Callable[[], Pixels]
    """From memory, or read from the file again where the capture is too large for that.
    May be called from any thread."""

    def image(self) -> np.ndarray:
        """(H, W, 3) uint8, read-only. Raises InputError where the file has to be read again and cannot."""
        return self.pixels().image

    def mask(self) -> np.ndarray | None:
        """(H, W) bool, read-only: True where the pixel counts; None where all do. Raises as `image`."""
        return self.pixels().mask


@dataclass(frozen=True, eq=False, kw_only=True)
class Capture:
    """At least two photos, of which at least one is to train on; sorted by name."""

    name: str
    """Of its folder."""
    photos: tuple[Photo, ...]
    points: np.ndarray
    """(P, 3) float64, finite, P >= 4: where surfaces are, or random where the capture does not say."""
    point_colours: np.ndarray
    """(P, 3) uint8 RGB."""
    background: tuple[float, float, float] | None = None
    """What photos with transparency were laid over, RGB in 0..1; None where none has any."""
    evidence: PhotoEvidence = field(default_factory=PhotoEvidence)
    """What was found out about the photos while they were read."""
    warnings: tuple[str, ...] = ()
    """A line each: what was left out or made up."""

    @property
    def train(self) -> tuple[Photo, ...]:
        return tuple(photo for photo in self.photos if not photo.held_out)

    @property
    def held_out(self) -> tuple[Photo, ...]:
        """May be empty: then there is nothing to measure by."""
        return tuple(photo for photo in self.photos if photo.held_out)

    @property
    def scene_radius(self) -> float:
        """World units: 1.1 x the largest distance of a training camera from their mean (Kerbl et al. 2023).

        Where all cameras stand in one place, the median distance of the points from it.
        """
        eyes = np.array([photo.camera.eye for photo in self.train])
        centre = eyes.mean(axis=0)
        radius = float(np.linalg.norm(eyes - centre, axis=1).max())
        if not radius > 1e-9 * (1 + np.abs(centre).max()):
            radius = float(np.median(np.linalg.norm(self.points - centre, axis=1)))
        return EXTENT_MARGIN * radius
