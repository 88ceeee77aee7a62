"""A step without some of the splats, so that the others cannot rely on them: where photos are few, splats
that make one photo right by covering for one another's faults make every other view wrong.

Source: Park et al. 2025, DropGaussian. There the opacities of those left are divided by their share; here
their logits are raised by its logarithm, which is the same where splats are faint, keeps opacities below 1,
and leaves the derivative by a logit as it is.
"""

from __future__ import annotations

import math

import numpy as np

from ..raster import Parameters

GONE = -30.0
"""A logit whose opacity no picture shows."""


def some_dropped(parameters: Parameters, share: float, rng: np.random.Generator) -> Parameters:
    """The splats with this share (below 1) of them, drawn by chance, made invisible; the rest is stronger."""
    with np.errstate(invalid="ignore"):  # NaN may be signalling
        logits = parameters.opacity_logits - np.float32(math.log1p(-share))
    logits[rng.random(len(logits), np.float32) < share] = GONE
    return parameters._replace(opacity_logits=logits)
