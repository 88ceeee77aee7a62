"""Kernels over the marks of a scene, each splat's flags and palette index, and over positions of edited
splats.

A pass over five million takes some milliseconds. Runs are (R, 2) int32, start and count each, ascending and
apart.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from splatview.edit.kernels.compiling import in_pieces, inline, kernel
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import (
    ANY_LOCK,
    DELETED,
    FILE_LOCKED,
    NOT_SHOWN,
    PALETTE_SHIFT,
    SceneEdits,
    adjustment_rows,
    shown,
)

NOT_SELECTABLE = NOT_SHOWN | ANY_LOCK


class Places(NamedTuple):
    """Means of an edited scene and the moves of its palette."""

    means: np.ndarray
    """(N, 3) float32 or float64."""
    marks: np.ndarray
    """(N,) uint32."""
    moves: np.ndarray
    """(P, 12) float64 by palette index: linear part beside translation, 3x4 by rows; (0, 12): nothing was
    moved."""


def places_of(gaussians: Gaussians, edits: SceneEdits) -> Places:
    moves = np.zeros((0, 12))
    if any(adjustment.moves for adjustment in edits.palette):
        moves = np.ascontiguousarray(adjustment_rows(edits.palette)[:, :12])
    return Places(gaussians.means, edits.marks, moves)


@inline
def place(places, i):
    """World position of splat `i` as three float64. In a thread whose result nobody waits for any more, marks
    may be newer than the palette: what they name beyond it moves nothing."""
    x, y, z = np.float64(places.means[i, 0]), np.float64(places.means[i, 1]), np.float64(places.means[i, 2])
    entry = places.marks[i] >> PALETTE_SHIFT
    if entry == 0 or entry >= len(places.moves):
        return x, y, z
    m = places.moves[entry]
    return (
        m[0] * x + m[1] * y + m[2] * z + m[3],
        m[4] * x + m[5] * y + m[6] * z + m[7],
        m[8] * x + m[9] * y + m[10] * z + m[11],
    )


@kernel
def mask_runs(mask: np.ndarray, count: int) -> np.ndarray:
    """The runs of True in `mask` (N,) bool, of which there are `count`."""
    runs = np.empty((count, 2), np.int32)
    at = 0
    start = 0
    before = False
    for i in range(len(mask)):
        if mask[i] != before:
            before = mask[i]
            if before:
                start = i
            else:
                runs[at, 0] = start
                runs[at, 1] = i - start
                at += 1
    if before:
        runs[at, 0] = start
        runs[at, 1] = len(mask) - start
    return runs


@kernel
def flag_mask(marks: np.ndarray, care: int, value: int) -> np.ndarray:
    """Whether each splat's flags within `care` are exactly `value`: (N,) bool."""
    mask = np.empty(len(marks), np.bool_)
    care_bits, expected = np.uint32(care), np.uint32(value)
    for i in range(len(marks)):
        mask[i] = (marks[i] & care_bits) == expected
    return mask


@kernel
def fill_mask(runs: np.ndarray, mask: np.ndarray) -> None:
    """Sets `mask` (N,) bool to True in the runs."""
    for r in range(len(runs)):
        start = runs[r, 0]
        mask[start : start + runs[r, 1]] = True


@kernel
def toggle_runs(marks: np.ndarray, runs: np.ndarray, bits: int) -> None:
    """Flips `bits` in the runs: its own inverse."""
    flipped = np.uint32(bits)
    for r in range(len(runs)):
        run = marks[runs[r, 0] : runs[r, 0] + runs[r, 1]]
        for i in range(len(run)):
            run[i] ^= flipped


@kernel
def toggle_mask(marks: np.ndarray, mask: np.ndarray, bits: int) -> None:
    """Flips `bits` where `mask` (N,) bool is true; without a branch, for scattered splats."""
    flipped = np.uint32(bits)
    for i in range(len(marks)):
        marks[i] ^= flipped * np.uint32(mask[i])


@kernel
def remap(marks: np.ndarray, mask: np.ndarray, lookup: np.ndarray) -> None:
    """Where `mask` (N,) bool is true, entry e of the palette becomes lookup[e] (uint32)."""
    for i in range(len(marks)):
        mark = marks[i]
        entry = mark >> np.uint32(PALETTE_SHIFT)
        flip = (entry ^ lookup[entry]) << np.uint32(PALETTE_SHIFT)
        marks[i] = mark ^ (flip * np.uint32(mask[i]))


