"""What is found out about photos while they are read, so that training does only what they call for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..camera import Camera

LEAST_DISPLACEMENT = 0.05
"""Px of a photo at its final size. A lens that moves no point of the picture by more is left out: nothing is
resampled. Poses are rarely known to better than ten times this; where two pixels side by side are black and
white, a twentieth of a pixel is 13 grey levels, elsewhere less."""

SAMPLES = 33
"""A side, borders included. Displacements are smooth: between these they exceed them by less than 1 %."""

MARGIN = 1.01
"""For that."""


@dataclass(frozen=True, kw_only=True)
class PhotoEvidence:
    """Of all photos of a capture, at their final sizes."""

    lenses: int = 0
    """Photos whose camera has a lens that is no pinhole."""
    lenses_left_out: int = 0
    """Of these, photos whose lens shows nowhere: see LEAST_DISPLACEMENT."""
    displacement: float = 0.0
    """px, the largest distance of any point in a picture from where a pinhole has it."""
    transparent: int = 0
    """Photos with transparency, laid over the background."""
    masks: int = 0
    """Photos that come with a mask of their own."""
    hidden: float = 0.0
    """Share of all photos' pixels that do not count: masked, or beyond what the lens has seen."""


def largest_displacement(camera: Camera) -> float:
    """The largest distance, px, of any point in the picture from where a pinhole has it; inf where a lens
    does not show all that the pinhole does."""
    if camera.lens is None:
        return 0.0
    x, y = (np.linspace(0.0, float(size), SAMPLES) for size in (camera.width, camera.height))
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    rays = replace(camera, lens=None).points_at(pixels, 1.0)
    away = np.linalg.norm(camera.image_points(rays) - pixels, axis=-1)
    return float(MARGIN * away.max()) if np.isfinite(away).all() else float("inf")
