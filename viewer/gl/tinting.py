"""Tints as colour maps of further adjustments: for renderers that know adjustments and no overlay."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from ...raster.compiling import kernel
from ...scene.adjustment import Adjustment
from ...scene.edits import PALETTE_SHIFT, SceneEdits
from .overlay import TINT_COUNT, Overlay, Tint

SHIFT, FLAG_SETS = PALETTE_SHIFT, TINT_COUNT
"""As constants that the compiler sees."""


def tinted(edits: SceneEdits, overlay: Overlay) -> SceneEdits:
    """The edits, and what `overlay` lights up; their flags stay. Marks are an array of their own, unless
    nothing is lit up."""
    table = overlay.table
    used = np.zeros(len(edits.palette) * FLAG_SETS, bool)
    note_pairs(edits.marks, used)
    entries = np.arange(len(used), dtype=np.uint32) // FLAG_SETS
    palette = list(edits.palette)
    made: dict[tuple[int, Tint], int] = {}
    for pair in np.flatnonzero(used).tolist():
        entry, flags = divmod(pair, FLAG_SETS)
        red, green, blue, strength = table[flags].tolist()
        if strength > 0:
            key = entry, (red, green, blue, strength)
            if key not in made:
                made[key] = len(palette)
                palette.append(lit_up(edits.palette[entry], key[1]))
            entries[pair] = made[key]
    if not made:
        return edits
    marks = np.empty_like(edits.marks)
    rename(edits.marks, entries, marks)
    return replace(edits, marks=marks, palette=tuple(palette), changes=())


@lru_cache(maxsize=1024)
def lit_up(adjustment: Adjustment, tint: Tint) -> Adjustment:
    red, green, blue, strength = tint
    kept = 1 - strength
    colour = (
        (kept, 0.0, 0.0, strength * red),
        (0.0, kept, 0.0, strength * green),
        (0.0, 0.0, kept, strength * blue),
    )
    return adjustment.then(Adjustment(colour=colour))


@kernel
def note_pairs(marks, used):
    """Sets `used` (P·FLAG_SETS,) bool where a mark has that adjustment and those flags."""
    for i in range(len(marks)):
        pair = np.int64(marks[i] >> SHIFT) * FLAG_SETS + np.int64(marks[i] & (FLAG_SETS - 1))
        if pair < len(used):  # else the mark is newer than the palette
            used[pair] = True


@kernel
def rename(marks, entries, renamed):
    """Writes marks (N,) uint32 with the adjustments that `entries` (P·FLAG_SETS,) uint32 gives to pairs."""
    for i in range(len(marks)):
        pair = np.int64(marks[i] >> SHIFT) * FLAG_SETS + np.int64(marks[i] & (FLAG_SETS - 1))
        entry = entries[pair] if pair < len(entries) else np.uint32(0)
        renamed[i] = np.uint32(marks[i] & ((1 << SHIFT) - 1)) | np.uint32(entry << SHIFT)