@kernel
def flag_counts(marks: np.ndarray) -> np.ndarray:
    """(6,) int64, numbers of splats: selected; hidden and not deleted; deleted; locked and not deleted;
    neither hidden nor deleted; neither hidden, deleted nor locked."""
    selected = hidden = deleted = locked = shown = free = 0
    # Sums of single bits, without a branch: the compiler makes vectors of them.
    for i in range(len(marks)):
        m = marks[i]
        kept = np.int64(~m >> np.uint32(2)) & 1
        hides = np.int64(m >> np.uint32(1) | m >> np.uint32(5)) & 1
        locks = np.int64(m >> np.uint32(3) | m >> np.uint32(6)) & 1
        selected += np.int64(m) & 1
        hidden += hides & kept
        deleted += 1 - kept
        locked += locks & kept
        shown += kept & (1 - hides)
        free += kept & (1 - hides) & (1 - locks)
    return np.array([selected, hidden, deleted, locked, shown, free])


@kernel
def file_counts(marks: np.ndarray, owners: np.ndarray, files: int) -> np.ndarray:
    """(files,) int64: number of splats of each file that are not deleted; owners (N,) uint16."""
    counts = np.zeros((files, 2), np.int64)
    for i in range(len(marks)):
        counts[owners[i], np.int64((marks[i] & np.uint32(DELETED)) != 0)] += 1
    return counts[:, 0].copy()


@kernel
def entry_usage(marks: np.ndarray, mask: np.ndarray, entries: int) -> np.ndarray:
    """(2, entries) int64: number of splats by palette index; of all, and of those in `mask` (N,) bool."""
    # Four tables take turns: a count need not wait for the one before it.
    counts = np.zeros((4, entries, 2), np.int64)
    for i in range(len(marks)):
        counts[i & 3, marks[i] >> np.uint32(PALETTE_SHIFT), np.int64(mask[i])] += 1
    outside, inside = np.zeros(entries, np.int64), np.zeros(entries, np.int64)
    for table in range(4):
        outside += counts[table, :, 0]
        inside += counts[table, :, 1]
    return np.stack((outside + inside, inside))


@kernel
def selection_change(marks: np.ndarray, hits: np.ndarray, visible: np.ndarray, table: int) -> np.ndarray:
    """Whether each splat changes between selected and not: (N,) bool.

    A splat counts as hit if it is in `hits` and `visible`, (N,) bool each, and neither hidden, deleted nor
    locked; bit 2·selected + hit of `table` says whether it is selected afterwards.
    """
    changed = np.empty(len(marks), np.bool_)
    # Of a splat that was not selected (hit), and of one that was (missed, hit): whether that changes.
    if_new, if_missed, if_hit = bool(table & 2), not table & 4, not table & 8
    for i in range(len(marks)):
        mark = marks[i]
        selected = (mark & np.uint32(1)) != 0
        hit = hits[i] & visible[i] & ((mark & np.uint32(NOT_SELECTABLE)) == 0)
        missed = selected & (not hit)
        changed[i] = (missed & if_missed) | (hit & selected & if_hit) | (hit & (not selected) & if_new)
    return changed


@kernel
def cropped_in(
    start: int,
    stop: int,
    places: Places,
    crops: np.ndarray,
    only: int,
    kept: np.ndarray,
) -> None:
    """kept[start:stop] (N,) bool: whether the crops, (C, CROP_ROW) as `crop_rows`, keep each splat, as in
    `scene.edits.inside_crops`. Splats without any flag in `only` (0: all count) are kept unseen."""
    any_inside = False
    for c in range(len(crops)):
        any_inside = any_inside or crops[c, 13] == 1
    looked_at = np.uint32(only)
    for i in range(start, stop):
        mark = places.marks[i]
        if (only != 0 and (mark & looked_at) == 0) or (mark & np.uint32(FILE_LOCKED)) != 0:
            kept[i] = True
            continue
        x, y, z = place(places, i)
        inside_one = not any_inside
        outside_all = True
        for c in range(len(crops)):
            row = crops[c]
            u = row[0] * x + row[1] * y + row[2] * z + row[3]
            v = row[4] * x + row[5] * y + row[6] * z + row[7]
            w = row[8] * x + row[9] * y + row[10] * z + row[11]
            # Without short circuits, whose branches are unpredictable.
            in_box = (abs(u) <= 1) & (abs(v) <= 1) & (abs(w) <= 1)
            in_ball = u * u + v * v + w * w <= 1
            contains = in_ball if row[12] == 1 else in_box
            keeps_inside = row[13] == 1
            inside_one |= contains & keeps_inside
            outside_all &= not (contains & (not keeps_inside))
        kept[i] = inside_one & outside_all


