"""How a viewer lights up splats that an editor has marked. A picture for keeping is drawn without."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...scene.edits import LOCKED, PREVIEW, SELECTED, SceneEdits

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
