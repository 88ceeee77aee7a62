"""Plane sweep: depths of a photo by how well its neighbours agree with it on planes before it."""

from __future__ import annotations

import numpy as np

from splatview.raster.compiling import inline, kernel

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


@kernel
def plane_scores(
    grey,
    sums,
    deviation,
    spans,
    sources,
    rotations,
    offsets,
    inverse_depth,
    warped,
    second,
    rows,
    seen,
    scores,
):
    """Normalised cross-correlation of each window with the same piece of a plane in other photos: the mean of
    the two best, and of one alone LONELY less.

    grey (H, W) float32: levels of the photo, less MIDDLE, whole numbers. sums, deviation (H, W) float32: of
    its windows, sums of these, and how far they spread, 49 times the standard deviation; 0 where there is no
    texture. spans (2, H, 2) int32: of each row the columns with texture, from the first to the one after the
    last, and those that such windows cover, see `spans_of`. sources: (S, h, w) uint32, other photos, see
    `pieces_of`. rotations (S, 3, 3), offsets (S, 3): a pixel (u, v) at inverse depth d is seen at
    rotation @ (u, v, 1) + d * offset.
    warped, second (H, W), rows (3, W) float32, seen (H, 2) int32: to work in. scores: (H, W) float32, out
    where there is texture; -1 where no source sees the window, or it has none.

    Loops over x have no branches, sums are in float32, and four grey levels are read as one: a quarter of the
    time of a loop that asks at each pixel whether it is seen, and reads floats (270x480 px, four sources).
    LLVM does not make vectors of them: there are more arrays than it checks for overlaps.
    """
    height = len(grey)
    count, middle = np.float32((2 * RADIUS + 1) ** 2), MIDDLE
    least = np.float32(LEAST_VARIANCE) * count * count
    for y in range(height):
        for x in range(spans[0, y, 0], spans[0, y, 1]):
            scores[y, x] = second[y, x] = np.float32(-1)
    h, w = sources.shape[1], sources.shape[2]
    pieces = sources.reshape(len(sources), h * w)
    zero, half, one = np.float32(0), np.float32(0.5), np.float32(1)
    right, bottom, byte = np.float32(w), np.float32(h), np.uint32(255)
    stride, last_left, last_top = np.int32(w), np.int32(w - 1), np.int32(h - 1)
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
            for x in range(first, end):
                u = np.float32(np.int32(x)) + half
                inverse = one / (p2 + a2 * u)
                column = min(max((p0 + a0 * u) * inverse - half, zero), right)
                row = min(max((p1 + a1 * u) * inverse - half, zero), bottom)
                left, top = min(np.int32(column), last_left), min(np.int32(row), last_top)
                s, t = column - np.float32(left), row - np.float32(top)
                four = image[np.uint32(np.int32(top * stride) + left)]
                top_left = np.float32(np.int32(four & byte))
                top_right = np.float32(np.int32(four >> np.uint32(8) & byte))
                low_left = np.float32(np.int32(four >> np.uint32(16) & byte))
                low_right = np.float32(np.int32(four >> np.uint32(24)))
                above = top_left + s * (top_right - top_left)
                below = low_left + s * (low_right - low_left)
                warped[y, x] = above + t * (below - above) - middle
        # Sums over windows, of the warped picture, its square and its product with the photo.
        for y in range(RADIUS, height - RADIUS):
            first, end = spans[0, y, 0], spans[0, y, 1]
            for dy in range(-RADIUS, RADIUS + 1):
                first, end = max(first, seen[y + dy, 0] + RADIUS), min(end, seen[y + dy, 1] - RADIUS)
            if not first < end:
                continue
            for x in range(first - RADIUS, end + RADIUS):
                a = c = p = zero
                for dy in range(-RADIUS, RADIUS + 1):
                    value = warped[y + dy, x]
                    a += value
                    c += value * value
                    p += value * grey[y + dy, x]
                rows[0, x], rows[1, x], rows[2, x] = a, c, p
            for x in range(first, end):
                a = c = p = zero
                for dx in range(-RADIUS, RADIUS + 1):
                    a += rows[0, x + dx]
                    c += rows[1, x + dx]
                    p += rows[2, x + dx]
                spread = count * c - a * a
                has_texture = (spread > least) & (deviation[y, x] > 0)
                score = (count * p - a * sums[y, x]) / (np.sqrt(spread) * deviation[y, x])
                score = score if has_texture else -one
                best = scores[y, x]
                second[y, x] = max(second[y, x], min(best, score))
                scores[y, x] = max(best, score)
    if len(sources) > 1:
        for y in range(height):
            for x in range(spans[0, y, 0], spans[0, y, 1]):
                best, other = scores[y, x], second[y, x]
                scores[y, x] = half * (best + other) if other > -1 else best - LONELY


@kernel
def best_planes(scores, inverse_depths, spans, best, top, rival, out, confidence):
    """The inverse depth of the best of the planes, between them by a parabola, and its score; -1 where it is
    the first or the last, or not clearly the best. Only in `spans`, as of `plane_scores`.

    scores: (D, H, W) float32. inverse_depths: (D,) float64, rising evenly. best (W,) int32, top, rival (W,)
    float32: to work in. out, confidence: (H, W) float32.
    """
    planes, height, _ = scores.shape
    step = inverse_depths[1] - inverse_depths[0]
    for y in range(height):
        first, end = spans[0, y, 0], spans[0, y, 1]
        for x in range(first, end):
            best[x], top[x], rival[x] = 0, scores[0, y, x], np.float32(-1)
        for d in range(1, planes):  # rows of a plane at a time: pixels of all planes are far apart in memory
            for x in range(first, end):
                is_better = scores[d, y, x] > top[x]
                best[x] = np.int32(d) if is_better else best[x]
                top[x] = scores[d, y, x] if is_better else top[x]
        for d in range(planes):
            for x in range(first, end):
                is_away = abs(np.int32(np.int32(d) - best[x])) > np.int32(AWAY)
                score = scores[d, y, x] if is_away else np.float32(-1)
                rival[x] = score if score > rival[x] else rival[x]
        for x in range(first, end):
            at, score = best[x], top[x]
            place = 0.0
            if 0 < at < planes - 1:
                low, high = scores[at - 1, y, x], scores[at + 1, y, x]
                bend = low - 2 * score + high
                if bend < 0 and low > -1 and high > -1:
                    place = 0.5 * (low - high) / bend
                    place = min(max(place, -0.5), 0.5)
            out[y, x] = np.float32(inverse_depths[at] + place * step)
            clear = 0 < at < planes - 1 and score - rival[x] > CLEAR
            confidence[y, x] = score if clear else np.float32(-1)


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
