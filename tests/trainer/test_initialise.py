"""Nearest neighbours against brute force, and the splats that training begins with."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.scene import InputError
from splatview.scene.sh import SH_C0
from splatview.trainer.initialisation import initial_parameters, mean_square_distance


def brute_force(points: np.ndarray, neighbours: int) -> np.ndarray:
    squares = ((points[:, None] - points[None]) ** 2).sum(axis=2)
    np.fill_diagonal(squares, np.inf)
    return np.sort(squares, axis=1)[:, :neighbours].mean(axis=1)


@settings(max_examples=30, deadline=None)
@given(
    count=st.integers(4, 300),
    seed=st.integers(0, 1000),
    distinct=st.sampled_from([2, 5, 10**9]),
    spread=st.sampled_from([1e-3, 1.0, 1e6]),
)
def test_distances_are_those_of_brute_force(count: int, seed: int, distinct: int, spread: float) -> None:
    rng = np.random.default_rng(seed)
    points = np.round(rng.uniform(size=(count, 3)) * distinct) / distinct
    points[: count // 4] *= spread  # a dense knot, or far outliers
    np.testing.assert_allclose(mean_square_distance(points), brute_force(points, 3), rtol=1e-9, atol=1e-30)


def test_many_equal_points_are_no_worst_case() -> None:
    points = np.zeros((20_000, 3))
    points[0] = 1
    distances = mean_square_distance(points)
    assert distances[0] == pytest.approx(3)
    assert (distances[1:] == 0).all()


def test_few_points_have_few_neighbours() -> None:
    assert mean_square_distance(np.zeros((1, 3))).tolist() == [0]
    assert mean_square_distance(np.array([[0.0, 0, 0], [2, 0, 0]])).tolist() == [4, 4]


def test_splats_are_round_as_large_as_their_gaps_and_coloured_as_their_points() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [np.nan, 0, 0]])
    colours = np.array([[255, 0, 0], [0, 255, 0], [128, 128, 128], [0, 0, 0], [9, 9, 9]], np.uint8)
    start = initial_parameters(points, colours, 10.0)
    assert len(start.means) == 4
    assert (start.log_scales == start.log_scales[:, :1]).all()
    np.testing.assert_allclose(np.exp(start.log_scales[0]), 1, rtol=1e-6)
    np.testing.assert_allclose(np.exp(start.log_scales[1]), np.sqrt(5 / 3), rtol=1e-6)
    np.testing.assert_allclose(0.5 + SH_C0 * start.sh[:, 0], colours[:4] / 255, atol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-start.opacity_logits)), 0.1, rtol=1e-5)
    assert all(np.isfinite(array).all() for array in start)


def test_coinciding_points_have_a_size() -> None:
    start = initial_parameters(np.zeros((5, 3)), np.zeros((5, 3), np.uint8), 1.0)
    assert (np.exp(start.log_scales) > 1e-4).all()


def test_more_points_than_allowed_are_sampled() -> None:
    points = np.random.default_rng(0).normal(size=(100, 3))
    start = initial_parameters(points, np.zeros((100, 3), np.uint8), 1.0, limit=30, seed=1)
    again = initial_parameters(points, np.zeros((100, 3), np.uint8), 1.0, limit=30, seed=1)
    assert len(start.means) == 30
    np.testing.assert_array_equal(start.means, again.means)


def test_no_points_is_the_users_problem() -> None:
    with pytest.raises(InputError, match="no usable 3D points"):
        initial_parameters(np.full((3, 3), np.nan), np.zeros((3, 3), np.uint8), 1.0)
