"""Splats that training cannot move: density control takes them out before it multiplies them.

A picture leaves out a splat with a value that is not finite, or with a rotation of zeros, so no gradient
ever reaches it; but by its opacity alone it would be chosen to be copied.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from splatview.raster import Parameters, available_threads
from splatview.raster.compiling import SPLATS_PER_TASK, even_ranges, kernel, run
from splatview.scene.edits import Crop
from splatview.scene.image_model import MIN_QUAT_COMPONENT
from splatview.scene.projection import FLOAT32_MAX

LARGEST_LOG_SCALE = math.log(FLOAT32_MAX)
"""exp of more is infinite."""


def invalid_splats(parameters: Parameters) -> np.ndarray:
    """(N,) bool: a value is not finite, a log-scale is beyond float32's exp, or the quaternion is zero."""
    ill = np.empty(len(parameters.means), np.bool_)
    threads = available_threads()
    run(find_ill, even_ranges(len(ill), threads, step=SPLATS_PER_TASK), (*parameters, ill), threads)
    return ill


@kernel
def find_ill(start, stop, means, quats, log_scales, opacity_logits, sh, ill):
    for i in range(start, stop):
        # 0 where all are finite, else NaN.
        nothing = opacity_logits[i] * 0
        largest = np.float32(-np.inf)
        for k in range(3):
            nothing += means[i, k] * 0 + log_scales[i, k] * 0
            largest = max(largest, log_scales[i, k])
        longest = np.float32(0)
        for k in range(4):
            nothing += quats[i, k] * 0
            longest = max(longest, abs(quats[i, k]))
        for k in range(sh.shape[1]):
            for channel in range(3):
                nothing += sh[i, k, channel] * 0
        ill[i] = not (nothing == 0 and longest >= MIN_QUAT_COMPONENT and largest <= LARGEST_LOG_SCALE)


# ---- Shapes of the scene that training minds: where nothing may grow, and what is cut away.


def inside_any(regions: Sequence[Crop], means: np.ndarray) -> np.ndarray:
    """Which of `means` (N, 3) are inside a region that is switched on, whatever it keeps: (N,) bool."""
    inside = np.zeros(len(means), np.bool_)
    for region in regions:
        if region.enabled:
            inside |= region.contains(means)
    return inside


# ---- A step without some of the splats, so that the others cannot rely on them: where photos are few, splats
# that make one photo right by covering for one another's faults make every other view wrong.
#
# Source: Park et al. 2025, DropGaussian. There the opacities of those left are divided by their share; here
# their logits are raised by its logarithm, which is the same where splats are faint, keeps opacities below 1,
# and leaves the derivative by a logit as it is.


GONE = -30.0
"""A logit whose opacity no picture shows."""


def some_dropped(parameters: Parameters, share: float, rng: np.random.Generator) -> Parameters:
    """The splats with this share (below 1) of them, drawn by chance, made invisible; the rest is stronger."""
    with np.errstate(invalid="ignore"):  # NaN may be signalling
        logits = parameters.opacity_logits - np.float32(math.log1p(-share))
    logits[rng.random(len(logits), np.float32) < share] = GONE
    return parameters._replace(opacity_logits=logits)
