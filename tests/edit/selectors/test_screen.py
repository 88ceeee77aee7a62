"""Regions of a picture: through everything against numpy's projection, the front against a picture of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.selectors import Brush, Lasso, Polygon, Rectangle
from splatview.edit.tools import NoTools
from splatview.scene import InputError, Lens, look_at
from splatview.scene.edits import HIDDEN, adjusted_means
from splatview.scene.image_model import NEAR

CAMERA = look_at((0.4, -0.3, -1.1), (0, 0, 0), up=(0, -1, 0), width=64, height=48)
SQUARE = ((10.0, 8.0), (50.0, 8.0), (50.0, 40.0), (10.0, 40.0))


def pixels_of(gaussians, edits, camera) -> np.ndarray:
    """(N, 2) px; NaN before the near plane."""
    means = adjusted_means(gaussians, edits).astype(np.float64)
    t = (means - camera.eye) @ camera.R_camera_world.T
    if camera.lens is not None:
        points = camera.image_points(t)
    else:
        away = 1 if camera.orthographic else t[:, 2:]
        with np.errstate(divide="ignore", invalid="ignore"):
            points = t[:, :2] / away * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    return np.where(t[:, 2:] >= NEAR, points, np.nan)


coordinate = st.floats(-20, 80, allow_nan=False)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 1000), st.lists(coordinate, min_size=4, max_size=4))
def test_a_rectangle_goes_through_everything(edit_helpers, edited, seed, corners):
    scene, edits = edit_helpers.make_scene(300, seed=seed), edited.some(300, seed=seed)
    x0, y0, x1, y1 = corners
    mask = Rectangle(camera=CAMERA, x0=x0, y0=y0, x1=x1, y1=y1).mask(scene, edits, NoTools())
    x, y = pixels_of(scene, edits, CAMERA).T
    expected = (x >= min(x0, x1)) & (x <= max(x0, x1)) & (y >= min(y0, y1)) & (y <= max(y0, y1))
    assert (mask == expected).all()


def test_polygon_lasso_and_brush_are_where_they_say(edit_helpers, edited):
    scene, edits = edit_helpers.make_scene(3000), edited.some(3000)
    x, y = pixels_of(scene, edits, CAMERA).T
    square = (x > 10) & (x < 50) & (y > 8) & (y < 40)
    for region in (Polygon, Lasso):
        assert (region(camera=CAMERA, points=SQUARE).mask(scene, edits, NoTools()) == square).all()
    path = ((10.0, 10.0), (40.0, 10.0))
    mask = Brush(camera=CAMERA, points=path, radius=5.0).mask(scene, edits, NoTools())
    assert (mask == (np.hypot(x - np.clip(x, 10, 40), y - 10) <= 5)).all()
    assert 0 < mask.sum() < square.sum() < np.isfinite(x).sum() < 3000


def test_what_is_nearer_than_the_near_plane_or_nowhere_is_in_no_region(edit_helpers, edited):
    scene = edit_helpers.make_scene(4)
    means = np.array([[0, 0, NEAR * 0.99], [0, 0, NEAR], [np.nan, 0, 1], [0, 0, -1]], np.float32)
    camera = look_at((0, 0, 0), (0, 0, 1), up=(0, -1, 0), width=64, height=48)
    region = Rectangle(camera=camera, x0=-1e9, y0=-1e9, x1=1e9, y1=1e9)
    mask = region.mask(replace(scene, means=means), edited.none(4), NoTools())
    assert mask.tolist() == [False, bool(np.float64(means[1, 2]) >= NEAR), False, False]
    means[1, 2] = NEAR * 1.01
    mask = region.mask(replace(scene, means=means), edited.none(4), NoTools())
    assert mask.tolist() == [False, True, False, False]


@pytest.mark.parametrize(
    "region",
    [
        Rectangle(camera=CAMERA, x0=10, y0=8, x1=50, y1=40, depth="front"),
        Polygon(camera=CAMERA, points=SQUARE, depth="front"),
        Brush(camera=CAMERA, points=((30.0, 20.0), (30.0, 60.0)), radius=7.5, depth="front"),
    ],
)
def test_the_front_is_what_the_picture_shows(edit_helpers, edited, reference_tools, region):
    scene, edits = edit_helpers.make_scene(120), edited.some(120)
    mask = region.mask(scene, edits, reference_tools)
    picture = reference_tools.dominant_splats(scene, CAMERA, edits)
    x, y = np.meshgrid(np.arange(64) + 0.5, np.arange(48) + 0.5)
    if isinstance(region, Brush):
        inside = np.hypot(x - 30, y - np.clip(y, 20, 60)) <= 7.5
    else:
        inside = (x > 10) & (x < 50) & (y > 8) & (y < 40)
    expected = np.unique(picture[inside])
    assert np.flatnonzero(mask).tolist() == expected[expected >= 0].tolist()
    assert 5 < mask.sum() < 60


def test_hiding_the_front_uncovers_what_is_behind(edit_helpers, edited, reference_tools):
    scene, edits = edit_helpers.make_scene(60), edited.none(60)
    region = Rectangle(camera=CAMERA, x0=20, y0=15, x1=44, y1=33, depth="front")
    first = region.mask(scene, edits, reference_tools)
    hidden = replace(edits, marks=np.where(first, HIDDEN, 0).astype(np.uint32), flags=HIDDEN)
    second = region.mask(scene, hidden, reference_tools)
    assert second.any()
    assert not (first & second).any()


def test_a_region_beside_the_picture_has_no_front(edit_helpers, edited, reference_tools):
    region = Rectangle(camera=CAMERA, x0=-30, y0=5, x1=-10, y1=9, depth="front")
    assert not region.mask(edit_helpers.make_scene(50), edited.none(50), reference_tools).any()


def test_the_front_needs_a_renderer(edit_helpers, edited):
    with pytest.raises(InputError, match="renderer"):
        Polygon(camera=CAMERA, points=SQUARE, depth="front").mask(
            edit_helpers.make_scene(5), edited.none(5), NoTools()
        )


@pytest.mark.parametrize(
    "change",
    [
        {"lens": Lens(model="OPENCV", parameters=(-0.3, 0.0, 0.01, 0.0))},
        {"lens": Lens(model="OPENCV_FISHEYE", parameters=(0.05, 0.0, 0.0, 0.0)), "fx": 20.0, "fy": 20.0},
        {"orthographic": True, "fx": 20.0, "fy": 20.0},
    ],
)
def test_lenses_and_parallel_rays(edit_helpers, edited, change):
    scene, edits = edit_helpers.make_scene(400, seed=3), edited.some(400, seed=3)
    camera = replace(CAMERA, **change)
    x, y = pixels_of(scene, edits, camera).T
    mask = Rectangle(camera=camera, x0=12.0, y0=10.0, x1=45.0, y1=35.0).mask(scene, edits, NoTools())
    np.testing.assert_array_equal(mask, (x >= 12) & (x <= 45) & (y >= 10) & (y <= 35))
    assert 0 < mask.sum() < len(scene)
