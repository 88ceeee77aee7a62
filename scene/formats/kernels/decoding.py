"""Rows of packed files to the arrays of a scene.

Tables hold what every byte or word of few bits means. Outputs are those of `Gaussians`, all of as many rows
as there are splats, `sh` as rows (N, 3 x coefficients); each call fills rows [start, stop).
"""

from __future__ import annotations

import numpy as np

from splatview.scene.formats.kernels.compiling import inline, kernel
from splatview.scene.sh import SH_C0


@inline
def _whole(a, b, c):
    """The component that makes the length of a quaternion 1; 0 for damaged ones, which are too long."""
    return np.sqrt(max(np.float32(1) - (a * a + b * b + c * c), np.float32(0)))


@inline
def _others(largest):
    """Places of the three other components, in order. Comparisons, not branches: which is the largest is
    noise, and guessing it wrong takes twice as long as all the rest."""
    return np.int64(largest == 0), 1 + np.int64(largest <= 1), 2 + np.int64(largest <= 2)


@inline
def _put_smallest_three(a, b, c, largest, quats, i):
    """Row i of `quats`: components a, b and c in order, and where `largest` says the one that makes the
    length 1."""
    first, second, third = _others(largest)
    quats[i, np.int64(largest)] = _whole(a, b, c)
    quats[i, first] = a
    quats[i, second] = b
    quats[i, third] = c


@inline
def _between(low, high, t):
    return low * (1 - t) + high * t


@kernel
def decode_compressed_ply(start, stop, bounds, words, rest, shares, tables, out):
    """`words` (stop - start, 4): position, rotation, scale, colour of these rows alone; `rest`: bytes of
    their SH, by channel. `shares`: tables of whole numbers of 11, 10 and 8 bits as shares of the largest,
    float64; chunks are of 256 splats, which `start` is a multiple of."""
    means, quats, log_scales, logits, sh = out
    quat_table, logit_table, sh_table = tables
    per_channel = rest.shape[1] // 3
    eleven, ten, eight = shares
    coloured = bounds.shape[1] == 18
    low, high = np.zeros(9), np.ones(9)
    for chunk in range(start >> 8, (stop + 255) >> 8):
        for group in range(2 + coloured):
            for axis in range(3):
                low[3 * group + axis] = bounds[chunk, 6 * group + axis]
                high[3 * group + axis] = bounds[chunk, 6 * group + 3 + axis]
        # Bounds in variables, not in arrays that the outputs might be: a fifth less time.
        low_x, low_y, low_z, low_u, low_v, low_w = low[0], low[1], low[2], low[3], low[4], low[5]
        high_x, high_y, high_z, high_u, high_v, high_w = high[0], high[1], high[2], high[3], high[4], high[5]
        low_r, low_g, low_b, high_r, high_g, high_b = low[6], low[7], low[8], high[6], high[7], high[8]
        for i in range(chunk << 8, min((chunk + 1) << 8, stop)):
            row = i - start
            position, rotation, scale, colour = words[row, 0], words[row, 1], words[row, 2], words[row, 3]
            means[i, 0] = _between(low_x, high_x, eleven[position >> np.uint32(21)])
            means[i, 1] = _between(low_y, high_y, ten[(position >> np.uint32(11)) & np.uint32(1023)])
            means[i, 2] = _between(low_z, high_z, eleven[position & np.uint32(2047)])
            log_scales[i, 0] = _between(low_u, high_u, eleven[scale >> np.uint32(21)])
            log_scales[i, 1] = _between(low_v, high_v, ten[(scale >> np.uint32(11)) & np.uint32(1023)])
            log_scales[i, 2] = _between(low_w, high_w, eleven[scale & np.uint32(2047)])
            _put_smallest_three(
                quat_table[(rotation >> np.uint32(20)) & np.uint32(1023)],
                quat_table[(rotation >> np.uint32(10)) & np.uint32(1023)],
                quat_table[rotation & np.uint32(1023)],
                rotation >> np.uint32(30),
                quats,
                i,
            )
            red, green = colour >> np.uint32(24), (colour >> np.uint32(16)) & np.uint32(255)
            blue = (colour >> np.uint32(8)) & np.uint32(255)
            sh[i, 0] = (_between(low_r, high_r, eight[red]) - 0.5) / SH_C0
            sh[i, 1] = (_between(low_g, high_g, eight[green]) - 0.5) / SH_C0
            sh[i, 2] = (_between(low_b, high_b, eight[blue]) - 0.5) / SH_C0
            logits[i] = logit_table[colour & np.uint32(255)]
            for k in range(per_channel):
                for channel in range(3):
                    sh[i, 3 + 3 * k + channel] = sh_table[rest[row, channel * per_channel + k]]


