"""Rows of packed files to the arrays of a scene.

Tables hold what every byte or word of few bits means. Outputs are those of `Gaussians`, all of as many rows
as there are splats; each call fills rows [start, stop).
"""

from __future__ import annotations

import numpy as np

from splatview.scene.formats.kernels.compiling import inline, kernel
from splatview.scene.sh import SH_C0


@inline
def _put_smallest_three(a, b, c, largest, quats, i):
    """Row i of `quats`: components a, b and c in order, and where `largest` says the one that makes the
    length 1. Damaged ones, too long for a unit quaternion, get 0 there."""
    whole = np.sqrt(max(np.float32(1) - (a * a + b * b + c * c), np.float32(0)))
    quats[i, 0] = whole if largest == 0 else a
    quats[i, 1] = whole if largest == 1 else (a if largest == 0 else b)
    quats[i, 2] = whole if largest == 2 else (c if largest == 3 else b)
    quats[i, 3] = whole if largest == 3 else c


@inline
def _between(low, high, t):
    return low * (1 - t) + high * t


@kernel
def decode_compressed_ply(start, stop, bounds, words, rest, shares, tables, out):
    """`words` (N, 4): position, rotation, scale, colour. `shares`: two tables of whole numbers of 11 and of
    10 bits as shares of the largest, float64; chunks are of 256 splats, which `start` is a multiple of."""
    means, quats, log_scales, logits, sh = out
    quat_table, logit_table, sh_table = tables
    per_channel = rest.shape[1] // 3
    eleven, ten = shares
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
            position, rotation, scale, colour = words[i, 0], words[i, 1], words[i, 2], words[i, 3]
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
            sh[i, 0, 0] = (_between(low_r, high_r, red / 255) - 0.5) / SH_C0
            sh[i, 0, 1] = (_between(low_g, high_g, green / 255) - 0.5) / SH_C0
            sh[i, 0, 2] = (_between(low_b, high_b, blue / 255) - 0.5) / SH_C0
            logits[i] = logit_table[colour & np.uint32(255)]
            for k in range(per_channel):
                for channel in range(3):
                    sh[i, 1 + k, channel] = sh_table[rest[i, channel * per_channel + k]]


@kernel
def decode_spz(start, stop, blocks, kinds, tables, frame, out):
    """`blocks`: those of the file by order, bytes (N, ...), rotations of four bytes as uint32 (N, 1).
    `kinds`: whether positions are whole numbers (else `means` has them), and whether rotations are three
    bytes. `frame`: the unit of positions and the sign of each axis as one factor (3,), the turn (4,), the
    sign of each SH coefficient."""
    positions, alphas, colours, scales, rotations, rest = blocks
    whole_positions, three_bytes = kinds
    logit_table, colour_table, scale_table, quat_table, sh_table = tables
    units, turn, signs = frame
    means, quats, log_scales, logits, sh = out
    w1, x1, y1, z1 = turn[0], turn[1], turn[2], turn[3]
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
            sh[i, 0, axis] = colour_table[colours[i, axis]]
        logits[i] = logit_table[alphas[i]]
        if three_bytes:
            x2, y2, z2 = (
                quat_table[rotations[i, 0]],
                quat_table[rotations[i, 1]],
                quat_table[rotations[i, 2]],
            )
            w2 = np.sqrt(max(np.float32(1) - (x2 * x2 + y2 * y2 + z2 * z2), np.float32(0)))
        else:
            word = np.uint32(rotations[i, 0])
            _put_smallest_three(
                quat_table[(word >> np.uint32(20)) & np.uint32(1023)],
                quat_table[(word >> np.uint32(10)) & np.uint32(1023)],
                quat_table[word & np.uint32(1023)],
                word >> np.uint32(30),
                quats,
                i,
            )
            x2, y2, z2, w2 = quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3]
        quats[i, 0] = w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2
        quats[i, 1] = w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2
        quats[i, 2] = w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2
        quats[i, 3] = w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2
        for k in range(1, sh.shape[1]):
            for channel in range(3):
                sh[i, k, channel] = sh_table[rest[i, 3 * (k - 1) + channel]] * signs[k]


@kernel
def decode_sog(start, stop, texels, palette, tables, out):
    """`texels`: pictures as rows of RGBA or RGB, those of SH labels last. `palette`: the picture of
    centroids, (rows, 64 entries side by side, 3 or 4), and the number of entries. `tables`: of means (3,
    65536), of scales and colours (3, 256)."""
    lower, upper, rotations, sizes, colours, labels = texels
    centroids, entries = palette
    mean_table, quat_table, scale_table, colour_table, logit_table, sh_table = tables
    means, quats, log_scales, logits, sh = out
    per_channel = sh.shape[1] - 1
    for i in range(start, stop):
        for axis in range(3):
            means[i, axis] = mean_table[axis, np.uint32(upper[i, axis]) << np.uint32(8) | lower[i, axis]]
            log_scales[i, axis] = scale_table[axis, sizes[i, axis]]
            sh[i, 0, axis] = colour_table[axis, colours[i, axis]]
        logits[i] = logit_table[colours[i, 3]]
        if rotations[i, 3] < 252:
            quats[i, 0], quats[i, 1], quats[i, 2], quats[i, 3] = 1, 0, 0, 0
        else:
            _put_smallest_three(
                quat_table[rotations[i, 0]],
                quat_table[rotations[i, 1]],
                quat_table[rotations[i, 2]],
                rotations[i, 3] - 252,
                quats,
                i,
            )
        if per_channel:
            label = np.uint32(labels[i, 1]) << np.uint32(8) | labels[i, 0]
            if label < entries:
                row, first = label >> 6, (label & 63) * per_channel
                for k in range(per_channel):
                    for channel in range(3):
                        sh[i, 1 + k, channel] = sh_table[centroids[row, first + k, channel]]
            else:
                for k in range(per_channel):
                    for channel in range(3):
                        sh[i, 1 + k, channel] = 0
