"""Kernels of the photo loss: L1 and SSIM with their gradient, in two passes over rows; and pictures at the
exposure of their photos.

SSIM's 11x11 Gaussian window is separable and symmetric. `similarity_rows` filters the two pictures and
their products, and leaves the derivatives of SSIM by the three filtered quantities that depend on the
picture; `gradient_rows` filters those once more, which is the adjoint, and adds the gradient of L1.

A row of a picture is 3·W numbers, colours interleaved, so one tap is 3 numbers away from the next and
every loop runs over contiguous vectors. Only windows that lie inside the picture count, as in
`measure.metrics`: a picture has (H - 10)·(W - 10) of them for each colour.
"""

from __future__ import annotations

import numpy as np

from splatview.raster.compiling import inline, kernel
from splatview.raster.simd import (
    LANES,
    absolute,
    aligned,
    divide,
    fill,
    fma,
    keep_if_below,
    lane_sum,
    load,
    negate,
    spread,
    store,
    widened,
)

TAPS = 11
MARGIN = 3 * (TAPS - 1)
"""Numbers of a row between the first pixel of a window and the last."""

BRIGHTEST = 1e9
"""Values of a picture beyond this, either way, count as this: in float32 their fourth powers, which SSIM is
made of, would be infinite."""

MAPS = 3
"""Derivatives of SSIM by the window's mean of x, of x², and of x·y."""

FIELDS = 5
"""What is filtered: x, y, x², y², x·y."""


