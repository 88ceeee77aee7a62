"""The sampling strategy: the dead move, the picture stays, the number grows, the faint wander."""

from __future__ import annotations

import math

import numpy as np
import pytest

from splatview.raster import Parameters
from splatview.trainer.adam import SelectiveAdam
from splatview.trainer.functional import Visibility
from splatview.trainer.settings import TrainSettings
from splatview.trainer.splats import Splats
from splatview.trainer.strategies.mcmc import (
    DEAD,
    LEAST_SHARED,
    NOISE_EXTENT,
    MCMCStrategy,
    occurrences,
    room,
    shared,
)
from splatview.trainer.strategies.ops import opacities_of


def splats_of(opacities) -> Splats:
    count = len(opacities)
    rng = np.random.default_rng(0)
    opacities = np.array(opacities)
    return Splats(
        Parameters(
            means=rng.normal(size=(count, 3)).astype(np.float32),
            quats=rng.normal(size=(count, 4)).astype(np.float32),
            log_scales=rng.normal(-1, 1, size=(count, 3)).astype(np.float32),
            opacity_logits=np.log(opacities / (1 - opacities)).astype(np.float32),
            sh=rng.normal(size=(count, 1, 3)).astype(np.float32),
        )
    )


class Scene:
    """Splats with what a strategy works on."""

    def __init__(self, opacities, **options) -> None:
        self.splats = splats_of(opacities)
        self.optimizer = SelectiveAdam(self.splats, TrainSettings().rates(0, 1.0), threads=1)
        self.strategy = MCMCStrategy(TrainSettings(strategy="mcmc", **options))
        self.state = self.strategy.initialize_state(self.splats, extent=NOISE_EXTENT)

    def refine(self, progress: float) -> Splats:
        rng = np.random.default_rng(0)
        self.strategy.refine(self.splats, self.optimizer, self.state, progress, rng)
        return self.splats

    def shake(self, pieces: list[np.ndarray], rate: float, step: int) -> np.ndarray:
        """The means after the noise of a step, at the run's end, where nothing is refined."""
        self.optimizer.rates = self.optimizer.rates._replace(means=rate)
        info = Visibility(pieces, len(self.splats))
        self.strategy.step_post_backward(self.splats, self.optimizer, self.state, step, info, progress=0.99)
        return self.splats.arrays.means


@pytest.mark.parametrize("copies", [1, 2, 5, 51])
@pytest.mark.parametrize("opacity", [0.01, 0.5, 0.99])
def test_copies_together_look_like_the_one(copies: int, opacity: float) -> None:
    each, shrink = shared(np.array([opacity]), np.array([copies]))
    assert 1 - (1 - each[0]) ** copies == pytest.approx(opacity, rel=1e-9)
    # Along a line through the middle: the integral of alpha is kept.
    x = np.linspace(-40, 40, 40_001)
    together = 1 - (1 - each[0] * np.exp(-0.5 * (x / shrink[0]) ** 2)) ** copies
    alone = opacity * np.exp(-0.5 * x**2)
    assert together.sum() == pytest.approx(alone.sum(), rel=1e-6)


def test_the_dead_move_onto_the_living() -> None:
    scene = Scene([0.9, 0.001, 0.5, 0.002, 0.8], max_splats=5)
    before = scene.splats.snapshot()
    for group in (scene.optimizer.first, scene.optimizer.second):
        for array in group:
            array[:] = 1
    refined = scene.refine(0.1)
    assert len(refined) == 5
    alive = before.means[[0, 2, 4]]
    for dead in (1, 3):
        assert (refined.arrays.means[dead] == alive).all(axis=1).any()
        assert scene.optimizer.first.means[dead].tolist() == [0, 0, 0]
    np.testing.assert_array_equal(refined.arrays.means[[0, 2, 4]], alive)
    assert (opacities_of(refined.arrays) > DEAD).all()
    moved_onto = [i for i in (0, 2, 4) if (refined.arrays.means[[1, 3]] == before.means[i]).all(1).any()]
    for i in moved_onto:
        assert refined.arrays.opacity_logits[i] < before.opacity_logits[i]


def test_the_number_grows_by_even_factors_to_the_limit() -> None:
    scene = Scene([0.5] * 100, max_splats=1600, refine_from=0.1, grow_for=0.4)
    counts = [scene.strategy.count_at(progress, 100) for progress in (0, 0.1, 0.2, 0.3, 0.5, 1)]
    assert counts == [100, 100, 200, 400, 1600, 1600]
    assert len(scene.refine(0.3)) == 200, "no more than twice as many at once"
    assert len(scene.refine(0.3)) == 400
    assert Scene([0.5], max_splats=10).strategy.count_at(0.9, 100) == 100


