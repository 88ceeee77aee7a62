"""The fused optimiser against torch's Adam, and what it leaves alone."""

from __future__ import annotations

import io

import numpy as np
import pytest
import torch

from splatview.raster import Parameters
from splatview.trainer.adam import SelectiveAdam
from splatview.trainer.adam_kernels import REST_DIVISOR, Rates
from splatview.trainer.splats import Splats, copied

RATES = Rates(1e-4, 1e-3, 5e-3, 5e-2, 2.5e-3)


def random_parameters(count: int, coefficients: int, scale: float, seed: int) -> Parameters:
    rng = np.random.default_rng(seed)
    shapes = [(count, 3), (count, 4), (count, 3), (count,), (count, coefficients, 3)]
    return Parameters(*(rng.normal(scale=scale, size=shape).astype(np.float32) for shape in shapes))


def given(splats: Splats, gradients: Parameters) -> None:
    """Sets the gradients, to copies."""
    for tensor, gradient in zip(splats.parameters(), gradients, strict=True):
        tensor.grad = torch.tensor(gradient)


def zeros_like(parameters: Parameters) -> Parameters:
    return Parameters(*(np.zeros_like(array) for array in parameters))


def pieces(count: int) -> list[np.ndarray]:
    return np.array_split(np.arange(count, dtype=np.int32), 3)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_steps_are_those_of_torch(coefficients: int) -> None:
    start = random_parameters(50, coefficients, 1.0, 0)
    splats = Splats(copied(start))
    optimizer = SelectiveAdam(splats, RATES, threads=2)
    tensors = [torch.tensor(array, requires_grad=True) for array in start[:4]]
    constant = torch.tensor(start.sh[:, :1], requires_grad=True)
    others = torch.tensor(start.sh[:, 1:], requires_grad=True)
    groups = [
        {"params": [t], "lr": rate}
        for t, rate in zip([*tensors, constant, others], (*RATES, RATES.sh / REST_DIVISOR), strict=True)
    ]
    reference = torch.optim.Adam(groups, eps=1e-15)
    for step in range(1, 8):
        gradients = random_parameters(50, coefficients, 10.0**-step, step)
        for tensor, gradient in zip(tensors, gradients[:4], strict=True):
            tensor.grad = torch.tensor(gradient)
        constant.grad, others.grad = torch.tensor(gradients.sh[:, :1]), torch.tensor(gradients.sh[:, 1:])
        reference.step()
        given(splats, gradients)
        optimizer.step(pieces(50) if step % 2 else None)
    assert optimizer.steps == 7
    expected = [*(t.detach().numpy() for t in tensors), torch.cat([constant, others], 1).detach().numpy()]
    for ours, theirs in zip(splats.arrays, expected, strict=True):
        np.testing.assert_allclose(ours, theirs, atol=2e-6)


@pytest.mark.parametrize("kind", ["pieces", "indices", "mask"])
def test_unseen_splats_rest(kind: str) -> None:
    start = random_parameters(40, 16, 1.0, 0)
    splats = Splats(copied(start))
    optimizer = SelectiveAdam(splats, RATES, threads=1)
    seen = np.array([3, 7, 20], np.int32)
    mask = torch.zeros(40, dtype=torch.bool)
    mask[seen] = True
    given(splats, random_parameters(40, 16, 1.0, 1))
    optimizer.step({"pieces": [seen], "indices": torch.tensor([3, 7, 20]), "mask": mask}[kind])
    unseen = np.setdiff1d(np.arange(40), seen)
    for before, after, first in zip(start, splats.arrays, optimizer.first, strict=True):
        np.testing.assert_array_equal(after[unseen], before[unseen])
        assert (after[seen] != before[seen]).all()
        assert (first[unseen] == 0).all()


def test_what_names_no_splats_is_refused() -> None:
    splats = Splats(random_parameters(5, 1, 1.0, 0))
    optimizer, before = SelectiveAdam(splats, RATES), splats.arrays.means.copy()
    for wrong in (torch.ones(4, dtype=torch.bool), torch.tensor([5]), torch.tensor([-1]), torch.ones(5)):
        with pytest.raises(ValueError, match="visible must"):
            optimizer.step(wrong)
    np.testing.assert_array_equal(splats.arrays.means, before)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30])
def test_a_gradient_that_is_no_number_moves_nothing_and_leaves_no_trace(bad: float) -> None:
    start = random_parameters(40, 16, 1.0, 0)
    splats = Splats(copied(start))
    optimizer, gradients = SelectiveAdam(splats, RATES), random_parameters(40, 16, 1.0, 1)
    wrong = [2, 38]  # in a block of splats, and in what is left over
    for array in gradients:
        array[wrong] = bad
    given(splats, gradients)
    optimizer.step()
    for before, after, second in zip(start, splats.arrays, optimizer.second, strict=True):
        np.testing.assert_array_equal(after[wrong], before[wrong])
        assert np.isfinite(after).all()
        assert (second[wrong] == 0).all()
        assert (after[3] != before[3]).all()


