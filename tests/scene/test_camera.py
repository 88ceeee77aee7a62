"""Camera: conventions, look-at laws, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from splatview.scene import Camera, look_at

coordinate = st.floats(-1e3, 1e3, width=32)
point = st.tuples(coordinate, coordinate, coordinate)


@given(eye=point, target=point, up=point)
# Up is nearly, but not quite, along the view.
@example(eye=(0.0, 0.0, 1e-5), target=(99.0, 230.0, 304.0), up=(99.0, 230.0, 304.0))
def test_look_at_laws(eye, target, up):
    if math.dist(eye, target) < 1e-3 or math.hypot(*up) < 1e-3:
        with_up = (0, 1, 0)
        eye, target, up = (0, 0, 0), (0, 0, 1), with_up
    camera = look_at(eye, target, up=up)
    R = camera.R_camera_world
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-9)
    assert np.linalg.det(R) == pytest.approx(1)
    np.testing.assert_allclose(camera.eye, eye, atol=1e-9 * 1e3)
    in_camera = R @ np.asarray(target) + camera.t_camera_world
    np.testing.assert_allclose(in_camera, [0, 0, math.dist(eye, target)], atol=1e-6)
    assert R[1] @ np.asarray(up) <= 1e-9 * math.hypot(*up), "up points up: against the camera's y"


def test_axes_are_opencv():
    camera = look_at((0, 0, 0), (0, 0, 5), up=(0, 1, 0))
    right, down, forward = camera.R_camera_world
    np.testing.assert_allclose((right, down, forward), ((-1, 0, 0), (0, -1, 0), (0, 0, 1)), atol=1e-15)


def test_field_of_view_is_vertical():
    camera = look_at((0, 0, 0), (0, 0, 1), fov_y=90, width=300, height=200)
    assert camera.fy == pytest.approx(100) and camera.fx == camera.fy
    assert (camera.cx, camera.cy) == (150, 100)


def test_looking_along_up_still_gives_a_camera():
    camera = look_at((0, 0, 0), (0, 3, 0), up=(0, 1, 0))
    np.testing.assert_allclose(camera.forward, (0, 1, 0), atol=1e-15)


@pytest.mark.parametrize("bad", [{"fov_y": 0}, {"fov_y": 180}, {"fov_y": math.nan}, {"width": 0}])
def test_look_at_refuses(bad):
    with pytest.raises(ValueError):
        look_at((0, 0, 0), (0, 0, 1), **bad)


@pytest.mark.parametrize("eye", [(0, 0, 1), (math.nan, 0, 0), (math.inf, 0, 0)])
def test_look_at_refuses_degenerate_points(eye):
    with pytest.raises(ValueError):
        look_at(eye, (0, 0, 1))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("width", 0),
        ("fx", 0.0),
        ("fy", math.nan),
        ("fx", math.inf),
        ("cx", math.nan),
        ("world_to_camera", np.eye(3)),
        ("world_to_camera", np.diag([1.0, 1, -1, 1])),
        ("world_to_camera", np.diag([2.0, 2, 2, 1])),
        ("world_to_camera", np.full((4, 4), math.nan)),
    ],
)
def test_camera_refuses(key, value):
    good = {"width": 4, "height": 4, "fx": 4, "fy": 4, "cx": 2, "cy": 2, "world_to_camera": np.eye(4)}
    with pytest.raises(ValueError, match="size" if key == "width" else key):
        Camera(**{**good, key: value})


def test_resized_scales_intrinsics_exactly():
    camera = look_at((1, 2, 3), (0, 0, 0), width=250, height=183).resized(62, 45)
    assert camera.fx == pytest.approx(183 / 2 / math.tan(math.radians(25)) * 62 / 250)
    assert camera.cy == pytest.approx(22.5)


def test_same_view_ignores_names_only(random_gaussians):
    camera = look_at((1, 2, 3), (0, 0, 0))
    assert camera.same_view(look_at((1, 2, 3), (0, 0, 0)))
    assert not camera.same_view(look_at((1, 2, 3.001), (0, 0, 0)))
    assert not camera.same_view(camera.resized(640, 360))
