"""Pictures and gradients in float64, of a scene in float32: the same recipe, with fewer roundings."""

from __future__ import annotations

import numpy as np
import torch


def gradient_of(tensor: torch.Tensor) -> np.ndarray:
    assert tensor.grad is not None
    return tensor.grad.numpy()


def test_a_step_in_float64_is_nearly_that_in_float32(make_trainer) -> None:
    single, double = make_trainer(), make_trainer()
    double.picture_dtype = np.float64
    (info32, loss32), (info64, loss64) = (
        each._render_and_backprop(each.views.at(0, 1)) for each in (single, double)
    )
    g32, g64 = ([gradient_of(tensor) for tensor in each.splats.parameters()] for each in (single, double))
    assert abs(loss32 - loss64) < 1e-5 * max(loss64, 1e-3) + 1e-6
    assert [len(each) for each in info32.pieces] == [len(each) for each in info64.pieces]
    differ = 0.0
    for ours, truth in zip(g32, g64, strict=True):
        assert truth.dtype == np.float32
        rows = info64.indices.numpy()
        scale = np.abs(truth[rows]).max()
        differ += np.abs(ours[rows] - truth[rows]).max()
        assert np.abs(ours[rows] - truth[rows]).max() <= 2e-3 * scale + 1e-9
    assert differ > 0
    double.step()
    assert all(array.dtype == np.float32 for array in double.splats.arrays)
