"""Scenes between two levels of merging: fine steps of time for a frame budget."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from splatview import raster
from splatview.renderers.quality import FINE_STEP, Mixer, Shortcut, badness, mixtures_of, squared_error
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.lod import chances, levels_and_cells

CAMERA = look_at((0, 0.5, -3), (0, 0, 0), width=96, height=64)


@pytest.fixture(scope="module")
def dense(random_gaussians) -> Gaussians:
    """Small opaque splats in a small ball, which merge well."""
    made = random_gaussians(4000)
    return replace(made, log_scales=made.log_scales * 0 - 2.5, opacity_logits=made.opacity_logits * 0 + 4)


@pytest.fixture(scope="module")
def mixer(dense) -> Mixer:
    coarser, cell = next(levels_and_cells(dense))
    return Mixer(dense, coarser, cell)


def drawn(scene: Gaussians) -> np.ndarray:
    return raster.render(scene, CAMERA, RenderSettings())


def test_its_ends_are_the_levels(mixer):
    assert len(mixer.scene(0.0)) == len(mixer.finer)
    assert len(mixer.scene(1.0)) == len(mixer.coarser)


def test_nothing_is_left_out_and_nothing_twice(mixer, dense):
    of_members, of_merged = (chances(dense, mixer._cell, each) for each in (mixer.finer, mixer.coarser))
    assert set(of_merged.tolist()) <= set(of_members.tolist()), "a merged splat is in its members' cube"
    assert of_members.min() >= 0 and of_members.max() < 1
    half = mixer.scene(0.5)
    assert len(half) == np.count_nonzero(of_members >= 0.5) + np.count_nonzero(of_merged < 0.5)
    covered = drawn(mixer.finer)[..., 3] > 0.99
    assert (drawn(half)[..., 3][covered] > 0.9).all(), "no hole"


def test_errors_lie_between_those_of_the_levels(mixer):
    full = drawn(mixer.finer)[..., :3]
    errors = [
        squared_error(drawn(mixer.scene(merged))[..., :3], full) for merged in (0.0, 0.25, 0.5, 0.75, 1.0)
    ]
    assert errors[0] == 0 and errors == sorted(errors)
    assert errors[2] == pytest.approx(errors[4] / 2, rel=0.4), "in proportion"


def test_few_are_kept(mixer):
    first = mixer.scene(0.1)
    assert mixer.scene(0.1) is first
    for merged in (0.2, 0.3, 0.4):
        mixer.scene(merged)
    assert mixer.scene(0.1) is not first


def test_ill_splats_have_a_place_too(dense):
    ill = replace(dense, means=dense.means.copy())
    ill.means[:3] = np.nan, np.inf, 1e30
    found = chances(ill, 0.1, ill)
    assert ((found >= 0) & (found < 1)).all()


def test_their_times_are_a_tenth_apart(mixer):
    finer, coarser = (
        Shortcut(gaussians=scene, kept=share, scale=1.0, ms=ms, error=error)
        for scene, share, ms, error in ((mixer.finer, 1.0, 90.0, 0.0), (mixer.coarser, 0.5, 41.0, 1e-3))
    )
    between = mixtures_of(finer, coarser, mixer)
    times = np.array([90.0, *(one.ms for one in between), 41.0])
    assert (times[:-1] / times[1:] < FINE_STEP + 1e-9).all() and (np.diff(times) < 0).all()
    assert all(0 < one.merged < 1 and 0 < badness(one) < 1e-3 and 0.5 < one.kept < 1 for one in between)
    assert mixtures_of(coarser, finer, mixer) == []
