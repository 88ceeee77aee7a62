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


@inline
def _bilinear(image, u, v):
    """The grey level at (u, v), px, with the centre of the first pixel at (0.5, 0.5); NaN outside."""
    height, width = image.shape
    x, y = u - np.float32(0.5), v - np.float32(0.5)
    if not (x >= 0 and y >= 0 and x < width - 1 and y < height - 1):
        return np.float32(np.nan)
    left, top = int(x), int(y)
    s, t = x - np.float32(left), y - np.float32(top)
    above = image[top, left] + s * (image[top, left + 1] - image[top, left])
    below = image[top + 1, left] + s * (image[top + 1, left + 1] - image[top + 1, left])
    return above + t * (below - above)


@kernel
def window_means(image, columns, out):
    """The mean of each pixel's window of `image` (H, W) float32, NaN where the window is not whole.

    `columns`: (W,) float64 to work in, zeros.
    """
    height, width = image.shape
    share = 1.0 / (2 * RADIUS + 1) ** 2
    for y in range(height):
        for x in range(width):
            out[y, x] = np.float32(np.nan)
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
                    out[y - RADIUS, x - RADIUS] = total * share


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
    grey, mean, deviation, spans, sources, rotations, offsets, inverse_depth, warped, second, rows, scores
):
    """Normalised cross-correlation of each window with the same piece of a plane in other photos: the mean of
    the two best, and of one alone LONELY less.

    grey, mean, deviation: (H, W) float32, of the photo and its windows; spans (2, H, 2) int32: of each row
    the columns with texture, from the first to the one after the last, and those that such windows cover, see
    `spans_of`. sources: (S, h, w) float32. rotations (S, 3, 3), offsets (S, 3): a pixel (u, v) at inverse
    depth d is seen at rotation @ (u, v, 1) + d * offset.
    warped, second (H, W) float32, rows (3, W) float64: to work in. scores: (H, W) float32, out where there is
    texture; -1 where no source sees the window, or it has none.
    """
    height = len(grey)
    window = (2 * RADIUS + 1) ** 2
    for y in range(height):
        for x in range(spans[0, y, 0], spans[0, y, 1]):
            scores[y, x] = second[y, x] = np.float32(-1)
    for source in range(len(sources)):
        image, A, b = sources[source], rotations[source], offsets[source]
        for y in range(height):
            v = y + 0.5
            p0 = A[0, 1] * v + A[0, 2] + inverse_depth * b[0]
            p1 = A[1, 1] * v + A[1, 2] + inverse_depth * b[1]
            p2 = A[2, 1] * v + A[2, 2] + inverse_depth * b[2]
            for x in range(spans[1, y, 0], spans[1, y, 1]):
                u = x + 0.5
                z = p2 + A[2, 0] * u
                if z > 1e-6:
                    warped[y, x] = _bilinear(
                        image, np.float32((p0 + A[0, 0] * u) / z), np.float32((p1 + A[1, 0] * u) / z)
                    )
                else:
                    warped[y, x] = np.float32(np.nan)
        # Sums over windows, of the warped picture, its square and its product with the photo; not running
        # ones, in which a NaN would stay. (Dropped: rows of all windows, one shift at a time: 45 % slower.)
        for y in range(RADIUS, height - RADIUS):
            first, end = spans[0, y, 0], spans[0, y, 1]
            if first == end:
                continue
            for x in range(first - RADIUS, end + RADIUS):
                a = c = p = 0.0
                for dy in range(-RADIUS, RADIUS + 1):
                    value = warped[y + dy, x]
                    a += value
                    c += value * value
                    p += value * grey[y + dy, x]
                rows[0, x], rows[1, x], rows[2, x] = a, c, p
            for x in range(first, end):
                a = c = p = 0.0
                for dx in range(-RADIUS, RADIUS + 1):
                    a += rows[0, x + dx]
                    c += rows[1, x + dx]
                    p += rows[2, x + dx]
                a /= window
                variance = c / window - a * a
                if variance > LEAST_VARIANCE and deviation[y, x] > 0:
                    score = np.float32((p / window - a * mean[y, x]) / (np.sqrt(variance) * deviation[y, x]))
                    if score > scores[y, x]:
                        second[y, x] = scores[y, x]
                        scores[y, x] = score
                    elif score > second[y, x]:
                        second[y, x] = score
    if len(sources) > 1:
        for y in range(height):
            for x in range(spans[0, y, 0], spans[0, y, 1]):
                if second[y, x] > -1:
                    scores[y, x] = np.float32(0.5) * (scores[y, x] + second[y, x])
                else:
                    scores[y, x] -= LONELY


@kernel
def best_planes(scores, inverse_depths, spans, best, rival, out, confidence):
    """The inverse depth of the best of the planes, between them by a parabola, and its score; -1 where it is
    the first or the last, or not clearly the best. Only in `spans`, as of `plane_scores`.

    scores: (D, H, W) float32. inverse_depths: (D,) float64, rising evenly. best (W,) int32, rival (W,)
    float32: to work in. out, confidence: (H, W) float32.
    """
    planes, height, _ = scores.shape
    step = inverse_depths[1] - inverse_depths[0]
    for y in range(height):
        first, end = spans[0, y, 0], spans[0, y, 1]
        for x in range(first, end):
            best[x], rival[x] = 0, np.float32(-1)
        for d in range(1, planes):  # rows of a plane at a time: pixels of all planes are far apart in memory
            for x in range(first, end):
                if scores[d, y, x] > scores[best[x], y, x]:
                    best[x] = d
        for d in range(planes):
            for x in range(first, end):
                if abs(d - best[x]) > AWAY and scores[d, y, x] > rival[x]:
                    rival[x] = scores[d, y, x]
        for x in range(first, end):
            at = best[x]
            score = scores[at, y, x]
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
