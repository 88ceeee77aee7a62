"""Distances to the nearest neighbours of every point."""

from __future__ import annotations

import numpy as np

from ..edit.loops.tree import nearest


def mean_square_distance(points: np.ndarray, *, neighbours: int = 3) -> np.ndarray:
    """(N,) float64: the mean squared distance of each of points (N, 3) to its nearest others.

    Points all finite. Where there are fewer others, the mean is over those; a lone point has 0.
    """
    neighbours = min(neighbours, len(points) - 1)
    if neighbours < 1:
        return np.zeros(len(points))
    _, distances = nearest(points, neighbours)
    return np.square(distances).mean(axis=1)
