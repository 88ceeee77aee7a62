"""The arrays of a scene to rows of packed files, in an order of their own: no copy of the scene is made.

`scene` is the arrays of a `Gaussians`, in its order of fields; row i of an output is splat `order[i]`.
Everything is rounded to the nearest step in float64.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.scene.formats.kernels.compiling import inline, kernel
from splatview.scene.sh import SH_C0

SQRT_2 = math.sqrt(2.0)


@kernel
def find_storable(start, stop, scene, kept):
    """Marks splats whose every value is finite as float32 and whose quaternion has a length (a logit may be
    infinite), and returns the bounds of their means, low and high, as six numbers."""
    means, quats, log_scales, logits, sh = scene
    low_x, low_y, low_z, high_x, high_y, high_z = np.inf, np.inf, np.inf, -np.inf, -np.inf, -np.inf
    for i in range(start, stop):
        # x - x is 0 for all numbers but infinities and NaN, for which it is NaN.
        wrong = np.float64(0)
        for axis in range(3):
            place = np.float32(means[i, axis])
            wrong += (place - place) + (log_scales[i, axis] - log_scales[i, axis])
        longest = np.float32(0)
        for axis in range(4):
            wrong += quats[i, axis] - quats[i, axis]
            longest = max(longest, abs(quats[i, axis]))
        for k in range(sh.shape[1]):
            for channel in range(3):
                wrong += sh[i, k, channel] - sh[i, k, channel]
        good = wrong == 0 and longest > 0 and logits[i] == logits[i]
        kept[i] = good
        if good:
            x, y, z = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
            low_x, high_x = min(low_x, x), max(high_x, x)
            low_y, high_y = min(low_y, y), max(high_y, y)
            low_z, high_z = min(low_z, z), max(high_z, z)
    return low_x, low_y, low_z, high_x, high_y, high_z


@inline
def _spread(x):
    """21 bits with two zeros after each."""
    x = (x | (x << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    x = (x | (x << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    x = (x | (x << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    x = (x | (x << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (x | (x << np.uint64(2))) & np.uint64(0x1249249249249249)


@kernel
def morton_keys(start, stop, means, kept, low, scale, keys):
    """Places of splats `kept` along a Z-curve of 2^21 steps a side, from `low` (3,), `scale` (3,) steps per
    unit."""
    for row in range(start, stop):
        i = kept[row]
        x = _spread(np.uint64((means[i, 0] - low[0]) * scale[0]))
        y = _spread(np.uint64((means[i, 1] - low[1]) * scale[1]))
        z = _spread(np.uint64((means[i, 2] - low[2]) * scale[2]))
        keys[row] = x | (y << np.uint64(1)) | (z << np.uint64(2))


@kernel
def sort_by_keys(keys, values, other_keys, other_values):
    """Sorts `values` by `keys` (N,) uint64 of 63 bits, equal ones in the order in which they come; the result
    is in `values`. The others are room of the same size. 11 bits a pass: six passes are an even number."""
    n = len(keys)
    counts = np.zeros((6, 2048), np.int64)
    for i in range(n):
        key = keys[i]
        for digit in range(6):
            counts[digit, (key >> np.uint64(11 * digit)) & np.uint64(2047)] += 1
    for digit in range(6):
        at = 0
        for value in range(2048):
            count = counts[digit, value]
            counts[digit, value] = at
            at += count
        shift = np.uint64(11 * digit)
        for i in range(n):
            value = (keys[i] >> shift) & np.uint64(2047)
            place = counts[digit, value]
            counts[digit, value] = place + 1
            other_keys[place] = keys[i]
            other_values[place] = values[i]
        keys, other_keys = other_keys, keys
        values, other_values = other_values, values


@inline
def _level(value, most):
    """The whole number nearest to `value`, 0 to `most`."""
    return np.uint32(min(max(np.rint(value), 0.0), most))


@inline
def _opacity(logit):
    """Level of 255."""
    return _level(255.0 / (1.0 + math.exp(-np.float64(logit))), 255.0)


@inline
def _three(quats, i):
    """Index of the largest component of a quaternion, and the others in order, in [-1, 1] of their range
    ±sqrt(1/2), the largest made positive."""
    most = max(abs(quats[i, 0]), abs(quats[i, 1]), abs(quats[i, 2]), abs(quats[i, 3]))
    # By the largest component first: squares of 1e-30 vanish, those of 1e30 overflow.
    a, b = np.float64(quats[i, 0]) / most, np.float64(quats[i, 1]) / most
    c, d = np.float64(quats[i, 2]) / most, np.float64(quats[i, 3]) / most
    scale = SQRT_2 / math.sqrt(a * a + b * b + c * c + d * d)
    if abs(a) == 1:
        scale = math.copysign(scale, a)
        return 0, b * scale, c * scale, d * scale
    if abs(b) == 1:
        scale = math.copysign(scale, b)
        return 1, a * scale, c * scale, d * scale
    if abs(c) == 1:
        scale = math.copysign(scale, c)
        return 2, a * scale, b * scale, d * scale
    scale = math.copysign(scale, d)
    return 3, a * scale, b * scale, c * scale


@inline
def _ten_bits(value):
    """Size and sign of a number in [-1, 1]."""
    return _level(abs(value) * 511, 511.0) | (np.uint32(512) if value < 0 else np.uint32(0))


@kernel
def encode_spz(start, stop, order, scene, frame, steps, blocks):
    """`frame`: units per world unit with the sign of each axis as one factor (3,) float64, the turn (4,), the
    sign of each SH coefficient. `steps`: of each SH coefficient, in 128ths. `blocks`: outputs (N, ...) by the
    order of the file, bytes but for rotations, uint32 (N,)."""
    means, quats, log_scales, logits, sh = scene
    units, turn, signs = frame
    positions, alphas, colours, scales, rotations, rest = blocks
    turned = np.empty((1, 4), np.float32)
    w1, x1, y1, z1 = turn[0], turn[1], turn[2], turn[3]
    for row in range(start, stop):
        i = order[row]
        for axis in range(3):
            word = np.uint32(np.int32(np.rint(means[i, axis] * units[axis])))
            positions[row, 3 * axis] = word & np.uint32(255)
            positions[row, 3 * axis + 1] = (word >> np.uint32(8)) & np.uint32(255)
            positions[row, 3 * axis + 2] = (word >> np.uint32(16)) & np.uint32(255)
            scales[row, axis] = _level((np.float64(log_scales[i, axis]) + 10) * 16, 255.0)
            colours[row, axis] = _level((np.float64(sh[i, 0, axis]) * 0.15 + 0.5) * 255, 255.0)
        alphas[row] = _opacity(logits[i])
        w2, x2, y2, z2 = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        turned[0, 3] = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
        turned[0, 0] = w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2
        turned[0, 1] = w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2
        turned[0, 2] = w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
        largest, a, b, c = _three(turned, 0)
        rotations[row] = (
            np.uint32(largest) << np.uint32(30)
            | _ten_bits(a) << np.uint32(20)
            | _ten_bits(b) << np.uint32(10)
            | _ten_bits(c)
        )
        for k in range(1, sh.shape[1]):
            step = np.float64(steps[k])
            for channel in range(3):
                # Whole steps from 128 on: 0 stays 0, which most coefficients nearly are.
                value = np.rint(np.float64(sh[i, k, channel]) * signs[k] * 128 / step) * step + 128
                rest[row, 3 * (k - 1) + channel] = np.uint8(min(max(value, 128 % step), 256 - step))


@inline
def _bits(value, low, high, most):
    """How far `value` is from `low` to `high`, as a whole number up to `most`."""
    width = np.float64(high) - np.float64(low)
    share = (np.float64(value) - np.float64(low)) / (width if width > 0 else 1.0)
    return _level(share * most, most)


@kernel
def encode_compressed_ply(start, stop, order, scene, limits, bounds, words, rest):
    """`limits`: the largest log-scale, and the width of the range of coefficients. Chunks are of 256 splats,
    which their lowest and highest values go with."""
    means, quats, log_scales, logits, sh = scene
    largest_log, sh_range = limits
    per_channel = sh.shape[1] - 1
    low, high = np.empty(9, np.float32), np.empty(9, np.float32)
    values = np.empty((256, 9), np.float32)
    for chunk in range(start >> 8, (stop + 255) >> 8):
        first = chunk << 8
        size = min(first + 256, stop) - first
        low[:] = np.inf
        high[:] = -np.inf
        for j in range(size):
            i = order[first + j]
            for axis in range(3):
                values[j, axis] = means[i, axis]
                values[j, 3 + axis] = min(max(np.float64(log_scales[i, axis]), -largest_log), largest_log)
                values[j, 6 + axis] = 0.5 + SH_C0 * np.float64(sh[i, 0, axis])
            for column in range(9):
                low[column] = min(low[column], values[j, column])
                high[column] = max(high[column], values[j, column])
        for group in range(3):
            for axis in range(3):
                bounds[chunk, 6 * group + axis] = low[3 * group + axis]
                bounds[chunk, 6 * group + 3 + axis] = high[3 * group + axis]
        for j in range(size):
            row = first + j
            i = order[row]
            for column, at in ((0, 0), (2, 3)):
                words[row, column] = (
                    _bits(values[j, at], low[at], high[at], 2047.0) << np.uint32(21)
                    | _bits(values[j, at + 1], low[at + 1], high[at + 1], 1023.0) << np.uint32(11)
                    | _bits(values[j, at + 2], low[at + 2], high[at + 2], 2047.0)
                )
            largest, a, b, c = _three(quats, i)
            words[row, 1] = (
                np.uint32(largest) << np.uint32(30)
                | _level((a + 1) * 511.5, 1023.0) << np.uint32(20)
                | _level((b + 1) * 511.5, 1023.0) << np.uint32(10)
                | _level((c + 1) * 511.5, 1023.0)
            )
            words[row, 3] = (
                _bits(values[j, 6], low[6], high[6], 255.0) << np.uint32(24)
                | _bits(values[j, 7], low[7], high[7], 255.0) << np.uint32(16)
                | _bits(values[j, 8], low[8], high[8], 255.0) << np.uint32(8)
                | _opacity(logits[i])
            )
            for k in range(per_channel):
                for channel in range(3):
                    level = math.floor((np.float64(sh[i, 1 + k, channel]) / sh_range + 0.5) * 256)
                    rest[row, channel * per_channel + k] = np.uint8(min(max(level, 0.0), 255.0))