@pytest.mark.parametrize("bad", [0.0, np.nan, 1e30])
def test_means_move_in_proportion_to_how_far_they_are(bad: float) -> None:
    start, gradients = random_parameters(61, 4, 1.0, 0), random_parameters(61, 4, 1.0, 1)
    start.means[:30] *= 50  # in whole blocks and in the rest after the last one
    start.means[7, 1] += bad
    plain, far = Splats(copied(start)), Splats(copied(start))
    centre, radius = np.array([1.0, -2.0, 0.5]), 4.0
    for splats in (plain, far):
        given(splats, gradients)
        optimizer = SelectiveAdam(splats, RATES._replace(means=1e-2), threads=1)
        if splats is far:
            optimizer.set_options("means", middle=centre, distance=radius / 0.5, far_from=0.5)
        optimizer.step()
    for name, a, b in zip(Parameters._fields[1:], plain.arrays[1:], far.arrays[1:], strict=True):
        np.testing.assert_array_equal(a, b, err_msg=name)
    with np.errstate(over="ignore"):
        reach = np.maximum(np.linalg.norm(start.means.astype(np.float64) - centre, axis=1) / radius, 1)
    assert (reach[[*range(6), *range(8, 30)]] > 1).sum() > 20 and (reach[30:] == 1).sum() > 20
    usable = np.isfinite(start.means).all(axis=1) & (np.abs(start.means) < 1e6).all(axis=1)
    moved = (far.arrays.means.astype(np.float64) - start.means)[usable]
    expected = -1e-2 * reach[usable, None] * np.sign(gradients.means[usable])  # Adam's first step
    np.testing.assert_allclose(moved, expected, atol=2e-5)  # float32 beside places of some 100
    near = reach == 1
    np.testing.assert_array_equal(far.arrays.means[near], plain.arrays.means[near])


def test_pulls_are_gradients_of_mean_opacity_and_scale() -> None:
    start = random_parameters(40, 1, 1.0, 0)
    splats = Splats(copied(start))
    optimizer = SelectiveAdam(splats, RATES, threads=1)
    optimizer.set_options("opacity_logits", reg=0.3)
    optimizer.set_options("log_scales", reg=0.6)
    optimizer.step()  # without any gradient
    opacity = 1 / (1 + np.exp(-start.opacity_logits))
    # After one step the average is a tenth of the gradient.
    first = optimizer.first
    np.testing.assert_allclose(first.opacity_logits, 0.1 * 0.3 / 40 * opacity * (1 - opacity), rtol=1e-5)
    np.testing.assert_allclose(first.log_scales, 0.1 * 0.6 / 120 * np.exp(start.log_scales), rtol=1e-5)
    assert (splats.arrays.opacity_logits < start.opacity_logits).all()
    np.testing.assert_array_equal(splats.arrays.means, start.means)
    # Thin axes are left alone.
    thin = Splats(copied(start))
    optimizer, least = SelectiveAdam(thin, RATES), float(np.exp(np.median(start.log_scales)))
    optimizer.set_options("log_scales", reg=0.6, least=least)
    optimizer.step()
    pulled = thin.arrays.log_scales != start.log_scales
    np.testing.assert_array_equal(pulled, np.exp(start.log_scales) > least)
    assert pulled.any() and not pulled.all()


def test_no_splat_is_longer_than_it_may_be() -> None:
    start = random_parameters(60, 1, 1.5, 0)
    free, cut = Splats(copied(start)), Splats(copied(start))
    SelectiveAdam(free, RATES).step()
    SelectiveAdam(cut, RATES, max_aspect=3.0).step(pieces(60)[:2])
    np.testing.assert_array_equal(free.arrays.log_scales, start.log_scales)
    before, after = np.sort(start.log_scales, axis=1), np.sort(cut.arrays.log_scales, axis=1)
    long = before[:40, 2] > before[:40, 1] + np.log(3)
    assert long.any() and not long.all()
    np.testing.assert_array_equal(after[:40, :2], before[:40, :2])
    expected = np.minimum(before[:40, 2], before[:40, 1] + np.float32(np.log(3)))
    np.testing.assert_allclose(after[:40, 2], expected, rtol=1e-6)
    np.testing.assert_array_equal(after[40:], before[40:])


def test_a_saved_optimiser_goes_on_bit_for_bit() -> None:
    start = random_parameters(20, 4, 1.0, 0)
    whole, file = Splats(copied(start)), io.BytesIO()
    optimizer = SelectiveAdam(whole, RATES, max_aspect=4.0)
    for step in range(6):
        if step == 3:
            torch.save({"splats": whole.state_dict(), "optimizer": optimizer.state_dict()}, file)
        given(whole, random_parameters(20, 4, 1.0, step))
        optimizer.step()
    file.seek(0)
    saved = torch.load(file, weights_only=True)
    resumed = Splats(copied(start))
    resumed.load_state_dict(saved["splats"])
    again = SelectiveAdam(resumed, Rates(1, 1, 1, 1, 1))
    again.load_state_dict(saved["optimizer"])
    for step in range(3, 6):
        given(resumed, random_parameters(20, 4, 1.0, step))
        again.step()
    assert again.rates == RATES and again.steps == 6
    for ours, theirs in zip(resumed.arrays, whole.arrays, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_schedulers_closures_and_stale_pictures_are_as_with_other_optimisers() -> None:
    splats = Splats(random_parameters(20, 4, 1.0, 0))
    optimizer = SelectiveAdam(splats, RATES)
    scheduler = torch.optim.lr_scheduler.ExponentialLR(optimizer, 0.5)
    norm = splats.means.square().sum()
    kept = splats.means.square().sum()

    def closure() -> torch.Tensor:
        optimizer.zero_grad()
        norm.backward()
        return norm

    assert optimizer.step(closure=closure) is norm
    scheduler.step()
    assert optimizer.rates.means == RATES.means / 2 and optimizer.rates.sh == RATES.sh / 2
    with pytest.raises(RuntimeError, match="modified"):
        kept.backward()
