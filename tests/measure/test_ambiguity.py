"""The explanation of outlier pixels: finds what is ambiguous, and does not excuse what is not."""

from __future__ import annotations

import numpy as np

from splatview.measure.hard_cases.run import ambiguity_at, unexplained_pixels
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.projection import project
from splatview.scene.reference import render

CAMERA = look_at((0, 0, -2), (0, 0, 0), width=9, height=9)


def discs(depths: list[float], colours: list[float], logit: float = 0.0) -> Gaussians:
    n = len(depths)
    means = np.zeros((n, 3), dtype=np.float32)
    means[:, 2] = depths
    sh = np.zeros((n, 1, 3), dtype=np.float32)
    sh[:, 0, :] = np.array(colours, dtype=np.float32)[:, None]
    return Gaussians(
        means=means,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        log_scales=np.full((n, 3), -1.0, dtype=np.float32),
        opacity_logits=np.full(n, logit, dtype=np.float32),
        sh=sh,
    )


def test_a_tie_of_different_colours_swings_and_a_clear_order_does_not():
    settings = RenderSettings()
    tied = project(discs([0.0, 1e-6], [-1.5, 1.5]), CAMERA, settings)
    apart = project(discs([0.0, 0.1], [-1.5, 1.5]), CAMERA, settings)
    assert ambiguity_at(tied, 4, 4, settings).depth_ties == 1
    assert ambiguity_at(tied, 4, 4, settings).swing > 0.1
    assert ambiguity_at(apart, 4, 4, settings).swing == 0


def test_an_alpha_on_the_cut_swings_by_about_the_cut():
    settings = RenderSettings()
    logit = float(np.log((1 / 255 * 1.00001) / (1 - 1 / 255)))
    centred = look_at((0, 0, -2), (0, 0, 0), width=9, height=9)
    ambiguity = ambiguity_at(project(discs([0.0], [1.7], logit), centred, settings), 4, 4, settings)
    assert ambiguity.on_cut == 1
    assert 0.5 / 255 < ambiguity.swing < 2 / 255


def test_an_error_without_a_cause_is_reported_and_one_with_a_cause_is_counted():
    scene, settings = discs([0.0, 1e-6], [-1.5, 1.5]), RenderSettings()
    truth = render(scene, CAMERA, settings)
    other_order = render(discs([1e-6, 0.0], [-1.5, 1.5]), CAMERA, settings)
    assert unexplained_pixels(truth, truth, scene, CAMERA, settings, bound=1e-6) == ([], 0)
    unexplained, explained = unexplained_pixels(other_order, truth, scene, CAMERA, settings, bound=0.01)
    assert not unexplained
    assert explained > 0
    broken = truth.copy()
    broken[4, 4, 0] += 0.9
    assert unexplained_pixels(broken, truth, scene, CAMERA, settings, bound=0.01)[0] == [(4, 4)]
