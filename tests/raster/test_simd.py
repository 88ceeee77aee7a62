"""The vectors that kernels are written in, against numpy."""

from __future__ import annotations

import math

import numpy as np
import pytest

from splatview.raster import blocks, simd
from splatview.raster import exponentials as exp
from splatview.raster.compiling import inline


@inline
def exponentials(numbers, out):
    x = simd.load(numbers, 0)
    simd.store(out, 0, exp.exp2(x))


@inline
def exponentials_of_blocks(numbers, constants, out):
    blocks.place_exp2_constants(constants, 0)
    simd.store(out, 0, blocks.exp2_by(blocks.exp2_constants(constants, 0), simd.load_block(numbers, 0)))


@inline
def sums_of_blocks(numbers, out):
    x, y = simd.load_block(numbers, 0), simd.load_block(numbers, simd.BLOCK_LANES)
    simd.store(out, 0, simd.sum_lanes((x, y, x + y, y, x, x, y, y, x + x, y, x)))


@inline
def listed(sets, members, out):
    total = 0
    for j in range(len(sets)):
        blocks.store_members(out, total, members, sets[j], 100 * j)
        total += blocks.count_bits(sets[j])
    return total


@inline
def exact(numbers, pictures, out):
    x = simd.load(numbers, 0)
    simd.store(out, 0, exp.exp_lanes(x, pictures))
    simd.store(out, simd.LANES, exp.log2_lanes(abs(x), pictures))


@inline
def arithmetic(numbers, out):
    x = simd.load(numbers, 0)
    y = (1 - 2 * (x * x + x)) / (3.0 + abs(x)) - -x
    simd.store(out, 0, y)
    simd.store(out, simd.LANES, math.sqrt(max(y, 0.5)))
    simd.store(out, 2 * simd.LANES, min(0.25, y))
    ones = simd.fill(x, 1)
    simd.store(out, 3 * simd.LANES, simd.keep_if_at_least(ones, x, y) + simd.keep_if_below(ones, x, y))


@inline
def sums(numbers, out):
    x, y = simd.load(numbers, 0), simd.load(numbers, simd.LANES)
    simd.store(out, 0, simd.sum_lanes((x, y, x + y)))
    simd.store(out, simd.LANES, simd.sum_lanes((x, y, x, y, x, y, x, y, x, y, x, y, x, y, x, y)))
    simd.store(out, 2 * simd.LANES, simd.sum_lanes((y,)))


@pytest.mark.parametrize(("dtype", "error"), [(np.float32, 4e-6), (np.float64, 1e-14)])
def test_exp2(dtype, error):
    for numbers in np.linspace(-100, 100, 64 * 16).astype(dtype).reshape(-1, 16):
        out = np.empty(16, dtype)
        exponentials(numbers, out)
        assert np.abs(out / np.exp2(numbers.astype(np.float64)) - 1).max() <= error


@pytest.mark.parametrize(("dtype", "error"), [(np.float32, 6e-11), (np.float64, 1e-14)])
def test_exp_and_log2(dtype, error):
    out, pictures = np.empty(32), np.empty(1, dtype)
    for numbers in np.linspace(-40, 41, 64 * 16).reshape(-1, 16):
        exact(numbers, pictures, out)
        assert np.abs(out[:16] / np.exp(numbers) - 1).max() <= error
        assert np.abs(out[16:] - np.log2(np.abs(numbers))).max() <= error
    tiny = 10.0 ** np.linspace(-300, 300, 16)
    exact(tiny, pictures, out)
    assert np.abs(out[16:] / np.log2(tiny) - 1).max() <= error


@pytest.mark.parametrize(("dtype", "error"), [(np.float32, 1.2e-10), (np.float64, 1e-15)])
def test_exp_at_the_ends(dtype, error):
    """Every kind of NaN stays NaN, and what is too large or too small stops at the last normal number; just
    below it an error counts twice, where numbers are half as dense."""
    numbers = np.array([np.nan, np.inf, -np.inf, 1e300, -1e300, 800, -800, 0] * 2)
    numbers[8] = np.array([0x7FF8000000000FFF], np.uint64).view(np.float64)[0]
    out = np.empty(32)
    exact(numbers, np.empty(1, dtype), out)
    assert np.isnan(out[[0, 8]]).all()
    assert np.allclose(out[[1, 3, 5]], 2.0**1023, rtol=error)
    assert np.allclose(out[[2, 4, 6]], 2.0**-1022, rtol=error, atol=0)
    assert np.isclose(out[7], 1, rtol=error)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_arithmetic(dtype):
    numbers = np.linspace(-2, 3, 16).astype(dtype)
    numbers[3] = np.nan
    out = np.empty(64, dtype)
    arithmetic(numbers, out)
    y = (1 - 2 * (numbers * numbers + numbers)) / (3 + np.abs(numbers)) + numbers
    tolerance = 16 * np.finfo(dtype).eps
    valid = np.arange(16) != 3
    assert np.allclose(out[:16], y, rtol=tolerance, atol=tolerance, equal_nan=True)
    assert np.allclose(out[16:32][valid], np.sqrt(np.maximum(y, 0.5))[valid], rtol=tolerance)
    assert np.allclose(out[32:48][valid], np.minimum(0.25, y)[valid], rtol=tolerance, atol=tolerance)
    assert np.array_equal(out[48:], valid.astype(dtype))  # NaN is neither at least nor below


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sums_over_lanes(dtype):
    numbers = np.arange(1, 33).astype(dtype)
    out = np.empty(48, dtype)
    sums(numbers, out)
    x, y = numbers[:16].sum(), numbers[16:].sum()
    assert out[:3].tolist() == [x, y, x + y]
    assert (out[3:16] == 0).all()
    assert out[16:32].tolist() == [x, y] * 8
    assert out[32] == y


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_sums_of_blocks(dtype):
    numbers = np.arange(1, 2 * simd.BLOCK_LANES + 1).astype(dtype)
    out = np.full(simd.LANES, np.nan, dtype)
    sums_of_blocks(numbers, out)
    x, y = numbers[: simd.BLOCK_LANES].sum(), numbers[simd.BLOCK_LANES :].sum()
    assert out.tolist() == [x, y, x + y, y, x, x, y, y, x + x, y, x, 0, 0, 0, 0, 0]


@pytest.mark.parametrize(("dtype", "error"), [(np.float32, 4e-6), (np.float64, 1e-14)])
def test_exp2_of_blocks(dtype, error):
    constants = np.full(blocks.EXP2_CONSTANTS, np.nan, dtype)
    for numbers in np.linspace(-100, 100, 640).astype(dtype).reshape(-1, simd.BLOCK_LANES):
        out = np.empty(simd.BLOCK_LANES, dtype)
        exponentials_of_blocks(numbers, constants, out)
        assert np.abs(out / np.exp2(numbers.astype(np.float64)) - 1).max() <= error


def test_sets_are_listed():
    sets = np.array([0b10110, 0, 0xFF, 1], np.uint64)
    out = np.zeros(64, np.int32)
    total = listed(sets, blocks.MEMBERS.reshape(-1), out)
    assert out[:total].tolist() == [1, 2, 4, *range(200, 208), 300]
