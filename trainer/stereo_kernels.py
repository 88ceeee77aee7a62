"""Plane sweep: depths of a photo by how well its neighbours agree with it on planes before it."""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types

from splatview.raster.compiling import inline, kernel
from splatview.raster.simd import (
    LANES,
    Vector,
    address_of,
    choose_above,
    constant,
    divide,
    emit_spread,
    fill,
    floor,
    fma,
    intrinsic,
    is_flat,
    lane_numbers,
    load,
    spread,
    sqrt,
    store,
)

RADIUS = 3
"""Windows of 7 x 7 px."""

LEAST_VARIANCE = 2.0
"""Of grey levels 0..255 in a window: below is no texture that could be matched."""

LONELY = np.float32(0.2)
"""Taken off a score that only one photo gives: two that agree are no chance."""

CLEAR, AWAY = np.float32(0.02), 2
"""By how much a depth must match better than any that is more than so many planes away."""


MIDDLE = np.float32(128)
"""Grey level that is taken off before squares are summed, so that sums over windows are exact in float32."""


def pieces_of(levels: np.ndarray) -> np.ndarray:
    """(H - 1, W - 1) uint32 of grey levels (H, W), whole numbers from 0 to 255: each with those to its right,
    below, and below to the right, from the lowest byte, so that what lies between them is read at once."""
    levels = levels.astype(np.uint32)
    above, below = levels[:-1], levels[1:]
    return np.ascontiguousarray(above[:, :-1] | above[:, 1:] << 8 | below[:, :-1] << 16 | below[:, 1:] << 24)


def padded(picture: np.ndarray) -> np.ndarray:
    """(H·W + LANES,) float32: a picture (H, W), flat, and zeros that vectors may reach into."""
    return np.pad(picture.ravel().astype(np.float32), (0, LANES))


@inline
def _within(low, high, slope, start):
    """The piece of low <= x <= high where start + slope * x is not negative; none where low is above high."""
    if slope > 0:
        low = max(low, -start / slope)
    elif slope < 0:
        high = min(high, -start / slope)
    elif not start >= 0:
        high = low - 1
    return low, high


@kernel
def window_sums(image, columns, out):
    """The sum over each pixel's window of `image` (H, W) float32, NaN where the window is not whole.

    `columns`: (W,) float64 to work in, zeros. out: (H, W) float32 or float64.
    """
    height, width = image.shape
    for y in range(height):
        for x in range(width):
            out[y, x] = np.nan
    for y in range(height):
        for x in range(width):
            columns[x] += image[y, x]
            if y > 2 * RADIUS:
                columns[x] -= image[y - 2 * RADIUS - 1, x]
        if y >= 2 * RADIUS:
            total = 0.0
            for x in range(width):
                total += columns[x]
                if x > 2 * RADIUS:
                    total -= columns[x - 2 * RADIUS - 1]
                if x >= 2 * RADIUS:
                    out[y - RADIUS, x - RADIUS] = total


def spans_of(textured: np.ndarray) -> np.ndarray:
    """Of windows whose middles are `textured`, (H, W) bool, none of them at the rim: (2, H, 2) int32, of each
    row the middles' columns, from the first to the one after the last, and those that windows cover. Both the
    same where there are none. What lies outside need not be looked at: of an object before nothing, two
    thirds of its photos."""
    height, width = textured.shape
    has_any = textured.max(axis=1)
    first = np.where(has_any, textured.argmax(axis=1), width)
    end = np.where(has_any, width - textured[:, ::-1].argmax(axis=1), 0)
    around = [slice(max(y - RADIUS, 0), y + RADIUS + 1) for y in range(height)]
    low = np.array([first[rows].min() for rows in around]) - RADIUS
    high = np.array([end[rows].max() for rows in around]) + RADIUS
    middles = np.where(has_any[:, None], np.stack([first, end], axis=1), 0)
    covered = np.where((low < high)[:, None], np.stack([low, high], axis=1), 0)
    return np.stack([middles, covered]).astype(np.int32)


@intrinsic
def _four_levels(typingctx: Any, pieces: Any, left: Any, top: Any, stride: Any) -> Any:
    """The grey levels that `pieces`, flat, has at columns and rows, vectors of whole numbers, `stride` int32
    to a row: a tuple of four vectors, in the order of `pieces_of`. No bounds are checked."""
    if not (is_flat(pieces) and pieces.dtype == types.uint32 and isinstance(left, Vector) and left == top):
        return None

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = ir.IntType(32)
        words = ir.VectorType(word, LANES)
        rows = builder.mul(builder.fptosi(args[2], words), emit_spread(builder, args[3]))
        places = builder.add(rows, builder.fptosi(args[1], words))
        four = ir.Constant(words, ir.Undefined)
        for lane in (ir.Constant(word, lane) for lane in range(LANES)):
            place = builder.sext(builder.extract_element(places, lane), ir.IntType(64))
            address = address_of(context, builder, pieces, args[0], place, word)
            four = builder.insert_element(four, builder.load(address, align=4), lane)
        levels = []
        for shift in range(0, 32, 8):
            level = builder.and_(builder.lshr(four, constant(words, shift)), constant(words, 255))
            levels.append(builder.sitofp(level, args[1].type))
        return cgutils.pack_array(builder, levels)

    return types.UniTuple(left, 4)(pieces, left, top, types.int32), codegen


