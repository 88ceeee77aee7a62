"""A picture that is not the truth is found out."""

from __future__ import annotations

import numpy as np

from splatview.measure.ladder import AGREEMENT, disagreement
from splatview.scene import RenderSettings
from splatview.scene.demo import demo_camera, demo_scene
from splatview.scene.reference import render


def test_the_reference_agrees_with_itself_and_not_with_others():
    scene, camera = demo_scene(splats=300), demo_camera(30, 20)
    settings = RenderSettings(background=(0.1, 0.2, 0.3))
    picture = render(scene, camera, settings)
    assert disagreement(picture, scene, camera, settings) <= 1e-12
    assert disagreement(picture + 2 * AGREEMENT, scene, camera, settings) > AGREEMENT
    broken = picture.copy()
    broken[:] = np.nan
    assert not disagreement(broken, scene, camera, settings) <= AGREEMENT
