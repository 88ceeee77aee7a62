"""The classic strategy: what is cloned, split, kept and pruned, and what becomes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from splatview.raster import Parameters
from splatview.trainer.adam import SelectiveAdam
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import Splats
from splatview.trainer.strategies.default import (
    CLONE,
    KEEP,
    PRUNE,
    SPLIT,
    DefaultStrategy,
    decide,
    reset_opacities,
    split,
)
from splatview.trainer.strategies.ops import opacities_of

EXTENT = 2.0


def parameters_of(scales, opacities) -> Parameters:
    count = len(scales)
    rng = np.random.default_rng(0)
    logits = np.log(np.array(opacities) / (1 - np.array(opacities)))
    return Parameters(
        means=rng.normal(size=(count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=np.repeat(np.log(np.array(scales))[:, None], 3, axis=1).astype(np.float32),
        opacity_logits=logits.astype(np.float32),
        sh=rng.normal(size=(count, 4, 3)).astype(np.float32),
    )


class Scene:
    """Splats with what a strategy works on."""

    def __init__(self, scales, opacities, pulled, **options) -> None:
        self.splats = Splats(parameters_of(scales, opacities))
        self.optimizer = SelectiveAdam(self.splats, TrainSettings().rates(0, EXTENT))
        self.strategy = DefaultStrategy(TrainSettings(strategy="classic", **options))
        self.state = self.strategy.initialize_state(self.splats, extent=EXTENT)
        self.state["gradient_sums"][:] = 2 * np.array(pulled)
        self.state["view_counts"][:] = 2

    def refine(self, progress: float) -> Parameters:
        rng = np.random.default_rng(0)
        self.strategy.refine(self.splats, self.optimizer, self.state, progress, rng)
        return self.splats.arrays


def test_worked_example() -> None:
    actions = decide(
        np.array([0.09, 0.12, 0.01, 0.02]),
        np.array([0.008, 0.05, 0.02, 0.01]),
        np.array([0.6, 0.7, 0.5, 0.005]),
        gradient_threshold=0.05,
        scale_threshold=0.03,
        opacity_threshold=0.01,
    )
    assert actions.tolist() == [CLONE, SPLIT, KEEP, PRUNE]


@pytest.mark.parametrize("bad", range(3))
def test_splats_that_are_no_numbers_are_pruned(bad: int) -> None:
    values = [np.array([0.1, 0.1]), np.array([0.1, 0.1]), np.array([0.5, 0.5])]
    values[bad][0] = np.nan
    actions = decide(*values, gradient_threshold=0.05, scale_threshold=0.03, opacity_threshold=0.01)
    assert actions.tolist() == [PRUNE, SPLIT]


def test_refinement_does_what_was_decided() -> None:
    # Clone, split, keep, prune; the limits of scale are 0.01 and 0.1 of the extent.
    scene = Scene([0.01, 0.1, 0.1, 0.1], [0.6, 0.7, 0.5, 0.004], [1e-3, 1e-3, 1e-5, 1e-3])
    for group in (scene.optimizer.first, scene.optimizer.second):
        for array in group:
            array[:] = 1
    before = scene.splats.snapshot()
    after = scene.refine(0.05)
    # Kept in order, then clones, then both halves of what was split.
    assert len(scene.splats) == 5
    np.testing.assert_array_equal(after.means[:3], before.means[[0, 2, 0]])
    np.testing.assert_array_equal(after.sh[2:], before.sh[[0, 1, 1]])
    np.testing.assert_allclose(np.exp(after.log_scales[3:]), 0.1 / 1.6, rtol=1e-5)
    assert (after.means[3] != after.means[4]).all()
    for array in scene.optimizer.first:
        assert (array[:2] == 1).all() and (array[2:] == 0).all()
    counts = scene.state["view_counts"]
    assert (counts == 0).all() and len(counts) == 5


def test_halves_are_drawn_from_the_splat() -> None:
    one = parameters_of([1.0], [0.5])
    one.log_scales[0] = np.log([0.5, 0.1, 2.0])
    one.quats[0] = (math.cos(math.pi / 8), 0, 0, math.sin(math.pi / 8))  # 45° about z
    many = Parameters(*(np.repeat(array, 20_000, axis=0) for array in one))
    halves = split(many, np.random.default_rng(0))
    c = math.cos(math.pi / 4)
    rotation = np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]])
    expected = rotation @ np.diag([0.25, 0.01, 4.0]) @ rotation.T
    np.testing.assert_allclose(np.cov(halves.means.T), expected, atol=0.06)
    np.testing.assert_allclose(halves.means.mean(axis=0), one.means[0], atol=0.05)


def test_the_room_left_goes_to_those_pulled_most() -> None:
    scene = Scene([0.01] * 5, [0.5] * 5, [3e-3, 1e-3, 5e-3, 2e-3, 4e-3], max_splats=7)
    before = scene.splats.snapshot()
    after = scene.refine(0.05)
    assert len(scene.splats) == 7
    np.testing.assert_array_equal(after.means[5:], before.means[[2, 4]])


def test_a_reset_dims_all_once_each_period() -> None:
    scene = Scene([0.01] * 3, [0.9, 0.5, 0.008], [0, 0, 0])
    scene.optimizer.first.opacity_logits[:] = 1
    np.testing.assert_allclose(opacities_of(scene.refine(0.09)), [0.9, 0.5, 0.008], rtol=1e-5)
    np.testing.assert_allclose(opacities_of(scene.refine(0.11)), [0.01, 0.01, 0.008], rtol=1e-5)
    assert (scene.optimizer.first.opacity_logits == 0).all()
    scene.splats.arrays.opacity_logits[:] = 1
    assert (scene.refine(0.15).opacity_logits == 1).all()


def test_giants_go_after_the_first_reset() -> None:
    scene = Scene([0.01, 0.3], [0.9, 0.9], [0, 0])
    assert len(scene.refine(0.11).means) == 2
    reset_opacities(scene.splats, scene.optimizer)
    assert np.exp(scene.refine(0.12).log_scales).max() < 0.02


def test_a_scene_is_never_pruned_to_nothing() -> None:
    assert len(Scene([0.01] * 3, [0.001] * 3, [0, 0, 0]).refine(0.05).means) == 3


@pytest.mark.parametrize("absolute", [False, True])
def test_the_norms_of_a_picture_are_noted(make_trainer, absolute: bool) -> None:
    """By the numbers of the picture itself, in half images, while density control lasts."""
    trainer = make_trainer(strategy="classic", absolute_gradient=absolute)
    info, _ = trainer._render_and_backprop(trainer.views.at(0))
    found = info.abs_means2d if absolute else info.means2d
    norms = np.linalg.norm(found.numpy().astype(np.float64) * [24, 20], axis=1)
    seen = info.visible.numpy()
    np.testing.assert_allclose(trainer.state["gradient_sums"][seen], norms[seen], rtol=1e-6)
    assert norms.max() > 0
    np.testing.assert_array_equal(trainer.state["view_counts"], seen)
    trainer.counters.iteration = 150  # beyond
    trainer._render_and_backprop(trainer.views.at(1))
    np.testing.assert_array_equal(trainer.state["view_counts"], seen)
