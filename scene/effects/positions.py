"""Where the splats are: whether float32 can hold it."""

from __future__ import annotations

import math

import numpy as np

from ..framing import robust_bounds
from ..gaussians import Gaussians
from ..health import FAR_SPACING
from ..projection import FLOAT32_MAX
from .effect import Effect, Saving


def centred_effect(gaussians: Gaussians) -> Effect:
    """Whether positions are kept relative to a centre in float64, or may be single numbers of float32.

    A file of float64 needs it wherever a position is no number of float32: then `bound` is not 0 but unknown,
    as by an eye that is near enough any step can be seen. One of float32 has lost its digits already; but far
    from the origin the camera and the edits would lose them too.
    """
    centre, radius = robust_bounds(gaussians.means)
    furthest = float(np.abs(centre).max()) + radius
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(gaussians.log_scales.max(axis=1, initial=-np.inf))
        spacing = float(np.spacing(np.float32(furthest)))
        single = gaussians.means.astype(np.float32)
        rounded = int((single.astype(np.float64) != gaussians.means).any(axis=1).sum())
    if gaussians.means.dtype == np.float32:
        rounded = 0
    sizes = sizes[(sizes > 0) & (sizes <= FLOAT32_MAX)]
    size = float(np.median(sizes)) if len(sizes) else 1.0
    on = bool(spacing > FAR_SPACING * size) or rounded > 0
    stored = gaussians.means.dtype.name
    why = (
        f"positions are {stored} and reach {furthest:.4g}, where float32 has steps of {spacing:.2g}; "
        f"the median splat measures {size:.2g}"
    )
    if gaussians.means.dtype == np.float64:
        why += f"; {rounded:,} of {len(gaussians):,} are no numbers of float32"
    return Effect(
        name="float64-centred positions",
        on=on,
        why=why,
        saving=Saving(what="one difference a splat"),
        bound=math.inf if on else 0.0,
    )