@kernel
def plane_scores(
    grey,
    sums,
    deviation,
    width,
    spans,
    sources,
    rotations,
    offsets,
    inverse_depth,
    warped,
    second,
    columns,
    seen,
    scores,
):
    """Normalised cross-correlation of each window with the same piece of a plane in other photos: the mean of
    the two best, and of one alone LONELY less.

    Of the photo, (H, width), flat and LANES longer, see `padded`, float32: grey, its levels, whole numbers,
    less MIDDLE; sums over windows of these; deviation, how far they spread, 49 times the standard deviation,
    0 where there is no texture. spans (2, H, 2) int32: of each row the columns with texture, from the first
    to the one after the last, and those that such windows cover, see `spans_of`. sources: (S, h, w) uint32,
    other photos, see `pieces_of`. rotations (S, 3, 3), offsets (S, 3): a pixel (u, v) at inverse depth d is
    seen at rotation @ (u, v, 1) + d * offset.
    warped, second, as long, columns (3, width + LANES), float32, seen (H, 2) int32: to work in. scores: out
    where there is texture; -1 where no source sees the window, or it has none.
    """
    height = spans.shape[1]
    count, middle = np.float32((2 * RADIUS + 1) ** 2), MIDDLE
    least = np.float32(LEAST_VARIANCE) * count * count
    for y in range(height):
        for x in range(y * width + spans[0, y, 0], y * width + spans[0, y, 1]):
            scores[x] = second[x] = np.float32(-1)
    h, w = sources.shape[1], sources.shape[2]
    pieces = sources.reshape(len(sources), h * w)
    a_row, c_row, p_row = columns[0], columns[1], columns[2]
    lanes = lane_numbers(spread(np.float32(0)))
    zero, half, none = np.float32(0), np.float32(0.5), fill(lanes, -1)
    right, bottom = fill(lanes, w), fill(lanes, h)
    last_left, last_top, stride = fill(lanes, w - 1), fill(lanes, h - 1), np.int32(w)
    for source in range(len(sources)):
        image, A, b = pieces[source], rotations[source], offsets[source]
        a0, a1, a2 = np.float32(A[0, 0]), np.float32(A[1, 0]), np.float32(A[2, 0])
        for y in range(height):
            v = y + 0.5
            q0 = A[0, 1] * v + A[0, 2] + inverse_depth * b[0]
            q1 = A[1, 1] * v + A[1, 2] + inverse_depth * b[1]
            q2 = A[2, 1] * v + A[2, 2] + inverse_depth * b[2]
            # What the other photo shows of a row is one run of it: from its first pixel's centre to that of
            # its last, each way, and before its camera.
            low, high = spans[1, y, 0] + 0.5, spans[1, y, 1] - 0.5
            low, high = _within(low, high, A[2, 0], q2 - 1e-6)
            low, high = _within(low, high, A[0, 0] - 0.5 * A[2, 0], q0 - 0.5 * q2)
            low, high = _within(low, high, (w + 0.5) * A[2, 0] - A[0, 0], (w + 0.5) * q2 - q0)
            low, high = _within(low, high, A[1, 0] - 0.5 * A[2, 0], q1 - 0.5 * q2)
            low, high = _within(low, high, (h + 0.5) * A[2, 0] - A[1, 0], (h + 0.5) * q2 - q1)
            first, end = 0, 0
            if low <= high:
                first, end = int(np.ceil(low - 0.5)), int(np.floor(high - 0.5)) + 1
            seen[y, 0], seen[y, 1] = first, end
            p0, p1, p2 = np.float32(q0), np.float32(q1), np.float32(q2)
            for x in range(first, end, LANES):
                u = lanes + (np.float32(x) + half)
                inverse = divide(fill(u, 1), u * a2 + p2)
                # Lanes after the end may be beyond the photo, or NaN, which is 0 so.
                column = min(max((u * a0 + p0) * inverse - half, zero), right)
                row = min(max((u * a1 + p1) * inverse - half, zero), bottom)
                left, top = min(floor(column), last_left), min(floor(row), last_top)
                s, t = column - left, row - top
                top_left, top_right, low_left, low_right = _four_levels(image, left, top, stride)
                above = fma(s, top_right - top_left, top_left)
                below = fma(s, low_right - low_left, low_left)
                store(warped, y * width + x, fma(t, below - above, above) - middle)
        # Sums over windows, of the warped picture, its square and its product with the photo.
        for y in range(RADIUS, height - RADIUS):
            first, end = spans[0, y, 0], spans[0, y, 1]
            for dy in range(-RADIUS, RADIUS + 1):
                first, end = max(first, seen[y + dy, 0] + RADIUS), min(end, seen[y + dy, 1] - RADIUS)
            if not first < end:
                continue
            for x in range(first - RADIUS, end + RADIUS, LANES):
                a = c = p = fill(lanes, 0)
                for dy in range(-RADIUS, RADIUS + 1):
                    value = load(warped, (y + dy) * width + x)
                    a = a + value
                    c = fma(value, value, c)
                    p = fma(value, load(grey, (y + dy) * width + x), p)
                store(a_row, x, a)
                store(c_row, x, c)
                store(p_row, x, p)
            for x in range(first, end, LANES):
                a = c = p = fill(lanes, 0)
                for dx in range(x - RADIUS, x + RADIUS + 1):
                    a = a + load(a_row, dx)
                    c = c + load(c_row, dx)
                    p = p + load(p_row, dx)
                at = y * width + x
                own, best = load(deviation, at), load(scores, at)
                variance = c * count - a * a
                score = divide(p * count - a * load(sums, at), sqrt(variance) * own)
                # Nothing without texture, of either, nor after the end.
                score = choose_above(variance, fill(lanes, least), score, none)
                score = choose_above(own, fill(lanes, 0), score, none)
                score = choose_above(fill(lanes, end - x), lanes, score, none)
                store(second, at, max(load(second, at), min(best, score)))
                store(scores, at, max(best, score))
    if len(sources) > 1:
        for y in range(height):
            for x in range(y * width + spans[0, y, 0], y * width + spans[0, y, 1]):
                best, other = scores[x], second[x]
                scores[x] = half * (best + other) if other > -1 else best - LONELY


