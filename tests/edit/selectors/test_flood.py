"""The flood against a breadth-first search, its limits, and picking its seed in a picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.selectors import Flood, SimilarColour
from splatview.edit.selectors.attributes import base_colours
from splatview.edit.selectors.region_growing import picked
from splatview.edit.tools import NoTools
from splatview.scene import InputError, look_at
from splatview.scene.edits import HIDDEN, adjusted_means, shown
from splatview.scene.progress import Cancelled, Progress


def search(points: np.ndarray, candidates: np.ndarray, seed: int, reach: float) -> np.ndarray:
    reached = np.zeros(len(points), bool)
    if candidates[seed]:
        reached[seed] = True
        waiting = [seed]
        while waiting:
            near = np.linalg.norm(points - points[waiting.pop()], axis=1) <= reach
            new = near & candidates & ~reached
            reached |= new
            waiting += np.flatnonzero(new).tolist()
    return reached


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 1000),
    st.integers(0, 149),
    st.floats(0.05, 0.6),
    st.floats(0, 1.2),
    st.none() | st.floats(0.2, 2),
)
def test_flood_is_a_breadth_first_search(edit_helpers, edited, seed, start, reach, tolerance, limit):
    scene, edits = edit_helpers.make_scene(150, seed=seed), edited.some(150, seed=seed)
    points = adjusted_means(scene, edits).astype(np.float64)
    candidates = shown(scene, edits)
    if tolerance < 1:
        red, green, blue = (float(value) for value in base_colours(scene, edits)[start])
        candidates &= SimilarColour(rgb=(red, green, blue), tolerance=tolerance).mask(scene, edits, NoTools())
    if limit is not None:
        candidates &= np.linalg.norm(points - points[start], axis=1) <= limit
    flood = Flood(seed=start, reach=reach, tolerance=tolerance, limit=limit)
    expected = search(points, candidates, start, reach)
    assert (flood.mask(scene, edits, NoTools()) == expected).all()


def two_balls(edit_helpers, edited):
    """Two balls of 400 splats each, ten radii apart, the second half red and half blue."""
    scene = edit_helpers.make_scene(800)
    rng = np.random.default_rng(0)
    means = rng.normal(size=(800, 3)) * 0.3
    means[400:, 0] += 10
    sh = scene.sh.copy()
    sh[:, 0] = np.where((np.arange(800) >= 600)[:, None], (1.5, -1.5, -1.5), (-1.5, -1.5, 1.5))
    return replace(scene, means=means.astype(np.float32), sh=sh), edited.none(800)


def test_by_itself_it_stays_on_one_thing(edit_helpers, edited):
    scene, edits = two_balls(edit_helpers, edited)
    mask = Flood(seed=np.argmin(np.linalg.norm(scene.means, axis=1)).item(), tolerance=1).mask(
        scene, edits, NoTools()
    )
    assert mask[:400].mean() > 0.95
    assert not mask[400:].any()


def test_it_stays_in_its_colour(edit_helpers, edited):
    scene, edits = two_balls(edit_helpers, edited)
    mask = Flood(seed=500, reach=1.0).mask(scene, edits, NoTools())
    assert mask[400:600].mean() > 0.95
    assert not mask[600:].any()


def test_what_is_hidden_neither_joins_nor_passes_on(edit_helpers, edited):
    scene, edits = edit_helpers.make_scene(5), edited.none(5)
    scene = replace(scene, means=np.array([[i, 0, 0] for i in range(5)], np.float32))
    marks = np.array([0, 0, HIDDEN, 0, 0], np.uint32)
    edits = replace(edits, marks=marks, flags=HIDDEN)
    flood = Flood(seed=0, reach=1.0, tolerance=1)
    assert flood.mask(scene, edits, NoTools()).tolist() == [True, True, False, False, False]
    assert not replace(flood, seed=2).mask(scene, edits, NoTools()).any()


def test_a_seed_of_another_scene(edit_helpers, edited):
    with pytest.raises(InputError, match="seed is splat 9, but the scene has 5"):
        Flood(seed=9).mask(edit_helpers.make_scene(5), edited.none(5), NoTools())


def test_it_can_be_stopped(edit_helpers, edited):
    with pytest.raises(Cancelled):
        Flood(seed=0).mask(
            edit_helpers.make_scene(500),
            edited.none(500),
            NoTools(),
            progress=Progress(cancelled=lambda: True),
        )


def test_picking_takes_what_the_picture_shows(edit_helpers, edited, reference_tools):
    scene, edits = edit_helpers.make_scene(60), edited.none(60)
    camera = look_at((0, 0, -3), (0, 0, 0), width=40, height=30)
    picture = reference_tools.dominant_splats(scene, camera, edits)
    assert picked(scene, edits, reference_tools, camera, 20.9, 15.2) == picture[15, 20] >= 0
    assert picked(scene, edits, reference_tools, camera, 40.0, 15) is None
    assert picked(scene, edits, reference_tools, camera, -0.1, 15) is None
    empty = replace(edits, marks=np.full(60, HIDDEN, np.uint32), flags=HIDDEN)
    assert picked(scene, empty, reference_tools, camera, 20, 15) is None
