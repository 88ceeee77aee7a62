"""Shapes of the scene that training minds: where nothing may grow, and what is cut away."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..scene.crop import Crop


def inside_any(regions: Sequence[Crop], means: np.ndarray) -> np.ndarray:
    """Which of `means` (N, 3) are inside a region that is switched on, whatever it keeps: (N,) bool."""
    inside = np.zeros(len(means), np.bool_)
    for region in regions:
        if region.enabled:
            inside |= region.contains(means)
    return inside
