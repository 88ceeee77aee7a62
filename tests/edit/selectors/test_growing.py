"""Growing against brute force, and the laws that it and shrinking keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.selectors.region_growing import grow, shrink
from splatview.scene.edits import HIDDEN, adjusted_means, shown

ways = st.one_of(
    st.builds(lambda d: {"distance": d}, st.floats(0.01, 1)),
    st.builds(lambda k: {"neighbours": k}, st.integers(1, 10)),
)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1000), ways, st.floats(0, 1), st.integers(1, 120))
def test_laws(edit_helpers, edited, seed, way, share, count):
    scene, edits = edit_helpers.make_scene(count, seed=seed), edited.some(count, seed=seed)
    rng = np.random.default_rng(seed)
    mask = rng.uniform(size=count) < share
    more = mask | (rng.uniform(size=count) < 0.2)
    grown, shrunk = grow(mask, scene, edits, **way), shrink(mask, scene, edits, **way)
    assert (grown | ~mask).all(), "growing keeps what there is"
    assert (mask | ~shrunk).all(), "shrinking adds nothing"
    assert (shrink(grown, scene, edits, **way) | ~mask).all(), "closing keeps what there is"
    assert (mask | ~grow(shrunk, scene, edits, **way)).all(), "opening adds nothing"
    assert (grow(more, scene, edits, **way) | ~grown).all(), "more grows to more"
    unseen = ~shown(scene, edits)
    assert (grown[unseen] == mask[unseen]).all()
    assert (shrunk[unseen] == mask[unseen]).all()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 1000), ways)
def test_growing_reaches_what_is_near(edit_helpers, edited, seed, way):
    scene, edits = edit_helpers.make_scene(80, seed=seed), edited.some(80, seed=seed)
    mask = np.random.default_rng(seed).uniform(size=80) < 0.15
    there = np.flatnonzero(shown(scene, edits))
    points = adjusted_means(scene, edits)[there].astype(np.float64)
    apart = np.linalg.norm(points[:, None] - points[None], axis=2)
    if "distance" in way:
        near = apart <= way["distance"]
    else:
        np.fill_diagonal(apart, np.inf)
        near = apart <= np.sort(apart, axis=1)[:, min(way["neighbours"], len(there) - 1) - 1, None]
        near &= np.isfinite(apart)
        near |= near.T
    expected = mask.copy()
    expected[there] |= near[:, mask[there]].any(axis=1)
    assert (grow(mask, scene, edits, **way) == expected).all()


def test_nothing_passes_through_what_is_hidden(edit_helpers, edited):
    scene = replace(edit_helpers.make_scene(3), means=np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], np.float32))
    edits = replace(edited.none(3), marks=np.array([0, HIDDEN, 0], np.uint32), flags=HIDDEN)
    chosen = np.array([False, True, False])
    assert grow(chosen, scene, edits, distance=1.5).tolist() == [False, True, False]
    assert shrink(chosen, scene, edits, distance=1.5).tolist() == [False, True, False]


@pytest.mark.parametrize(
    ("way", "message"),
    [
        ({}, "either distance or neighbours"),
        ({"distance": 1.0, "neighbours": 2}, "either distance or neighbours"),
        ({"distance": 0.0}, "distance must be above 0"),
        ({"distance": np.nan}, "distance must be a finite number"),
        ({"neighbours": 0}, "neighbours must be a whole number of at least 1"),
    ],
)
def test_bad_ways(edit_helpers, edited, way, message):
    for change in (grow, shrink):
        with pytest.raises(ValueError, match=message):
            change(np.zeros(3, bool), edit_helpers.make_scene(3), edited.none(3), **way)
