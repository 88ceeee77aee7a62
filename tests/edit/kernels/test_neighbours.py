"""Nearest neighbours, clusters and distances against brute force, for points of any spread."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.kernels.grid import components, within
from splatview.edit.kernels.kdtree import nearest
from splatview.scene.progress import Cancelled, Progress


def points_of(seed: int, count: int, kind: str) -> np.ndarray:
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    if kind == "grid":  # many ties, and distances that are exactly the limit
        points = rng.integers(-3, 4, (count, 3)) * 0.25
    if kind == "heap":
        points[: count // 2] = points[0]
    if kind == "far":
        points = points * 10.0 ** rng.integers(-3, 16, (count, 1))
    return points


scenes = st.builds(
    points_of,
    st.integers(0, 1000),
    st.integers(1, 60),
    st.sampled_from(["even", "grid", "heap", "far"]),
)


def distances_of(points: np.ndarray) -> np.ndarray:
    return np.sqrt(((points[:, None] - points[None]) ** 2).sum(axis=2))


@settings(max_examples=60, deadline=None)
@given(scenes, st.integers(1, 12))
def test_nearest_is_the_nearest(points, k):
    indices, distances = nearest(points, k)
    apart = distances_of(points)
    np.fill_diagonal(apart, np.inf)
    expected = np.sort(apart, axis=1)[:, :k]
    expected = np.pad(expected, ((0, 0), (0, k - expected.shape[1])), constant_values=np.inf)
    np.testing.assert_allclose(distances, expected, rtol=1e-12)
    there = indices >= 0
    assert (there == np.isfinite(expected)).all()
    rows, columns = np.nonzero(there)
    np.testing.assert_allclose(apart[rows, indices[there]], distances[rows, columns], rtol=1e-12)
    for row, present in zip(indices, there, strict=True):
        assert len(set(row[present].tolist())) == present.sum()


@settings(max_examples=80, deadline=None)
@given(scenes, st.sampled_from([0.1, 0.25, 0.5, 2.0, 1e4]))
def test_clusters_are_those_of_a_breadth_first_search(points, distance):
    linked = distances_of(points) <= distance
    expected = np.full(len(points), -1)
    for start in range(len(points)):
        if expected[start] < 0:
            waiting = [start]
            expected[start] = start
            while waiting:
                for other in np.flatnonzero(linked[waiting.pop()] & (expected < 0)):
                    expected[other] = start
                    waiting.append(int(other))
    labels = components(points, distance)
    assert len(set(zip(labels.tolist(), expected.tolist(), strict=True))) == len(set(expected.tolist()))
    assert sorted(set(labels.tolist())) == list(range(len(set(expected.tolist()))))


@settings(max_examples=80, deadline=None)
@given(scenes, st.integers(0, 100), st.sampled_from([0.1, 0.25, 0.5, 2.0]))
def test_within_is_within(points, seed, distance):
    sources = np.random.default_rng(seed).uniform(size=len(points)) < 0.2
    expected = sources | (distances_of(points)[:, sources] <= distance).any(axis=1)
    assert (within(points, sources, distance) == expected).all()


def test_points_without_a_place_are_alone():
    points = np.array([[0, 0, 0], [0.1, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0], [np.inf, 0, 0.0]])
    labels = components(points, 1.0)
    assert labels[0] == labels[1]
    assert len(set(labels.tolist())) == 4
    sources = np.array([True, False, True, False, False])
    assert within(points, sources, 1.0).tolist() == [True, True, True, False, False]


def test_no_points():
    none = np.empty((0, 3))
    assert components(none, 1.0).shape == (0,)
    assert within(none, np.empty(0, bool), 1.0).shape == (0,)
    assert nearest(none, 3)[0].shape == (0, 3)


@pytest.mark.parametrize("work", [lambda p, w: nearest(p, 4, w), lambda p, w: components(p, 0.1, w)])
def test_work_tells_how_far_it_is_and_stops_when_told(work, rng):
    points = rng.uniform(size=(30_000, 3))
    shares: list[float] = []
    work(points, Progress(report=shares.append))
    assert shares == sorted(shares)
    assert shares[0] < 0.5
    assert shares[-1] == 1
    with pytest.raises(Cancelled):
        work(points, Progress(cancelled=lambda: True))
