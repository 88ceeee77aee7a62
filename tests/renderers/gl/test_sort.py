"""The GPU sort against numpy's stable argsort."""

from __future__ import annotations

import moderngl
import numpy as np
import pytest

from splatview.renderers.gl.sort import HARDWARE, SOFTWARE, RadixSort, SortTuning
from splatview.scene import InputError

TUNINGS = {
    "software": SOFTWARE,
    "hardware": HARDWARE,
    "odd": SortTuning(digit_bits=8, workgroup=3, keys_per_invocation=7),
}
UNTOUCHED = 0xDEADBEEF


@pytest.fixture(params=TUNINGS)
def tuning(request: pytest.FixtureRequest) -> SortTuning:
    return TUNINGS[request.param]


def run_sort(ctx: moderngl.Context, keys: np.ndarray, tuning: SortTuning) -> tuple[np.ndarray, np.ndarray]:
    """Sorts keys with their indices as values; both as they are afterwards."""
    sorter = RadixSort(ctx, len(keys), tuning=tuning)
    key_buffer, value_buffer = ctx.buffer(keys), ctx.buffer(np.arange(len(keys), dtype=np.uint32))
    count = ctx.buffer(np.array([len(keys)], np.uint32))
    sorter.sort(key_buffer, value_buffer, count)
    sorted_keys, order = (np.frombuffer(buffer.read(), np.uint32) for buffer in (key_buffer, value_buffer))
    for thing in (sorter, key_buffer, value_buffer, count):
        thing.release()
    return sorted_keys, order


def check(ctx: moderngl.Context, keys: np.ndarray, tuning: SortTuning) -> None:
    sorted_keys, order = run_sort(ctx, keys, tuning)
    expected = np.argsort(keys, kind="stable")
    np.testing.assert_array_equal(order, expected)
    np.testing.assert_array_equal(sorted_keys, keys[expected])


def test_a_million_random_keys(ctx, rng, tuning):
    check(ctx, rng.integers(0, 2**32, 1_000_003, dtype=np.uint32), tuning)


def test_ten_million_random_keys(ctx, rng):
    check(ctx, rng.integers(0, 2**32, 10_000_000, dtype=np.uint32), SOFTWARE)


ORDERS = {
    "all equal": lambda n, rng: np.full(n, 0x3F800000),
    "all zero": lambda n, rng: np.zeros(n),
    "all ones": lambda n, rng: np.full(n, 0xFFFFFFFF),
    "sorted": lambda n, rng: np.arange(n) * 40_000,
    "reversed": lambda n, rng: np.arange(n)[::-1] * 40_000,
    "alternating extremes": lambda n, rng: np.arange(n) % 2 * 0xFFFFFFFF,
    "alternating top bit": lambda n, rng: (np.arange(n) % 2 << 31) + np.arange(n)[::-1],
    "few distinct": lambda n, rng: rng.choice([0, 1, 255, 256, 0x10000, 0xFFFFFFFE, 0xFFFFFFFF], n),
    "sawtooth": lambda n, rng: np.arange(n) % 257 << 12,
    "one bit each": lambda n, rng: 1 << (np.arange(n) % 32),
}


@pytest.mark.parametrize("order", ORDERS)
def test_adversarial_orders(ctx, rng, tuning, order):
    check(ctx, ORDERS[order](50_021, rng).astype(np.uint32), tuning)


@pytest.mark.parametrize("parity", [0, 1])
def test_every_size_to_5000_leaves_the_rest_alone(ctx, rng, parity):
    """One sorter, counts known to the GPU alone; keys from few values so that stability matters too."""
    capacity, offset = 5000, 12
    sorter = RadixSort(ctx, capacity, tuning=SortTuning(digit_bits=8, workgroup=8, keys_per_invocation=64))
    keys = rng.choice(rng.integers(0, 2**32, 900, dtype=np.uint32), capacity + 1)
    key_buffer, value_buffer = ctx.buffer(reserve=4 * capacity + 4), ctx.buffer(reserve=4 * capacity + 4)
    counts = ctx.buffer(np.zeros(4, np.uint32))
    values = np.arange(capacity + 1, dtype=np.uint32)
    for size in range(parity, capacity + 1, 2):
        key_buffer.write(keys)
        value_buffer.write(values)
        counts.write(np.uint32(size).tobytes(), offset=offset)
        sorter.sort(key_buffer, value_buffer, counts, offset)
        expected = np.concatenate([np.argsort(keys[:size], kind="stable"), values[size:]])
        order = np.frombuffer(value_buffer.read(), np.uint32)
        assert (order == expected).all(), f"values at size {size}"
        assert (np.frombuffer(key_buffer.read(), np.uint32) == keys[expected]).all(), f"keys at size {size}"
    for thing in (sorter, key_buffer, value_buffer, counts):
        thing.release()


@pytest.mark.parametrize("size", [0, 1, 7, 8, 9, 4095, 4096, 4097, 8191, 8192, 8193, 24577])
def test_sizes_around_blocks(ctx, rng, tuning, size):
    if size:
        check(ctx, rng.integers(0, 2**32, size, dtype=np.uint32), tuning)
        return
    sorter = RadixSort(ctx, 0, tuning=tuning)
    buffers = [ctx.buffer(np.array([value], np.uint32)) for value in (UNTOUCHED, UNTOUCHED, 0)]
    sorter.sort(*buffers)
    assert np.frombuffer(buffers[0].read(), np.uint32)[0] == UNTOUCHED


def test_a_count_above_capacity_is_the_capacity(ctx):
    sorter = RadixSort(ctx, 4)
    keys = ctx.buffer(np.array([4, 3, 2, 1, 0], np.uint32))
    values = ctx.buffer(np.arange(5, dtype=np.uint32))
    sorter.sort(keys, values, ctx.buffer(np.array([99], np.uint32)))
    assert list(np.frombuffer(keys.read(), np.uint32)) == [1, 2, 3, 4, 0]
    assert list(np.frombuffer(values.read(), np.uint32)) == [3, 2, 1, 0, 4]


def test_bad_arguments(ctx):
    sorter = RadixSort(ctx, 4)
    short, long = ctx.buffer(reserve=12), ctx.buffer(reserve=16)
    with pytest.raises(ValueError, match="keys must hold 4"):
        sorter.sort(short, long, long)
    with pytest.raises(ValueError, match="values must hold 4"):
        sorter.sort(long, short, long)
    with pytest.raises(ValueError, match="multiple of 4"):
        sorter.sort(long, long, long, 3)
    with pytest.raises(ValueError, match="negative"):
        RadixSort(ctx, -1)
    with pytest.raises(InputError, match="more than this OpenGL driver can sort"):
        RadixSort(ctx, 2**40)
