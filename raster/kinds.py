"""Which machine code a picture needs: kernels are compiled by the kinds of their arguments."""

from __future__ import annotations

import numba

from ..scene import Camera, Gaussians, RenderSettings
from .compiling import cache_stamp
from .discs import make_discs
from .nonzero import nonzero_bands
from .optics import make_optics


def kind_of(gaussians: Gaussians, camera: Camera, settings: RenderSettings, *, edited: bool = False) -> str:
    """Pictures of one kind take the same machine code; different for other versions of this program.

    `edited`: edits are in force.
    """
    own_degrees = nonzero_bands(gaussians).own_degrees is not None
    parts = (
        cache_stamp(),
        gaussians.means.dtype.name,
        str(numba.typeof(make_optics(camera))),
        make_discs(camera, settings.model) is not None,
        edited,
        own_degrees,
        settings.order == "per-pixel",
    )
    return "cpu " + " ".join(str(part) for part in parts)
