"""How a viewer lights up splats that an editor has marked. A picture for keeping is drawn without."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...scene.adjustment import Adjustment
from ...scene.edits import LOCKED, PALETTE_SHIFT, PREVIEW, SELECTED, SceneEdits

TINT_COUNT = 2 * PREVIEW
"""Rows of a table of tints: one for each set of state flags."""

Tint = tuple[float, float, float, float]
"""RGB and strength: colour' = (1 - strength)·colour + strength·RGB."""


@dataclass(frozen=True, kw_only=True)
class Overlay:
    """Tints of marked splats; a strength of 0 leaves them as they are. Of several marks the first counts."""

    preview: Tint = (1.0, 0.08, 0.05, 0.7)
    selected: Tint = (1.0, 0.72, 0.05, 0.55)
    locked: Tint = (0.12, 0.2, 0.4, 0.6)

    @property
    def flags(self) -> int:
        """State flags that are lit up."""
        pairs = ((PREVIEW, self.preview), (SELECTED, self.selected), (LOCKED, self.locked))
        return sum(flag for flag, tint in pairs if tint[3] > 0)

    @property
    def table(self) -> np.ndarray:
        """(TINT_COUNT, 4) float32: the tint of a splat whose mark is m is row m % TINT_COUNT."""
        table = np.zeros((TINT_COUNT, 4), np.float32)
        marks = np.arange(TINT_COUNT)
        for flag, tint in ((LOCKED, self.locked), (SELECTED, self.selected), (PREVIEW, self.preview)):
            if tint[3] > 0:
                table[(marks & flag) != 0] = tint
        return table

    def lights(self, edits: SceneEdits) -> bool:
        """Whether some splats may be lit up."""
        return bool(self.flags & edits.flags)


def tinted(edits: SceneEdits, overlay: Overlay) -> SceneEdits:
    """The edits with tints as colour maps of further adjustments: for renderers that know no overlay.

    Its marks are an array of their own, whose flags are those of `edits`.
    """
    tints, tint_of = np.unique(overlay.table, axis=0, return_inverse=True)
    marks = edits.marks
    pairs = (marks >> PALETTE_SHIFT).astype(np.int64) * len(tints)
    pairs += tint_of.ravel()[marks & (TINT_COUNT - 1)]
    used, place = np.unique(pairs, return_inverse=True)
    palette = list(edits.palette)
    entries = np.empty(len(used), np.uint32)
    for number, pair in enumerate(used.tolist()):
        entry, tint = divmod(pair, len(tints))
        entries[number] = entry
        if tints[tint, 3] > 0:
            entries[number] = len(palette)
            palette.append(edits.palette[entry].then(_colour_map(tints[tint])))
    flags = marks & ((1 << PALETTE_SHIFT) - 1)
    return replace(
        edits,
        marks=flags | entries[place.ravel()] << PALETTE_SHIFT,
        palette=tuple(palette),
        changes=(),
    )


def _colour_map(tint: np.ndarray) -> Adjustment:
    """Of a row of `Overlay.table`."""
    kept, added = np.eye(3) * (1 - float(tint[3])), tint[:3, None].astype(np.float64) * float(tint[3])
    red, green, blue = np.hstack([kept, added]).tolist()
    return Adjustment(colour=(tuple(red), tuple(green), tuple(blue)))
