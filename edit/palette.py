"""Giving splats another adjustment: one entry of the palette for all that are alike, none without use."""

from __future__ import annotations

import numpy as np

from ..scene import InputError
from ..scene.adjustment import IDENTITY, Adjustment
from ..scene.edits import MOST_ADJUSTMENTS, PALETTE_SHIFT
from .changes import Readjust, SplatEntries
from .loops import marks as kernels
from .runs import SplatSet
from .state import State


def readjust(state: State, splats: SplatSet, later: Adjustment) -> Readjust:
    """What puts `later` after the adjustments that `splats` have.

    Entries that only these splats used are used again for them, so moving one selection a thousand times
    takes one entry, and moving all splats writes to no mark.

    Raises:
        InputError: the adjustments together leave the range of numbers.
    """
    before = state.palette
    # Deleted splats count: undoing brings them back with what they had.
    usage, moved = np.array([[len(state.marks)], [len(splats)]])
    if len(before) > 1:
        usage, moved = kernels.entry_usage(state.marks, splats.mask, len(before))
    staying = usage > moved
    staying[0] = True
    after = [entry if stays else IDENTITY for entry, stays in zip(before, staying, strict=True)]
    slots: dict[Adjustment, int] = {}
    for slot in np.flatnonzero(staying):
        slots.setdefault(before[slot], int(slot))
    lookup = np.arange(len(before), dtype=np.uint32)
    new: list[tuple[int, Adjustment]] = []
    for entry in np.flatnonzero(moved):
        adjustment = _then(before[entry], later)
        if adjustment in slots:
            lookup[entry] = slots[adjustment]
        else:
            new.append((int(entry), adjustment))
    free = set(np.flatnonzero(~staying).tolist())
    for entry, adjustment in new:
        if adjustment in slots:
            lookup[entry] = slots[adjustment]
            continue
        # Its own place where that has become free: then no mark has to change.
        slot = entry if entry in free else min(free, default=len(after))
        if slot == len(after):
            after.append(adjustment)
        free.discard(slot)
        after[slot] = adjustment
        slots[adjustment] = slot
        lookup[entry] = slot
    used = staying.tolist() + [True] * (len(after) - len(before))
    for slot in slots.values():
        used[slot] = True
    while not used[-1]:
        used.pop()
        after.pop()
    if len(after) > MOST_ADJUSTMENTS:
        raise InputError(f"the scene has {MOST_ADJUSTMENTS:,} differently edited groups of splats; no more")
    sources = np.flatnonzero(moved)
    if len(sources) == 1:
        bits = int(sources[0] ^ lookup[sources[0]]) << PALETTE_SHIFT
        return Readjust(splats, before, tuple(after), bits, bits)
    back = _back(state, splats, sources, lookup, len(after))
    return Readjust(splats, before, tuple(after), lookup, back)


def _then(first: Adjustment, later: Adjustment) -> Adjustment:
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return first.then(later)
    except ValueError as error:
        raise InputError(f"after what was done before, this leaves the range of numbers: {error}") from None


def _back(
    state: State, splats: SplatSet, sources: np.ndarray, lookup: np.ndarray, entries: int
) -> np.ndarray | SplatEntries:
    """What undoes `lookup` of the entries `sources`: an array if none of them become one."""
    targets = lookup[sources]
    if len(set(targets.tolist())) == len(targets):
        back = np.arange(entries, dtype=np.uint32)
        back[targets] = sources
        return back
    values = state.marks[splats.mask] >> np.uint32(PALETTE_SHIFT)
    return SplatEntries(values.astype(np.min_scalar_type(len(lookup))))
