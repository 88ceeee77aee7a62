"""Opacities and colours of an edited scene in one pass each."""

from __future__ import annotations

import numpy as np

from ...scene.edits import PALETTE_SHIFT
from ...scene.sh import SH_C0
from .compiling import kernel


@kernel
def opacities(start, stop, logits, marks, maps, values):
    """values[start:stop] of logits (N,); maps (P, 4) float32: gain, offset, low, high by entry. NaN stays."""
    for i in range(start, stop):
        # Where exp overflows to infinity the quotient is the 0 that it should be.
        value = np.float32(1) / (np.float32(1) + np.exp(-logits[i]))
        entry = marks[i] >> PALETTE_SHIFT
        if entry > 0:
            value = maps[entry, 0] * value + maps[entry, 1]
            if not np.isnan(value):
                value = min(max(value, maps[entry, 2]), maps[entry, 3])
        values[i] = value


@kernel
def base_colours(start, stop, sh, marks, maps, rgb):
    """rgb[start:stop] (N, 3) of the constant band of sh (N, K, 3); maps (P, 3, 4) float32 by entry."""
    half = np.float32(0.5)
    for i in range(start, stop):
        r = np.float32(SH_C0) * sh[i, 0, 0] + half
        g = np.float32(SH_C0) * sh[i, 0, 1] + half
        b = np.float32(SH_C0) * sh[i, 0, 2] + half
        entry = marks[i] >> PALETTE_SHIFT
        if entry > 0:
            m = maps[entry]
            r, g, b = (
                m[0, 0] * r + m[0, 1] * g + m[0, 2] * b + m[0, 3],
                m[1, 0] * r + m[1, 1] * g + m[1, 2] * b + m[1, 3],
                m[2, 0] * r + m[2, 1] * g + m[2, 2] * b + m[2, 3],
            )
        rgb[i, 0], rgb[i, 1], rgb[i, 2] = r, g, b