def test_a_splat_is_shared_as_far_as_its_copies_are_seen() -> None:
    """Fainter copies would be dead soon, and moved onto others, which they would make fainter in turn."""
    opacities = [0.9] * 3 + [0.3] * 5 + [0.1] * 5 + [1.5 * LEAST_SHARED] * 50 + [0.001] * 50
    scene = Scene(opacities, max_splats=10_000, refine_from=0.1, grow_for=0.4)
    before = Parameters(*(array.copy() for array in scene.splats.arrays))
    faint = slice(13, 63)
    for _ in range(20):
        scene.refine(0.9)
    refined = scene.splats.arrays
    living = np.flatnonzero(opacities_of(refined) > DEAD)
    assert opacities_of(refined)[living].min() >= LEAST_SHARED * (1 - 1e-4)
    np.testing.assert_array_equal(refined.opacity_logits[faint], before.opacity_logits[faint])
    assert room(opacities_of(refined)).max() == 0
    assert 100 < len(living) <= 50 - np.log1p(-np.array(opacities[:13])).sum() / -math.log1p(-LEAST_SHARED)
    # Copies together are as opaque as the splat was.
    absorbed = [-np.log1p(-opacities_of(arrays)).sum() for arrays in (before, refined)]
    assert absorbed[1] == pytest.approx(absorbed[0], rel=1e-2)


def test_room_of_splats_and_what_occurs_before() -> None:
    two, three = (1 - (1 - LEAST_SHARED) ** copies for copies in (2, 3))
    opacities = np.array([0.0, LEAST_SHARED, two - 1e-6, two + 1e-6, three + 1e-6, 1.0])
    assert room(opacities).tolist() == [0, 0, 0, 1, 2, room(np.array([1 - 1e-6]))[0]]
    assert occurrences(np.array([3, 1, 3, 3, 1, 0])).tolist() == [0, 0, 1, 2, 1, 0]
    assert occurrences(np.array([], np.int64)).tolist() == []


def test_a_scene_of_the_dead_is_left_alone() -> None:
    scene = Scene([0.001, 0.001])
    before = scene.splats.means
    assert scene.refine(0.1).means is before


def test_noise_has_the_shape_of_the_splat_and_spares_the_opaque() -> None:
    count = 40_000
    scene = Scene([0.001] * count, noise=2.0)
    parameters = scene.splats.arrays
    parameters.log_scales[:] = np.log([0.5, 0.1, 1.0])
    parameters.quats[:] = (math.cos(math.pi / 8), 0, 0, math.sin(math.pi / 8))  # 45° about z
    parameters.opacity_logits[::2] = 3.0
    before = parameters.means.copy()
    shift = (scene.shake([np.arange(count, dtype=np.int32)], 0.5, 7) - before).astype(np.float64)
    assert (shift[::2] == 0).all()
    c = math.cos(math.pi / 4)
    rotation = np.array([[c, -c, 0], [c, c, 0], [0, 0, 1]])
    fade = 1 / (1 + math.exp(-100 * (1 - 0.001 - 0.995)))
    expected = rotation @ np.diag([0.25, 0.01, 1.0]) @ rotation.T  # noise is covariance · normal
    np.testing.assert_allclose(np.cov(shift[1::2].T), (fade * expected) @ (fade * expected).T, atol=0.02)
    np.testing.assert_allclose(shift[1::2].mean(axis=0), 0, atol=0.02)


@pytest.mark.parametrize("unit", [1e-2, 30.0, 1e3])
def test_noise_is_the_same_in_any_unit(unit: float) -> None:
    """A capture in millimetres explores as one in metres does; rates are times the extent."""

    def moved(unit: float) -> np.ndarray:
        scene = Scene([0.001] * 300)
        scene.state["extent"] *= unit
        parameters = scene.splats.arrays
        parameters.means[:] = 0
        parameters.log_scales[:] = np.log([0.05, 0.01, 0.1]) + math.log(unit)
        return scene.shake([np.arange(300, dtype=np.int32)], 1e-4 * unit, 3) / unit

    metres = moved(1.0)
    assert np.abs(metres).max() > 1e-3
    np.testing.assert_allclose(moved(unit), metres, rtol=1e-4, atol=1e-9)


def test_noise_depends_on_seed_and_step_only() -> None:
    def moved(step: int, seed: int, pieces: int, threads: int) -> np.ndarray:
        scene = Scene([0.01] * 500, seed=seed)
        scene.optimizer.threads = threads
        return scene.shake(np.array_split(np.arange(500, dtype=np.int32), pieces), 1e-6, step)

    np.testing.assert_array_equal(moved(3, 1, 1, 1), moved(3, 1, 7, 2))
    assert (moved(3, 1, 1, 1) != moved(4, 1, 1, 1)).any()
    assert (moved(3, 1, 1, 1) != moved(3, 2, 1, 1)).any()
