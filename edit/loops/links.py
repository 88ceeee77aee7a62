"""Clusters of points that are linked to some of their nearest neighbours."""

from __future__ import annotations

import numpy as np

from .compiling import inline, kernel


@inline
def _root(parents, i):
    while parents[i] != i:
        parents[i] = parents[parents[i]]
        i = parents[i]
    return i


@kernel
def linked(neighbours, distances, reaches):
    """Labels (M,) int64, that of a cluster being its least index.

    Point i and its neighbour j, of neighbours (M, k) int32, are linked where their distance is at most the
    lesser of reaches[i] and reaches[j].
    """
    parents = np.arange(len(neighbours))
    for i in range(len(neighbours)):
        for column in range(neighbours.shape[1]):
            j = neighbours[i, column]
            if j >= 0 and distances[i, column] <= min(reaches[i], reaches[j]):
                a, b = _root(parents, i), _root(parents, j)
                if a != b:
                    parents[max(a, b)] = min(a, b)
    for i in range(len(parents)):
        parents[i] = _root(parents, i)
    return parents
