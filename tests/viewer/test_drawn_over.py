"""What is drawn over the picture lies where it should: the axis cross and the cameras."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.scene import look_at
from splatview.viewer.overlays import ball_at, balls, pyramids

SEEN_BY = look_at((0, 0, -10), (0, 0, 0), up=(0, -1, 0), width=200, height=100)


def test_a_pyramid_begins_at_its_camera_and_opens_the_way_it_looks():
    camera = look_at((1, 0, 0), (5, 0, 0), up=(0, -1, 0), width=60, height=40)
    ((index, lines),) = pyramids([camera], SEEN_BY, 0.5)
    assert index == 0
    assert lines.shape == (8, 2, 2)
    eye = (SEEN_BY.fx * 1 / 10 + 100, 50)
    np.testing.assert_allclose(lines[:4, 0], [eye] * 4)
    assert (lines[:4, 1, 0] > eye[0]).all(), "it looks to +x, which is to the right"
    np.testing.assert_allclose(lines[4:, 0], lines[:4, 1])


def test_cameras_behind_or_at_the_eye_are_left_out():
    here = look_at((0, 0, -10), (0, 0, 0))
    behind = look_at((0, 0, -20), (0, 0, -30))
    before = look_at((0, 0, 0), (0, 0, 5))
    assert [index for index, _ in pyramids([here, behind, before], SEEN_BY, 0.5)] == [2]


def test_a_camera_shown_by_itself_spans_its_own_picture():
    camera = look_at((3, 2, 1), (0, 0, 0), width=120, height=80)
    back = look_at((3 + 3e-1, 2 + 2e-1, 1 + 1e-1), (0, 0, 0), width=120, height=80)
    ((_, lines),) = pyramids([camera], back, 1e4)
    np.testing.assert_allclose(lines[0, 1], (0, 0), atol=0.1)
    np.testing.assert_allclose(lines[2, 1], (120, 80), atol=0.1)


def test_the_cross_shows_where_the_axes_point():
    ends = {ball.name: ball for ball in balls(SEEN_BY.R_camera_world, 10.0)}
    assert (ends["+X"].x, ends["+X"].y) == pytest.approx((10, 0))
    assert (ends["-Y"].x, ends["-Y"].y) == pytest.approx((0, -10)), "-y is up here"
    assert ends["+Z"].depth == pytest.approx(1)


def test_the_front_ball_takes_the_click():
    ends = balls(SEEN_BY.R_camera_world, 10.0)
    found = ball_at(ends, 0.0, 0.0, 3.0)
    assert found is not None
    assert found.name == "-Z", "the one towards the eye, which lies over +Z"
    found = ball_at(ends, 9.0, 1.0, 3.0)
    assert found is not None
    assert found.name == "+X"
    assert ball_at(ends, 40.0, 40.0, 3.0) is None
