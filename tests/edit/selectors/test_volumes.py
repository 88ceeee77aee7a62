"""Spheres and boxes hold what a crop of the same shape holds."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.selectors import Box, Sphere
from splatview.edit.tools import NoTools
from splatview.scene.edits import Crop, adjusted_means

place = st.floats(-1, 1)
size = st.floats(0.1, 2)


@settings(max_examples=40, deadline=None)
@given(
    st.integers(0, 1000),
    st.tuples(place, place, place),
    st.tuples(size, size, size),
    st.tuples(st.floats(0.5, 1), place, place, place),
)
def test_volumes(edit_helpers, edited, seed, centre, sizes, turn):
    scene, edits = edit_helpers.make_scene(200, seed=seed), edited.some(200, seed=seed)
    means = adjusted_means(scene, edits)
    w, x, y, z = (float(value) for value in np.array(turn) / np.linalg.norm(turn))
    box = Box(centre=centre, half_extents=sizes, rotation=(w, x, y, z))
    expected = Crop(shape="box", centre=centre, half_extents=sizes, rotation=(w, x, y, z)).contains(means)
    assert (box.mask(scene, edits, NoTools()) == expected).all()
    ball = Sphere(centre=centre, radius=sizes[0])
    expected = np.linalg.norm(means - np.array(centre), axis=1) <= sizes[0]
    assert (ball.mask(scene, edits, NoTools()) == expected).all()