@inline
def row_length(width):
    """Numbers in a padded row: a margin at either end, and room for a whole last vector."""
    return -(-(3 * width + MARGIN + LANES) // LANES) * LANES


@inline
def along_row(row, i, w0, w1, w2, w3, w4, w5):
    """The filter along a row for LANES windows that begin at row[i]; w0 is the outermost weight."""
    total = w5 * load(row, i + 15)
    total = fma(w4, load(row, i + 12) + load(row, i + 18), total)
    total = fma(w3, load(row, i + 9) + load(row, i + 21), total)
    total = fma(w2, load(row, i + 6) + load(row, i + 24), total)
    total = fma(w1, load(row, i + 3) + load(row, i + 27), total)
    return fma(w0, load(row, i) + load(row, i + 30), total)


@inline
def read_rows(image, flat_photo, mask, y, x_rows, y_rows, at):
    """Row y of both pictures, colours interleaved, from place `at` on; pixels that the mask leaves out are
    grey in both, so that what is there cannot matter, not even to windows that reach over the edge of the
    mask."""
    number = image.dtype.type
    brightest = number(BRIGHTEST)
    # The usual case apart: the compiler makes vectors of loops without questions.
    for x in range(image.shape[1]):
        for channel in range(3):
            x_rows[at + 3 * x + channel] = min(max(image[y, x, channel], -brightest), brightest)
    begin = y * 3 * image.shape[1]
    for k in range(3 * image.shape[1]):
        y_rows[at + k] = number(flat_photo[begin + k]) / number(255)
    if mask.size > 0:
        for x in range(image.shape[1]):
            if not mask[y, x]:
                for channel in range(3):
                    x_rows[at + 3 * x + channel] = y_rows[at + 3 * x + channel] = number(0.5)


@kernel(allocates=True)
def similarity_rows(start, stop, image, photo, mask, weights, c1, c2, maps, sums):
    """Windows whose upper rows are [start, stop): derivatives to `maps`, the rows' sums of SSIM to `sums`.

    image (H, W, 4) and weights (11,) in one float dtype; photo (H, W, 3) uint8; mask (H, W) bool, or
    (0, 0): all; maps (H - 10, 3·row_length) in the image's dtype; sums (H - 10,) float64.
    """
    windows = 3 * (image.shape[1] - TAPS + 1)
    flat_photo = photo.reshape(-1)
    length = maps.shape[1] // MAPS
    x_rows, y_rows = np.zeros(TAPS * length, image.dtype), np.zeros(TAPS * length, image.dtype)
    columns = np.zeros(FIELDS * length, image.dtype)
    turned = np.empty(TAPS, image.dtype)
    similarity = np.zeros(length, image.dtype)
    w0, w1, w2 = spread(weights[0]), spread(weights[1]), spread(weights[2])
    w3, w4, w5 = spread(weights[3]), spread(weights[4]), spread(weights[5])
    one, two = fill(w0, 1.0), fill(w0, 2.0)
    room = aligned(LANES, np.float64)
    c1_all, c2_all = fill(w0, c1), fill(w0, c2)
    for row in range(start, stop + TAPS - 1):
        read_rows(image, flat_photo, mask, row, x_rows, y_rows, row % TAPS * length)
        first = row - (TAPS - 1)
        if first < start:
            continue
        # Along columns first: two rows are read for each tap. The other way round it was five, far beyond the
        # first-level cache, and 1.1 in place of 0.85 ms for 375x249.
        for place in range(TAPS):
            turned[place] = weights[(place - first) % TAPS]
        for i in range(0, length, LANES):
            mean_x = mean_y = mean_xx = mean_yy = mean_xy = fill(w0, 0.0)
            for place in range(TAPS):
                weight = spread(turned[place])
                x, y = load(x_rows, place * length + i), load(y_rows, place * length + i)
                weighted_x, weighted_y = weight * x, weight * y
                mean_x, mean_y = mean_x + weighted_x, mean_y + weighted_y
                mean_xx = fma(weighted_x, x, mean_xx)
                mean_yy = fma(weighted_y, y, mean_yy)
                mean_xy = fma(weighted_x, y, mean_xy)
            store(columns, i, mean_x)
            store(columns, length + i, mean_y)
            store(columns, 2 * length + i, mean_xx)
            store(columns, 3 * length + i, mean_yy)
            store(columns, 4 * length + i, mean_xy)
        out = maps[first]
        for k in range(MAPS):
            out[k * length : k * length + MARGIN] = 0
        for i in range(0, windows, LANES):
            mean_x = along_row(columns, i, w0, w1, w2, w3, w4, w5)
            mean_y = along_row(columns, length + i, w0, w1, w2, w3, w4, w5)
            mean_xx = along_row(columns, 2 * length + i, w0, w1, w2, w3, w4, w5)
            mean_yy = along_row(columns, 3 * length + i, w0, w1, w2, w3, w4, w5)
            mean_xy = along_row(columns, 4 * length + i, w0, w1, w2, w3, w4, w5)
            # SSIM = a1·a2 / (b1·b2) (Wang et al. 2004, eq. 13).
            xx, yy, xy = mean_x * mean_x, mean_y * mean_y, mean_x * mean_y
            a1, b1 = fma(two, xy, c1_all), xx + yy + c1_all
            a2 = fma(two, mean_xy - xy, c2_all)
            b2 = (mean_xx - xx) + (mean_yy - yy) + c2_all
            under = divide(one, b1 * b2)
            s = a1 * a2 * under
            by_mean = two * under * fma(mean_x * s, b1 - b2, mean_y * (a2 - a1))
            store(similarity, i, s)
            store(out, MARGIN + i, by_mean)
            store(out, length + MARGIN + i, negate(s) * b1 * under)
            store(out, 2 * length + MARGIN + i, two * a1 * under)
        # The last vector reaches beyond the last window.
        for k in range(MAPS):
            out[k * length + MARGIN + windows : (k + 1) * length] = 0
        similarity[windows:] = 0
        total = widened(fill(w0, 0.0))
        for i in range(0, windows, LANES):
            total = total + widened(load(similarity, i))
        sums[first] = lane_sum(total, room)


@kernel(allocates=True)
def gradient_rows(
    start,
    stop,
    image,
    photo,
    mask,
    alpha,
    alpha_known,
    weights,
    l1_scale,
    ssim_scale,
    alpha_scale,
    maps,
    d_image,
    sums,
    alpha_sums,
):
    """Rows [start, stop) of d_image (H, W, 4) = l1_scale·sign(x - y) + ssim_scale·d(sum of SSIM)/dx.

    alpha (H, W) uint8 is the photo's opacity a, or (0, 0): alpha's gradient is alpha_scale·sign(x - a), or 0,
    as it is where a is above `alpha_known`.
    sums and alpha_sums (H,) float64 receive the rows' sums of |x - y| and of |x - a|. The other arguments
    are those of `similarity_rows`; an ssim_scale of 0 leaves `maps` unread.
    """
    height, width = image.shape[:2]
    flat_photo = photo.reshape(-1)
    number = image.dtype.type
    length = row_length(width)
    x_row, y_row = np.zeros(length, image.dtype), np.zeros(length, image.dtype)
    column = np.zeros(MAPS * length, image.dtype)
    d_row = np.zeros(length, image.dtype)
    w0, w1, w2 = spread(weights[0]), spread(weights[1]), spread(weights[2])
    w3, w4, w5 = spread(weights[3]), spread(weights[4]), spread(weights[5])
    one, two = fill(w0, 1.0), fill(w0, 2.0)
    room = aligned(LANES, np.float64)
    for row in range(start, stop):
        read_rows(image, flat_photo, mask, row, x_row, y_row, 0)
        if ssim_scale != 0:
            lowest, highest = max(row - (TAPS - 1), 0), min(row, height - TAPS)
            for i in range(0, MAPS * length, LANES):
                total = fill(w0, 0.0)
                for window in range(lowest, highest + 1):
                    total = fma(spread(weights[row - window]), load(maps[window], i), total)
                store(column, i, total)
            for i in range(0, 3 * width, LANES):
                by_mean = along_row(column, i, w0, w1, w2, w3, w4, w5)
                by_xx = along_row(column, length + i, w0, w1, w2, w3, w4, w5)
                by_xy = along_row(column, 2 * length + i, w0, w1, w2, w3, w4, w5)
                d = fma(load(x_row, i), two * by_xx, fma(load(y_row, i), by_xy, by_mean))
                store(d_row, i, d)
        total = widened(fill(w0, 0.0))
        for i in range(0, 3 * width, LANES):  # beyond the row both are 0
            x, y = load(x_row, i), load(y_row, i)
            total = total + widened(absolute(x - y))
            sign = keep_if_below(one, y, x) - keep_if_below(one, x, y)
            d = load(d_row, i)
            store(d_row, i, fma(fill(d, ssim_scale), d, fill(d, l1_scale) * sign))
        for x in range(width):
            for channel in range(3):
                d_image[row, x, channel] = d_row[3 * x + channel]
            d_image[row, x, 3] = 0
        if mask.size > 0:
            for x in range(width):
                if not mask[row, x]:
                    for channel in range(3):
                        d_image[row, x, channel] = 0
        total_alpha = 0.0
        if alpha.size > 0:
            for x in range(width):
                if alpha[row, x] <= alpha_known and (mask.size == 0 or mask[row, x]):
                    difference = image[row, x, 3] - number(alpha[row, x]) / number(255)
                    total_alpha += abs(difference)
                    sign = number(difference > 0) - number(difference < 0)
                    d_image[row, x, 3] = alpha_scale * sign
        sums[row] = lane_sum(total, room)
        alpha_sums[row] = total_alpha


@inline
def shares(alpha, is_cut_out):
    """How much of a pixel is exposed, and how much of it is background, which keeps its value."""
    one = type(alpha)(1)
    return (alpha, one - alpha) if is_cut_out else (one, type(alpha)(0))


@kernel
def expose_rows(start, stop, image, gain, offset, behind, is_cut_out, exposed):
    """Rows [start, stop) of exposed (H, W, 4) = gain·(colour - (1 - a)·behind) + a·offset + (1 - a)·behind.

    image (H, W, 4), gain, offset and behind (3,) are of one float dtype. Where the photo is no cut-out there
    is no background: gain·colour + offset.
    """
    for y in range(start, stop):
        for x in range(image.shape[1]):
            alpha = image[y, x, 3]
            of_scene, of_background = shares(alpha, is_cut_out)
            for channel in range(3):
                base = of_background * behind[channel]
                exposed[y, x, channel] = (
                    gain[channel] * (image[y, x, channel] - base) + of_scene * offset[channel] + base
                )
            exposed[y, x, 3] = alpha


@kernel
def expose_backward_rows(start, stop, image, d_exposed, gain, offset, behind, is_cut_out, d_image, sums):
    """Rows [start, stop) of d_image (H, W, 4), and in sums (H, 3, 2) float64 the rows' gradients by log gain
    and by offset. The other arguments are those of `expose_rows`."""
    for y in range(start, stop):
        for x in range(image.shape[1]):
            d_image[y, x, 3] = d_exposed[y, x, 3]
        for channel in range(3):
            by_gain = by_offset = 0.0
            factor, shift = gain[channel], offset[channel] - (1 - gain[channel]) * behind[channel]
            for x in range(image.shape[1]):
                of_scene, of_background = shares(image[y, x, 3], is_cut_out)
                d = d_exposed[y, x, channel]
                d_image[y, x, channel] = factor * d
                by_gain += factor * d * (image[y, x, channel] - of_background * behind[channel])
                by_offset += d * of_scene
                if is_cut_out:
                    d_image[y, x, 3] += d * shift
            sums[y, channel, 0] = by_gain
            sums[y, channel, 1] = by_offset


@kernel
def shade_rows(start, stop, image, gains, columns, lefts, shaded):
    """Rows [start, stop) of shaded (H, W, 4): the colours of image (H, W, 4) times what is between gains (H,
    M) at the nodes of their row, by columns (W, M), weights of which all but two are 0: see `lefts` (W,)."""
    for y in range(start, stop):
        for x in range(image.shape[1]):
            left = lefts[x]
            gain = columns[x, left] * gains[y, left] + columns[x, left + 1] * gains[y, left + 1]
            for channel in range(3):
                shaded[y, x, channel] = gain * image[y, x, channel]
            shaded[y, x, 3] = image[y, x, 3]


@kernel
def shade_backward_rows(start, stop, image, d_shaded, gains, columns, lefts, d_image, by_gain):
    """Rows [start, stop) of the gradients of `shade_rows` by image (H, W, 4) and by gains (H, M)."""
    for y in range(start, stop):
        by_gain[y] = 0
        for x in range(image.shape[1]):
            left = lefts[x]
            first, second = columns[x, left], columns[x, left + 1]
            gain = first * gains[y, left] + second * gains[y, left + 1]
            total = type(gain)(0)
            for channel in range(3):
                d = d_shaded[y, x, channel]
                d_image[y, x, channel] = gain * d
                total += d * image[y, x, channel]
            d_image[y, x, 3] = d_shaded[y, x, 3]
            by_gain[y, left] += first * total
            by_gain[y, left + 1] += second * total
