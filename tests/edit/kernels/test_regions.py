"""Polygons and strokes against plain numpy: to the bit, points on borders included."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.kernels.polygon import in_polygon, in_stroke, make_polygon, make_stroke


def wound_around(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """(P,) bool: the winding number is not 0 (Sunday 2001), every edge looked at."""
    x, y = points.T[:, :, None]
    ax, ay = corners.T
    bx, by = np.roll(corners, -1, axis=0).T
    side = (bx - ax) * (y - ay) - (x - ax) * (by - ay)
    up = (ay <= y) & (y < by) & (side > 0)
    down = (by <= y) & (y < ay) & (side < 0)
    return (up.sum(axis=1) - down.sum(axis=1)) != 0


def distance_to_path(points: np.ndarray, path: np.ndarray) -> np.ndarray:
    a, b = path[:-1], path[1:]
    if len(path) == 1:
        a = b = path
    along = b - a
    length = (along**2).sum(axis=1)
    share = ((points[:, None] - a) * along).sum(axis=2) / np.where(length > 0, length, 1)
    nearest = a + np.clip(share, 0, 1)[..., None] * along
    return np.sqrt(((points[:, None] - nearest) ** 2).sum(axis=2)).min(axis=1)


whole = st.integers(-8, 8).map(float)
anywhere = st.floats(-50, 50, allow_nan=False, width=32)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(whole, whole), min_size=3, max_size=40))
def test_polygons_of_whole_numbers(corners):
    points = np.stack(np.meshgrid(np.arange(-9, 9.25, 0.25), np.arange(-9, 9.25, 0.25)), axis=-1)
    check_polygon(points.reshape(-1, 2), np.array(corners))


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(anywhere, anywhere), min_size=3, max_size=60), st.integers(0, 100))
def test_polygons_anywhere(corners, seed):
    points = np.random.default_rng(seed).uniform(-55, 55, (2000, 2))
    check_polygon(np.vstack([points, corners]), np.array(corners))


def check_polygon(points: np.ndarray, corners: np.ndarray) -> None:
    bounds = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
    inside = np.empty(len(points), bool)
    in_polygon(points, bounds, make_polygon(corners), inside)
    assert (inside == wound_around(points, corners)).all()


def test_an_outline_that_crosses_itself_has_no_holes():
    turns = np.linspace(0, 4 * np.pi, 100)
    twice = np.stack([np.cos(turns), np.sin(turns)], axis=1)
    inside = np.empty(1, bool)
    in_polygon(np.zeros((1, 2)), np.array((-1.0, -1, 1, 1)), make_polygon(twice), inside)
    assert inside[0]


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(anywhere, anywhere), min_size=1, max_size=40),
    st.floats(0.01, 30),
    st.integers(0, 100),
)
def test_strokes(path, radius, seed):
    points = np.random.default_rng(seed).uniform(-85, 85, (2000, 2))
    points = np.vstack([points, path])
    inside = np.empty(len(points), bool)
    in_stroke(points, make_stroke(np.array(path), radius), inside)
    distance = distance_to_path(points, np.array(path))
    clear = np.abs(distance - radius) > 1e-9
    assert (inside == (distance <= radius))[clear].all()


def test_nan_is_nowhere():
    points = np.array([[np.nan, 0.5], [0.5, np.nan], [np.inf, 0], [0.5, 0.5]])
    inside = np.empty(4, bool)
    in_polygon(
        points, np.array((0.0, 0, 1, 1)), make_polygon(np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])), inside
    )
    assert inside.tolist() == [False, False, False, True]
    in_stroke(points, make_stroke(np.array([[0.5, 0.5]]), 0.2), inside)
    assert inside.tolist() == [False, False, False, True]
