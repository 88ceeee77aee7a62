"""Palettes of rows, against all rows beside all centroids."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.scene.formats.palette import Rows, _shares, nearest, vectors


@settings(max_examples=50)
@given(
    seed=st.integers(0, 2**32 - 1),
    groups=st.integers(1, 200),
    spare=st.integers(0, 2000),
    skew=st.floats(0, 40),
)
def test_shares_fit_however_uneven_the_groups(seed, groups, spare, skew):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(0, 5000, groups)
    shares = _shares(np.exp(skew * rng.normal(size=groups)), sizes, groups + spare)
    assert shares.min() >= 1 and shares.sum() <= groups + spare
    assert (shares <= np.maximum(sizes, 1)).all() and np.array_equal(shares, np.floor(shares))


def test_one_row_far_away_leaves_labels_within_the_palette():
    """A hundred groups with nothing to share: each has one centroid all the same."""
    rng = np.random.default_rng(3)
    values = rng.normal(0, 1e-3, (4000, 9)).astype(np.float32)
    values[:20] = rng.normal(0, 1e4, (20, 9))
    rows = Rows(values, np.arange(len(values)))
    for count in (1, 40, 500, 3999):
        centroids, labels = vectors(rows, np.ones(len(rows)), count)
        assert len(centroids) <= count and labels.min() >= 0 and labels.max() < len(centroids)
        errors = np.square(values - centroids[labels]).sum(axis=1)
        assert errors.sum() <= np.square(values - values.mean(axis=0)).sum() * 1.0001


def test_nearest_is_that_of_all_distances(rng):
    rows, centroids = (
        rng.normal(size=(500, 24)).astype(np.float32),
        rng.normal(size=(70, 24)).astype(np.float32),
    )
    labels, errors = nearest(rows, centroids)
    squares = np.square(rows[:, None].astype(np.float64) - centroids).sum(axis=2)
    # Products of float32: 24 terms of some 3 each, to 6e-8 of their sum.
    np.testing.assert_allclose(errors, squares.min(axis=1), atol=1e-4)
    np.testing.assert_allclose(squares[np.arange(500), labels], squares.min(axis=1), atol=1e-4)
