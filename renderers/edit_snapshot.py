"""Edits as they stood when a picture was asked for: what another thread may draw in its own time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from splatview.raster.compiling import kernel
from splatview.renderers.request import TINT_COUNT, Highlight, Tint
from splatview.scene.edits import PALETTE_SHIFT, Adjustment, SceneEdits

SHIFT, FLAG_SETS = PALETTE_SHIFT, TINT_COUNT
"""As constants that the compiler sees."""


def tinted(edits: SceneEdits, highlight: Highlight) -> SceneEdits:
    """The edits, and what `highlight` lights up; their flags stay. Marks are an array of their own, unless
    nothing is lit up."""
    table = highlight.table
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


@dataclass(frozen=True, eq=False)
class EditSnapshot:
    """One object as long as the picture is the same, see `edit_snapshot`."""

    source: SceneEdits
    """The editor's, which goes on writing to its marks."""
    highlight: Highlight | None
    kept: SceneEdits
    """Likewise, with marks of its own."""

    def shows(self, edits: SceneEdits, highlight: Highlight | None) -> bool:
        """Whether these give the same picture, as far as can be told without reading marks."""
        mine = self.source
        return self.highlight == highlight and (
            mine is edits
            or (
                (mine.marks is edits.marks and mine.marks_version == edits.marks_version)
                and (mine.palette, mine.crops_in_force, mine.flags)
                == (edits.palette, edits.crops_in_force, edits.flags)
            )
        )


def edit_snapshot(
    edits: SceneEdits | None, highlight: Highlight | None, before: EditSnapshot | None
) -> EditSnapshot | None:
    """What of `edits` shows in a picture; None: nothing, `before` if that is still it. Costs a copy of the
    marks (a third of a millisecond for a million splats) where they have changed."""
    if edits is None:
        return None
    lit = highlight if highlight is not None and highlight.applies_to(edits) else None
    if lit is None and not edits.in_force:
        return None
    if before is not None and before.shows(edits, lit):
        return before
    return EditSnapshot(edits, lit, replace(edits, marks=edits.marks.copy(), changes=()))
