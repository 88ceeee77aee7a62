"""Attributes in fewer bits: close to what they were, and ill values no better or worse than before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview.scene import Gaussians
from splatview.scene.attribute_formats import FORMATS, sh_levels, stored
from splatview.scene.projection import sigmoid

COARSE = FORMATS[1:]


def test_float32_is_the_scene_itself(random_gaussians):
    scene = random_gaussians(10)
    assert stored(scene, "float32") is scene


@pytest.mark.parametrize("attributes", COARSE)
def test_values_are_as_near_as_their_bits_allow(random_gaussians, attributes):
    scene = random_gaussians(500)
    made = stored(scene, attributes)
    half = 2.0**-11
    assert made.means is scene.means
    np.testing.assert_allclose(made.log_scales, scene.log_scales, rtol=half, atol=6e-8)
    np.testing.assert_allclose(sigmoid(made.opacity_logits), sigmoid(scene.opacity_logits), rtol=2 * half)
    unit = [quats / np.linalg.norm(quats, axis=1, keepdims=True) for quats in (made.quats, scene.quats)]
    np.testing.assert_allclose(*unit, atol=2 * half)
    np.testing.assert_allclose(made.sh[:, 0], scene.sh[:, 0], rtol=half, atol=6e-8)
    largest = np.abs(scene.sh[:, 1:]).max(axis=(1, 2), keepdims=True)
    bound = largest * (half if attributes == "float16" else 0.5 / 127 + 2 * half) + 6e-8
    assert (np.abs(made.sh - scene.sh)[:, 1:] <= bound).all()
    assert not np.array_equal(made.sh, scene.sh)


@pytest.mark.parametrize("attributes", COARSE)
def test_stored_twice_is_stored_once(random_gaussians, attributes):
    once = stored(random_gaussians(200), attributes)
    twice = stored(once, attributes)
    for name in ("log_scales", "quats", "sh"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(once, name), err_msg=name)


@pytest.mark.parametrize("attributes", COARSE)
def test_ill_values_stay_ill_and_extremes_stay_valid(random_gaussians, attributes):
    scene = random_gaussians(8)
    quats, logits, sh = scene.quats.copy(), scene.opacity_logits.copy(), scene.sh.copy()
    quats[0], quats[1], quats[2] = 0, 1e-25 * quats[1], (np.nan, 1, 0, 0)
    logits[3:6] = np.inf, -np.inf, np.nan
    sh[6, 5, 1], sh[7, 0, 0] = np.nan, 1e6
    made = stored(replace(scene, quats=quats, opacity_logits=logits, sh=sh), attributes)
    assert (made.quats[0] == 0).all()
    assert np.abs(made.quats[1]).max() == 1, "a tiny quaternion keeps its direction"
    assert np.isnan(made.quats[2]).any()
    assert made.opacity_logits[3] == np.inf
    assert made.opacity_logits[4] == -np.inf
    assert np.isnan(made.opacity_logits[5])
    assert np.isnan(made.sh[6]).any()
    assert 6e4 < made.sh[7, 0, 0] < np.inf


def test_tiny_coefficients_are_not_lost():
    sh = np.zeros((1, 4, 3), np.float32)
    sh[0, 1, 0] = 1e-7
    whole, steps = sh_levels(sh)
    assert whole[0, 0, 0] * float(steps[0]) == pytest.approx(1e-7, rel=0.5)


def test_a_scene_without_bands_has_nothing_to_round(random_gaussians):
    scene: Gaussians = random_gaussians(5, sh_degree=0)
    assert stored(scene, "8-bit-sh").sh.shape == (5, 1, 3)
    assert len(stored(scene.take(np.zeros(0, int)), "8-bit-sh")) == 0
