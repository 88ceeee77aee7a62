"""Which of a scene's haze photos could have told."""

from __future__ import annotations

import numpy as np
from bench_haze import table, told_empty

from splatview.scene import look_at


def test_a_photo_tells_of_places_where_it_is_transparent():
    camera = look_at((0, 0, -4), (0, 0, 0), up=(0, -1, 0), fov_y=40, width=20, height=10)
    opacity = np.full((10, 20), 255, np.uint8)
    opacity[:, :10] = (
        0  # the left half, where x is negative: x goes to the right in pictures, as in this world
    )
    left, right = np.array([-0.5, 0, 0]), np.array([0.5, 0, 0])
    behind_camera, beside = np.array([-0.5, 0, -8]), np.array([-50.0, 0, 0])
    # However deep: a transparent pixel says so of its whole ray.
    places = np.stack([left, left * 1.4 + [0, 0, 2], right, behind_camera, beside])
    assert told_empty(places, [(camera, opacity)]).tolist() == [True, True, False, False, False]
    # One of several photos is enough.
    other = look_at((0, 0, 4), (0, 0, 0), up=(0, -1, 0), fov_y=40, width=20, height=10)
    assert told_empty(places[2:3], [(camera, opacity), (other, opacity)]).tolist() == [True]


def test_the_table_weighs_pixels_not_splits():
    runs = [
        {"capture": "skull close 80", "split": 0, "pixels": [10, 90], "opacities": [5.0, 0.9]},
        {"capture": "skull close 80", "split": 1, "pixels": [0, 300], "opacities": [0.0, 3.0]},
    ]
    (row,) = table(runs)["rows"]
    assert row == ["skull close 80", "choose", 2, "0.0223", "2.50%", "0.500", "56%", "0.0100"]
