"""Depth order: one stable radix sort of 32-bit keys (Knuth, TAOCP 3, 5.2.5), least digit first.

A key is the depth's float64 bits, counted from the nearest visible depth and shifted until the farthest
fits into 32 bits. Bits of positive floats are in the order of the floats, so the keys are too; and as
they spend no bits on depths that do not occur, they tell apart depths that agree in float32.
"""

from __future__ import annotations

import numpy as np

from .compiling import inline, kernel
from .pool import even_ranges, run
from .workspace import Workspace

DIGIT_BITS = 11
"""At most so many bits a pass: 2048 write positions stay in the first-level caches."""

PARALLEL_FROM = 1 << 15
"""Below so many keys one thread is faster than sharing the work."""


@inline
def _ordered_bits(bits):
    """Bits of a float64 as an int64 that sorts like the float, negative ones included."""
    return bits ^ ((bits >> 63) & 0x7FFFFFFFFFFFFFFF)


def key_scale(least: float, greatest: float, most_bits: int = 32) -> tuple[int, int, int]:
    """(base, shift, bits) for depths in [least, greatest]: key = (ordered bits - base) >> shift < 2^bits,
    bits being at most `most_bits`."""
    low, high = (int(np.float64(depth).view(np.int64)) for depth in (least, greatest))
    low, high = (value ^ ((value >> 63) & 0x7FFFFFFFFFFFFFFF) for value in (low, high))
    span = (high - low).bit_length()
    shift = max(span - most_bits, 0)
    return low, shift, span - shift


@kernel
def make_keys(start, stop, source, visible, depth_bits, base, shift, keys, order):
    """Gathers visible[source:source + stop - start] to order[start:stop] (int32) with their keys (uint32).

    depth_bits (N,) int64: the depths' bits.
    """
    for k in range(start, stop):
        splat = visible[source + k - start]
        order[k] = splat
        keys[k] = np.uint32((_ordered_bits(depth_bits[splat]) - base) >> shift)


@kernel
def _count(start, stop, histogram, keys, shift, mask):
    histogram[:] = 0
    for k in range(start, stop):
        histogram[(keys[k] >> shift) & mask] += 1


@kernel
def _positions(histograms):
    """Turns counts (pieces, digits) int64 into where each piece writes its first key of each digit."""
    total = 0
    for digit in range(histograms.shape[1]):
        for piece in range(histograms.shape[0]):
            count = histograms[piece, digit]
            histograms[piece, digit] = total
            total += count


@kernel
def _scatter(start, stop, positions, keys, values, shift, mask, keys_out, values_out):
    for k in range(start, stop):
        digit = (keys[k] >> shift) & mask
        to = positions[digit]
        positions[digit] = to + 1
        keys_out[to] = keys[k]
        values_out[to] = values[k]


def radix_sort(
    keys: np.ndarray, values: np.ndarray, bits: int, threads: int, workspace: Workspace
) -> tuple[np.ndarray, np.ndarray]:
    """Sorts keys (V,) uint32 below 2^bits ascending, values (V,) int32 along; equal keys keep their order.

    Returns the sorted pair: the arrays given or buffers of the workspace; the others' contents are lost.
    """
    count = len(keys)
    if count < 2 or bits < 1:
        return keys, values
    pieces = even_ranges(count, threads if count >= PARALLEL_FROM else 1)
    passes = -(-bits // DIGIT_BITS)
    width = -(-bits // passes)
    mask = np.uint32((1 << width) - 1)
    positions = np.empty((len(pieces), 1 << width), np.int64)
    keys_out = workspace.take("keys_out", keys.shape, keys.dtype)
    values_out = workspace.take("values_out", values.shape, values.dtype)
    for number in range(passes):
        shift = np.uint32(number * width)
        tasks = [(*piece, row) for piece, row in zip(pieces, positions, strict=True)]
        run(_count, tasks, (keys, shift, mask), threads)
        _positions(positions)
        run(_scatter, tasks, (keys, values, shift, mask, keys_out, values_out), threads)
        keys, keys_out, values, values_out = keys_out, keys, values_out, values
    return keys, values