@kernel
def best_planes(scores, inverse_depths, width, spans, out, confidence):
    """The inverse depth of the best of the planes, between them by a parabola, and its score; -1 where it is
    the first or the last, or not clearly the best. Only in `spans`, as of `plane_scores`.

    scores: (D·H·width + LANES,) float32, of planes one after the other. inverse_depths: (D,) float32, rising
    evenly. out, confidence: as `plane_scores` has pictures.
    """
    planes, height = len(inverse_depths), spans.shape[1]
    step, size = inverse_depths[1] - inverse_depths[0], height * width
    lanes = lane_numbers(spread(np.float32(0)))
    none, zero = fill(lanes, -1), fill(lanes, 0)
    for y in range(height):
        for x in range(spans[0, y, 0], spans[0, y, 1], LANES):
            at = y * width + x
            best, top, low, high = zero, load(scores, at), none, none
            before, here = top, load(scores, at + size)
            for d in range(1, planes - 1):
                after = load(scores, at + (d + 1) * size)
                low, high = choose_above(here, top, before, low), choose_above(here, top, after, high)
                best = choose_above(here, top, fill(lanes, d), best)
                top, before, here = max(here, top), here, after
            is_last = choose_above(here, top, zero, fill(lanes, 1))
            top, rival = max(here, top), none
            best = choose_above(fill(lanes, 1), is_last, fill(lanes, planes - 1), best)
            for d in range(planes):
                score = load(scores, at + d * size)
                rival = max(choose_above(abs(best - fill(lanes, d)), fill(lanes, AWAY), score, none), rival)
            bend = low - top * 2 + high
            place = min(max(divide((low - high) * 0.5, bend), fill(lanes, -0.5)), fill(lanes, 0.5))
            for is_known in (bend * -1, low + 1, high + 1, is_last):
                place = choose_above(is_known, zero, place, zero)
            found = inverse_depths[0] + (best + place) * step
            sure = choose_above(top - rival, fill(lanes, CLEAR), top, none)
            sure = choose_above(min(best, is_last), zero, sure, none)
            within = fill(lanes, spans[0, y, 1] - x)
            store(out, at, choose_above(within, lanes, found, load(out, at)))
            store(confidence, at, choose_above(within, lanes, sure, load(confidence, at)))


@kernel
def agreeing(
    inverse_depth, confidence, least, others, other_confidences, rotations, offsets, tolerance, counts
):
    """For each pixel the number of other photos whose own depth there is the same within `tolerance`.

    inverse_depth, confidence: (H, W). others, other_confidences: (S, h, w). rotations, offsets as of
    `plane_scores`. counts: (H, W) int32.
    """
    height, width = inverse_depth.shape
    for y in range(height):
        for x in range(width):
            counts[y, x] = 0
            if not confidence[y, x] > least:
                continue
            w = inverse_depth[y, x]
            for source in range(len(others)):
                A, b = rotations[source], offsets[source]
                u, v = x + 0.5, y + 0.5
                z = A[2, 0] * u + A[2, 1] * v + A[2, 2] + w * b[2]
                if not z > 1e-6:
                    continue
                column = int(np.floor((A[0, 0] * u + A[0, 1] * v + A[0, 2] + w * b[0]) / z))
                row = int(np.floor((A[1, 0] * u + A[1, 1] * v + A[1, 2] + w * b[1]) / z))
                if not (0 <= row < others.shape[1] and 0 <= column < others.shape[2]):
                    continue
                if not other_confidences[source, row, column] > least:
                    continue
                there = w / z  # 1 / (depth * z), z being the depth there in units of the depth here
                if abs(others[source, row, column] - there) < tolerance * there:
                    counts[y, x] += 1
