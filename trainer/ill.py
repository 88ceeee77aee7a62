"""Splats that training cannot move: density control takes them out before it multiplies them.

A picture leaves out a splat with a value that is not finite, or with a rotation of zeros, so no gradient
ever reaches it; but by its opacity alone it would be chosen to be copied.
"""

from __future__ import annotations

import math

import numpy as np

from ..raster import Parameters, available_threads
from ..raster.compiling import kernel
from ..raster.pool import SPLATS_PER_TASK, even_ranges, run
from ..scene.image_model import MIN_QUAT_COMPONENT
from ..scene.projection import FLOAT32_MAX

LARGEST_LOG_SCALE = math.log(FLOAT32_MAX)
"""exp of more is infinite."""


def ill_splats(parameters: Parameters) -> np.ndarray:
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
