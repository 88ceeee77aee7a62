"""The loops over all marks of a scene: a pass over five million takes some milliseconds.

Runs are (R, 2) int32, start and count each, ascending and apart.
"""

from __future__ import annotations

import numpy as np

from .compiling import kernel

FLAG_BITS = 15
"""The state flags that editing is about: selected, hidden, deleted, locked."""

SHIFT = 8
"""`scene.edits.PALETTE_SHIFT`, as a constant that the compiler sees."""


@kernel
def mask_runs(mask: np.ndarray) -> np.ndarray:
    """The runs of True in `mask` (N,) bool."""
    n = len(mask)
    count = 0
    before = False
    for i in range(n):
        count += mask[i] and not before
        before = mask[i]
    runs = np.empty((count, 2), np.int32)
    at = -1
    before = False
    for i in range(n):
        if mask[i]:
            if not before:
                at += 1
                runs[at, 0] = i
                runs[at, 1] = 0
            runs[at, 1] += 1
        before = mask[i]
    return runs


@kernel
def flag_runs(marks: np.ndarray, care: int, value: int) -> np.ndarray:
    """The runs of splats whose flags within `care` are exactly `value`."""
    n = len(marks)
    care_bits, wanted = np.uint32(care), np.uint32(value)
    count = 0
    before = False
    for i in range(n):
        now = (marks[i] & care_bits) == wanted
        count += now and not before
        before = now
    runs = np.empty((count, 2), np.int32)
    at = -1
    before = False
    if count == 0:
        return runs
    for i in range(n):
        now = (marks[i] & care_bits) == wanted
        if now:
            if not before:
                at += 1
                runs[at, 0] = i
                runs[at, 1] = 0
            runs[at, 1] += 1
        before = now
    return runs


@kernel
def fill_mask(runs: np.ndarray, mask: np.ndarray) -> None:
    """Sets `mask` (N,) bool to True in the runs."""
    for r in range(len(runs)):
        start = runs[r, 0]
        mask[start : start + runs[r, 1]] = True


@kernel
def toggle(marks: np.ndarray, runs: np.ndarray, bits: int) -> None:
    """Flips `bits` in the runs: twice is as if never."""
    flipped = np.uint32(bits)
    for r in range(len(runs)):
        for i in range(runs[r, 0], runs[r, 0] + runs[r, 1]):
            marks[i] ^= flipped


@kernel
def flag_counts(marks: np.ndarray) -> np.ndarray:
    """(6,) int64: marks that are selected; hidden and not deleted; deleted; locked and not deleted; neither
    hidden nor deleted; neither hidden, deleted nor locked."""
    selected = hidden = deleted = locked = shown = free = 0
    # Sums of single bits, without a branch: the compiler makes vectors of them.
    for i in range(len(marks)):
        m = marks[i]
        kept = np.int64(~m >> np.uint32(2)) & 1
        hides = np.int64(m >> np.uint32(1)) & 1
        locks = np.int64(m >> np.uint32(3)) & 1
        selected += np.int64(m) & 1
        hidden += hides & kept
        deleted += 1 - kept
        locked += locks & kept
        shown += kept & (1 - hides)
        free += kept & (1 - hides) & (1 - locks)
    return np.array([selected, hidden, deleted, locked, shown, free])


@kernel
def entry_usage(marks: np.ndarray, entries: int) -> np.ndarray:
    """(entries,) int64: how many marks name each entry of the palette."""
    usage = np.zeros(entries, np.int64)
    for i in range(len(marks)):
        usage[marks[i] >> np.uint32(SHIFT)] += 1
    return usage


@kernel
def entry_usage_in(marks: np.ndarray, runs: np.ndarray, entries: int) -> np.ndarray:
    """As `entry_usage`, of the marks in the runs."""
    usage = np.zeros(entries, np.int64)
    for r in range(len(runs)):
        for i in range(runs[r, 0], runs[r, 0] + runs[r, 1]):
            usage[marks[i] >> np.uint32(SHIFT)] += 1
    return usage


@kernel
def remap(marks: np.ndarray, runs: np.ndarray, lookup: np.ndarray) -> None:
    """In the runs, entry e of the palette becomes lookup[e] (uint32)."""
    for r in range(len(runs)):
        for i in range(runs[r, 0], runs[r, 0] + runs[r, 1]):
            flags = marks[i] & np.uint32(255)
            marks[i] = flags | (lookup[marks[i] >> np.uint32(SHIFT)] << np.uint32(SHIFT))


