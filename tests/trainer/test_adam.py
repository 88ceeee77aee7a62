"""The fused optimiser against torch's Adam, and what it leaves alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from splatview.raster import Parameters
from splatview.trainer.adam import Rates, Regularisation, adam_step
from splatview.trainer.splats import fresh

RATES = Rates(1e-4, 1e-3, 5e-3, 5e-2, 2.5e-3, 1.25e-4)


def random_parameters(count: int, coefficients: int, scale: float, seed: int) -> Parameters:
    rng = np.random.default_rng(seed)
    shapes = [(count, 3), (count, 4), (count, 3), (count,), (count, coefficients, 3)]
    return Parameters(*(rng.normal(scale=scale, size=shape).astype(np.float32) for shape in shapes))


def copied(parameters: Parameters) -> Parameters:
    return Parameters(*(array.copy() for array in parameters))


def pieces(count: int) -> list[np.ndarray]:
    return np.array_split(np.arange(count, dtype=np.int32), 3)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_steps_are_those_of_torch(coefficients: int) -> None:
    start = random_parameters(50, coefficients, 1.0, 0)
    splats = fresh(copied(start))
    tensors = [torch.tensor(array, requires_grad=True) for array in start[:4]]
    constant = torch.tensor(start.sh[:, :1], requires_grad=True)
    others = torch.tensor(start.sh[:, 1:], requires_grad=True)
    groups = [
        {"params": [t], "lr": rate} for t, rate in zip([*tensors, constant, others], RATES, strict=True)
    ]
    reference = torch.optim.Adam(groups, eps=1e-15)
    for step in range(1, 8):
        gradients = random_parameters(50, coefficients, 10.0**-step, step)
        for tensor, gradient in zip(tensors, gradients[:4], strict=True):
            tensor.grad = torch.tensor(gradient)
        constant.grad, others.grad = torch.tensor(gradients.sh[:, :1]), torch.tensor(gradients.sh[:, 1:])
        reference.step()
        adam_step(splats, gradients, pieces(50), RATES, step, threads=2)
    expected = [*(t.detach().numpy() for t in tensors), torch.cat([constant, others], 1).detach().numpy()]
    for ours, theirs in zip(splats.parameters, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=2e-6)


def test_unseen_splats_rest() -> None:
    start = random_parameters(40, 16, 1.0, 0)
    splats = fresh(copied(start))
    seen = np.array([3, 7, 20], np.int32)
    adam_step(splats, random_parameters(40, 16, 1.0, 1), [seen], RATES, 1, threads=1)
    unseen = np.setdiff1d(np.arange(40), seen)
    for before, after, first in zip(start, splats.parameters, splats.first, strict=True):
        np.testing.assert_array_equal(after[unseen], before[unseen])
        assert (after[seen] != before[seen]).all()
        assert (first[unseen] == 0).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_a_gradient_that_is_no_number_moves_nothing_and_leaves_no_trace(bad: float) -> None:
    start = random_parameters(8, 16, 1.0, 0)
    splats = fresh(copied(start))
    gradients = random_parameters(8, 16, 1.0, 1)
    for array in gradients:
        array[2] = bad
    adam_step(splats, gradients, [np.arange(8, dtype=np.int32)], RATES, 1, threads=1)
    for before, after, second in zip(start, splats.parameters, splats.second, strict=True):
        np.testing.assert_array_equal(after[2], before[2])
        assert np.isfinite(after).all()
        assert (second[2] == 0).all()
        assert (after[3] != before[3]).all()


def test_pulls_are_gradients_of_mean_opacity_and_scale() -> None:
    start = random_parameters(10, 1, 1.0, 0)
    splats = fresh(copied(start))
    zeros = Parameters(*(np.zeros_like(array) for array in start))
    adam_step(
        splats, zeros, pieces(10), RATES, 1, regularisation=Regularisation(opacity=0.3, scale=0.6), threads=1
    )
    opacity = 1 / (1 + np.exp(-start.opacity_logits))
    # After one step the average is a tenth of the gradient.
    np.testing.assert_allclose(
        splats.first.opacity_logits, 0.1 * 0.3 / 10 * opacity * (1 - opacity), rtol=1e-5
    )
    np.testing.assert_allclose(splats.first.log_scales, 0.1 * 0.6 / 30 * np.exp(start.log_scales), rtol=1e-5)
    assert (splats.parameters.opacity_logits < start.opacity_logits).all()
    np.testing.assert_array_equal(splats.parameters.means, start.means)
    # Thin axes are left alone.
    thin = fresh(copied(start))
    least = float(np.exp(np.median(start.log_scales)))
    adam_step(
        thin,
        zeros,
        pieces(10),
        RATES,
        1,
        regularisation=Regularisation(scale=0.6, least_scale=least),
        threads=1,
    )
    pulled = thin.parameters.log_scales != start.log_scales
    np.testing.assert_array_equal(pulled, np.exp(start.log_scales) > least)
    assert pulled.any() and not pulled.all()


def test_no_splat_is_longer_than_it_may_be() -> None:
    start = random_parameters(60, 1, 1.5, 0)
    zeros = Parameters(*(np.zeros_like(array) for array in start))
    free, cut = fresh(copied(start)), fresh(copied(start))
    adam_step(free, zeros, pieces(60), RATES, 1, threads=1)
    adam_step(cut, zeros, pieces(60)[:2], RATES, 1, max_aspect=3.0, threads=1)
    np.testing.assert_array_equal(free.parameters.log_scales, start.log_scales)
    before, after = np.sort(start.log_scales, axis=1), np.sort(cut.parameters.log_scales, axis=1)
    long = before[:40, 2] > before[:40, 1] + np.log(3)
    assert long.any() and not long.all()
    np.testing.assert_array_equal(after[:40, :2], before[:40, :2])
    expected = np.minimum(before[:40, 2], before[:40, 1] + np.float32(np.log(3)))
    np.testing.assert_allclose(after[:40, 2], expected, rtol=1e-6)
    np.testing.assert_array_equal(after[40:], before[40:])