@kernel
def decode_spz(start, stop, blocks, kinds, tables, frame, out):
    """`blocks`: those of the file by order, bytes (N, ...), rotations of four bytes as uint32 (N, 1).
    `kinds`: whether positions are whole numbers (else `means` has them), and whether rotations are three
    bytes. `frame`: the unit of positions and the sign of each axis as one factor (3,); the column of each
    component x, y, z, w of a quaternion, and its sign (4,); the factor of each number of SH.

    A loop for each attribute: LLVM makes vectors of those that are simple, which takes half the time of one
    loop for all."""
    positions, alphas, colours, scales, rotations, rest = blocks
    whole_positions, three_bytes = kinds
    logit_table, colour_table, scale_table, quat_table = tables
    units, places, signs, factors = frame
    means, quats, log_scales, logits, sh = out
    for i in range(start, stop):
        for axis in range(3):
            if whole_positions:
                at = 3 * axis
                # The sign is in the highest byte of three: shifting back from the top brings it along.
                word = (
                    np.uint32(positions[i, at]) << np.uint32(8)
                    | np.uint32(positions[i, at + 1]) << np.uint32(16)
                    | np.uint32(positions[i, at + 2]) << np.uint32(24)
                )
                means[i, axis] = np.float32(np.int32(word) >> np.int32(8)) * units[axis]
            else:
                means[i, axis] *= units[axis]
            log_scales[i, axis] = scale_table[scales[i, axis]]
        logits[i] = logit_table[alphas[i]]
    for i in range(start, stop):
        if three_bytes:
            a, b, c = (
                quat_table[rotations[i, 0]],
                quat_table[rotations[i, 1]],
                quat_table[rotations[i, 2]],
            )
            largest = np.int64(3)
        else:
            word = np.uint32(rotations[i, 0])
            a, b, c = (
                quat_table[(word >> np.uint32(20)) & np.uint32(1023)],
                quat_table[(word >> np.uint32(10)) & np.uint32(1023)],
                quat_table[word & np.uint32(1023)],
            )
            largest = np.int64(word >> np.uint32(30))
        first, second, third = _others(largest)
        quats[i, places[largest]] = _whole(a, b, c) * signs[largest]
        quats[i, places[first]] = a * signs[first]
        quats[i, places[second]] = b * signs[second]
        quats[i, places[third]] = c * signs[third]
    for i in range(start, stop):
        for channel in range(3):
            sh[i, channel] = colour_table[colours[i, channel]]
        for j in range(len(factors)):
            sh[i, 3 + j] = np.float32(np.int32(rest[i, j]) - 128) * factors[j]


@kernel
def decode_sog(start, stop, texels, palette, tables, out):
    """`texels`: pictures as rows of RGBA or RGB, those of SH labels last. `palette`: (entries + 1, 3 x
    coefficients) SH of each label, the last for all labels beyond. `tables`: of means (3, 65536), of scales
    and colours (3, 256)."""
    lower, upper, rotations, sizes, colours, labels = texels
    mean_table, quat_table, scale_table, colour_table, logit_table = tables
    means, quats, log_scales, logits, sh = out
    last = np.uint32(len(palette) - 1)
    for i in range(start, stop):
        for axis in range(3):
            means[i, axis] = mean_table[axis, np.uint32(upper[i, axis]) << np.uint32(8) | lower[i, axis]]
            log_scales[i, axis] = scale_table[axis, sizes[i, axis]]
        logits[i] = logit_table[colours[i, 3]]
    for i in range(start, stop):
        if rotations[i, 3] < 252:
            quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3] = 1, 0, 0, 0
        else:
            _put_smallest_three(
                quat_table[rotations[i, 0]],
                quat_table[rotations[i, 1]],
                quat_table[rotations[i, 2]],
                np.int64(rotations[i, 3]) - 252,
                quats,
                i,
            )
    for i in range(start, stop):
        for channel in range(3):
            sh[i, channel] = colour_table[channel, colours[i, channel]]
        label = min(np.uint32(labels[i, 1]) << np.uint32(8) | np.uint32(labels[i, 0]), last)
        for j in range(palette.shape[1]):
            sh[i, 3 + j] = palette[label, j]