@kernel
def take_entries(marks: np.ndarray, runs: np.ndarray, out: np.ndarray) -> None:
    """The entries of the marks in the runs, one after the other, into `out`, any unsigned type."""
    at = 0
    for r in range(len(runs)):
        for i in range(runs[r, 0], runs[r, 0] + runs[r, 1]):
            out[at] = marks[i] >> np.uint32(SHIFT)
            at += 1


@kernel
def put_entries(marks: np.ndarray, runs: np.ndarray, values: np.ndarray) -> None:
    """The reverse of `take_entries`."""
    at = 0
    for r in range(len(runs)):
        for i in range(runs[r, 0], runs[r, 0] + runs[r, 1]):
            flags = marks[i] & np.uint32(255)
            marks[i] = flags | (np.uint32(values[at]) << np.uint32(SHIFT))
            at += 1


@kernel
def selection_change(marks: np.ndarray, wanted: np.ndarray, visible: np.ndarray, mode: int) -> np.ndarray:
    """Which splats change between selected and not: (N,) bool.

    `wanted` (N,) bool; `visible` (N,) bool, or of length 0 where no crop is in force. Mode 0 selects just
    what is wanted, 1 adds it, 2 removes it, 3 leaves of the selection what is wanted, 4 swaps it.
    Only what is neither hidden, deleted, locked nor cropped away becomes selected.
    """
    changed = np.empty(len(marks), np.bool_)
    cropped = len(visible) > 0
    for i in range(len(marks)):
        flags = marks[i] & np.uint32(FLAG_BITS)
        selected = (flags & np.uint32(1)) != 0
        hit = wanted[i] and (flags & np.uint32(14)) == 0
        if cropped:
            hit = hit and visible[i]
        if mode == 0:
            now = hit
        elif mode == 1:
            now = selected or hit
        elif mode == 2:
            now = selected and not hit
        elif mode == 3:
            now = selected and hit
        else:
            now = selected != hit
        changed[i] = now != selected
    return changed


@kernel
def cropped_in(
    means: np.ndarray, marks: np.ndarray, palette: np.ndarray, crops: np.ndarray, only: int
) -> np.ndarray:
    """Which splats the crops leave, where the palette puts them: (N,) bool, as `scene.crop.cropped_in`.

    `palette`: `adjustment_rows`; `crops`: `crop_rows`, both about the origin. Splats without any flag in
    `only` (0: all count) are not looked at and stay.
    """
    n = len(means)
    kept = np.ones(n, np.bool_)
    any_inside = False
    for c in range(len(crops)):
        any_inside = any_inside or crops[c, 13] == 1
    looked_at = np.uint32(only)
    for i in range(n):
        if only != 0 and (marks[i] & looked_at) == 0:
            continue
        x, y, z = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
        entry = marks[i] >> np.uint32(SHIFT)
        if entry > 0:
            p = palette[entry]
            x, y, z = (
                p[0] * x + p[1] * y + p[2] * z + p[3],
                p[4] * x + p[5] * y + p[6] * z + p[7],
                p[8] * x + p[9] * y + p[10] * z + p[11],
            )
        inside_one = not any_inside
        outside_all = True
        for c in range(len(crops)):
            row = crops[c]
            u = row[0] * x + row[1] * y + row[2] * z + row[3]
            v = row[4] * x + row[5] * y + row[6] * z + row[7]
            w = row[8] * x + row[9] * y + row[10] * z + row[11]
            if row[12] == 1:
                contains = u * u + v * v + w * w <= 1
            else:
                contains = abs(u) <= 1 and abs(v) <= 1 and abs(w) <= 1
            if row[13] == 1:
                inside_one = inside_one or contains
            elif contains:
                outside_all = False
        kept[i] = inside_one and outside_all
    return kept


@kernel
def light_up(marks: np.ndarray, mask: np.ndarray) -> tuple[int, int, int]:
    """Sets the flag PREVIEW (16) where `mask` (N,) is true and the splat is neither hidden, deleted nor
    locked, and clears it elsewhere; a mask of length 0 clears all. Returns how many have it, and the run
    (start, stop) of those that changed."""
    count = 0
    start, stop = len(marks), 0
    any_lit = len(mask) > 0
    for i in range(len(marks)):
        before = marks[i]
        lit = any_lit and mask[i] and (before & np.uint32(14)) == 0
        after = (before | np.uint32(16)) if lit else (before & np.uint32(0xFFFFFFEF))
        count += lit
        if after != before:
            marks[i] = after
            start = min(start, i)
            stop = i + 1
    return count, start, stop