@kernel
def set_highlight(marks: np.ndarray, mask: np.ndarray) -> tuple[int, int, int]:
    """Sets the flag PREVIEW (16) where `mask` (N,) is true and the splat is neither hidden, deleted nor
    locked, and clears it elsewhere; a mask of length 0 clears all. Returns the number of splats with the
    flag, and the run (start, stop) of those that changed."""
    count = 0
    start, stop = len(marks), 0
    any_highlighted = len(mask) > 0
    for i in range(len(marks)):
        before = marks[i]
        highlighted = any_highlighted and mask[i] and (before & np.uint32(NOT_SELECTABLE)) == 0
        after = (before | np.uint32(16)) if highlighted else (before & np.uint32(0xFFFFFFEF))
        count += highlighted
        if after != before:
            marks[i] = after
            start = min(start, i)
            stop = i + 1
    return count, start, stop


class View(NamedTuple):
    """A camera in the kernels' form."""

    R: np.ndarray
    """(3, 3) float64, world to camera."""
    eye: np.ndarray
    """(3,) float64."""
    fx: float
    fy: float
    cx: float
    cy: float
    orthographic: bool


def view_of(camera: Camera) -> View:
    return View(
        np.ascontiguousarray(camera.R_camera_world),
        camera.eye,
        float(camera.fx),
        float(camera.fy),
        float(camera.cx),
        float(camera.cy),
        camera.orthographic,
    )


def image_points(start: int, stop: int, places: Places, camera: Camera, near: float) -> np.ndarray:
    """(stop - start, 2) float64: pixels of the means of splats start to stop; NaN before `near` and outside
    the lens's field of view."""
    points = np.empty((stop - start, 2))
    if camera.lens is None:
        project_places(start, stop, places, view_of(camera), near, points)
        return points
    slopes = view_of(camera)._replace(fx=1.0, fy=1.0, cx=0.0, cy=0.0)
    project_places(start, stop, places, slopes, near, points)
    return camera.image_points(np.column_stack([points, np.ones(len(points))]))


@kernel
def project_places(start, stop, places, view, near, points):
    """points (stop - start, 2) float64: pixels of the means of splats start to stop; NaN before `near`."""
    R, eye = view.R, view.eye
    for i in range(start, stop):
        x, y, z = place(places, i)
        x, y, z = x - eye[0], y - eye[1], z - eye[2]
        depth = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        if depth >= near:
            right = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
            down = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
            away = 1.0 if view.orthographic else depth
            points[i - start, 0] = view.fx * right / away + view.cx
            points[i - start, 1] = view.fy * down / away + view.cy
        else:
            points[i - start, 0] = np.nan
            points[i - start, 1] = np.nan


@kernel
def in_volume(start, stop, places, unit, ellipsoid, inside):
    """inside[start:stop]: whether means are in the unit box or ball when transformed by `unit` (3, 4)."""
    for i in range(start, stop):
        x, y, z = place(places, i)
        u = unit[0, 0] * x + unit[0, 1] * y + unit[0, 2] * z + unit[0, 3]
        v = unit[1, 0] * x + unit[1, 1] * y + unit[1, 2] * z + unit[1, 3]
        w = unit[2, 0] * x + unit[2, 1] * y + unit[2, 2] * z + unit[2, 3]
        if ellipsoid:
            inside[i] = u * u + v * v + w * w <= 1
        else:
            inside[i] = (abs(u) <= 1) & (abs(v) <= 1) & (abs(w) <= 1)


@kernel
def _positions(start, stop, places, positions):
    for i in range(start, stop):
        positions[i, 0], positions[i, 1], positions[i, 2] = place(places, i)


def shown_positions(gaussians: Gaussians, edits: SceneEdits) -> tuple[np.ndarray, np.ndarray]:
    """Indices (M,) int64, ascending, of shown splats with finite positions, and these positions (M, 3)
    float64."""
    positions = positions_of(gaussians, edits)
    indices = np.flatnonzero(shown(gaussians, edits) & np.isfinite(positions).all(axis=1))
    return indices, positions[indices]


def positions_of(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """(N, 3) float64, as `scene.edits.adjusted_means`."""
    positions = np.empty((len(gaussians), 3))
    places = places_of(gaussians, edits)
    in_pieces(len(gaussians), lambda start, stop: _positions(start, stop, places, positions))
    return positions
