"""The path at whose end a picture is measured that depends on those before."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.measure.knobs import PATH_TURN, Plan, knob, path_to_view
from splatview.scene import RenderSettings, look_at
from splatview.scene.camera import orbited
from splatview.scene.order_reuse import ResortPolicy

CAMERA = look_at((1, -0.5, -3), (0, 0, 0), up=(0, -1, 0), width=8, height=6)
UP = np.array((0.0, -1.0, 0.0))


def test_where_every_frame_has_its_own_order_there_is_only_the_view():
    assert path_to_view(RenderSettings()) == (0.0,)


@pytest.mark.parametrize("value", [v.text for v in knob("resort").values])
def test_on_its_path_the_first_frame_alone_is_sorted_and_the_next_would_be(value):
    settings = knob("resort").value(value).apply(Plan()).settings
    path = (*path_to_view(settings), PATH_TURN)
    assert path[-2] == 0 and np.allclose(np.diff(path), PATH_TURN)
    resort_policy = ResortPolicy()
    due = [
        resort_policy.due(
            orbited(CAMERA, np.zeros(3), UP, degrees), settings, key=None, centre=np.zeros(3), radius=1.0
        )
        for degrees in path
    ]
    assert due == [True, *[False] * (len(path) - 2), True]


def test_the_older_an_order_may_be_the_longer_its_path():
    lengths = [len(path_to_view(v.apply(Plan()).settings)) for v in knob("resort").values]
    assert lengths[0] == 1 and lengths == sorted(lengths) and lengths[-1] > 10


def test_a_camera_turned_about_a_point_sees_it_in_the_same_place():
    turned = orbited(CAMERA, np.zeros(3), UP, 30.0)
    assert np.linalg.norm(turned.eye) == pytest.approx(np.linalg.norm(CAMERA.eye))
    before, after = (c.R_camera_world @ -c.eye for c in (CAMERA, turned))
    np.testing.assert_allclose(before, after, atol=1e-12)
    cosine = np.dot(CAMERA.eye[[0, 2]], turned.eye[[0, 2]]) / np.dot(CAMERA.eye[[0, 2]], CAMERA.eye[[0, 2]])
    assert np.degrees(np.arccos(cosine)) == pytest.approx(30)
