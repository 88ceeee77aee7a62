"""Footprints cut off at some standard deviations: against the definition, written out."""

from __future__ import annotations

import numpy as np
import pytest

from splatview.raster import Workspace, draw_frame, parameters_of, render
from splatview.raster.gradients import differentiate
from splatview.scene import RenderSettings, look_at
from splatview.scene.projection import project

CAMERA = look_at((0.3, -0.4, -2.2), (0, 0, 0), up=(0, -1, 0), width=50, height=37)


def by_definition(gaussians, settings: RenderSettings, sigmas: float) -> np.ndarray:
    """(H, W, 4) float64, alpha being 0 beyond so many standard deviations."""
    f = project(gaussians, CAMERA, settings)
    x, y = np.meshgrid(np.arange(CAMERA.width) + 0.5, np.arange(CAMERA.height) + 0.5)
    colour, light = np.zeros((*x.shape, 3)), np.ones(x.shape)
    for mean, (a, b, c), opacity, rgb in zip(f.means2d, f.conic_factors, f.opacities, f.colours, strict=True):
        dx, dy = x - mean[0], y - mean[1]
        q = (a * dx + b * dy) ** 2 + (c * dy) ** 2
        alpha = np.minimum(settings.model.max_alpha, opacity * np.exp(-q / 2))
        alpha[(alpha < settings.model.alpha_cut) | (q > sigmas**2)] = 0
        colour += (alpha * light)[..., None] * rgb
        light *= 1 - alpha
    return np.concatenate([colour, 1 - light[..., None]], axis=2)


@pytest.mark.parametrize("sigmas", [1.0, 2.0, 3.0])
def test_alpha_ends_at_so_many_standard_deviations(random_gaussians, sigmas):
    scene = random_gaussians(300, seed=2)
    image = render(scene, CAMERA, RenderSettings(sigma_cut=sigmas, early_stop=0.0))
    difference = np.abs(image - by_definition(scene, RenderSettings(), sigmas))
    # Where a pixel lies on the cut to the last digit of float32, rounding decides.
    assert np.mean(difference.max(axis=2) > 1e-4) < 2e-3
    assert np.abs(image - render(scene, CAMERA)).max() > 0.01


def test_a_cut_beyond_the_alpha_cut_changes_nothing(random_gaussians):
    scene = random_gaussians(300, seed=2)
    np.testing.assert_array_equal(render(scene, CAMERA, RenderSettings(sigma_cut=9.0)), render(scene, CAMERA))


def test_it_has_no_gradients_and_says_so(random_gaussians):
    scene = parameters_of(random_gaussians(20))
    frame = draw_frame(scene, CAMERA, RenderSettings(sigma_cut=2.0), Workspace())
    with pytest.raises(ValueError, match="sigma_cut"):
        differentiate(scene, frame, np.zeros_like(frame.image))


@pytest.mark.parametrize("sigmas", [0.0, -1.0, float("nan")])
def test_only_a_positive_cut_is_one(sigmas):
    with pytest.raises(ValueError, match="sigma_cut"):
        RenderSettings(sigma_cut=sigmas)
