"""Where the splats are: whether float32 can hold it."""

from __future__ import annotations

import numpy as np

from ..framing import robust_bounds
from ..gaussians import Gaussians
from ..health import FAR_SPACING
from ..projection import FLOAT32_MAX
from .effect import Effect


def centred_effect(gaussians: Gaussians) -> Effect:
    centre, radius = robust_bounds(gaussians.means)
    furthest = float(np.abs(centre).max()) + radius
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(gaussians.log_scales.max(axis=1, initial=-np.inf))
        spacing = float(np.spacing(np.float32(furthest)))
    sizes = sizes[(sizes > 0) & (sizes <= FLOAT32_MAX)]
    size = float(np.median(sizes)) if len(sizes) else 1.0
    stored = gaussians.means.dtype.name
    return Effect(
        name="float64-centred positions",
        on=bool(spacing > FAR_SPACING * size) or gaussians.means.dtype == np.float64,
        why=f"positions are {stored} and reach {furthest:.4g}, where float32 has steps of {spacing:.2g}; "
        f"the median splat measures {size:.2g}",
    )
