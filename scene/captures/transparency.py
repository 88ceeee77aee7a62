"""What the transparency of photos says: that nothing is there, as around an object that was cut out; or only
that nobody knows what is, as where a photo that was taken out of its lens, or turned, shows nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatview.scene.captures.capture import Pixels

LEAST_PHOTOS = 0.5
"""Share of the photos that are transparent where that says what is empty: the others would show what these
say is not there. Close views of an object may show nothing else, so it need not be all."""

LEAST_SHOWN, ALIKE = 0.5, 0.97
"""Share of a photo that shows something, and of what either of two photos shows, that both do, from which on
all are transparent in the same place: a rim. Objects of the bench that are cut out fill 9 to 43 % of their
photos, and look different from every side; docs/training-recipe.md has what a rim costs that is not told."""

GONE_ALIKE = 0.5
"""Share of what either of two photos does not show that both do not, from which on that is the same place,
too: photos that an object fills are alike in what they show. Of `skull close 80`, 98 % of whose pixels show
the skull, it is 0.12 (chosen), of `playbot close 80` 0.21, of a rim by one lens 1."""

CELLS, OPAQUE = 64, 250
"""Places of a photo that are looked at, each way, and the opacity of what hides what is behind."""


def outline_of(alpha: np.ndarray) -> np.ndarray:
    """(CELLS, CELLS) bool: where a photo shows something, by its opacity (H, W) uint8."""
    rows, columns = ((np.arange(CELLS) + 0.5) * size // CELLS for size in alpha.shape)
    return alpha[np.ix_(rows.astype(int), columns.astype(int))] >= 128


def unknown_for(outlines: Sequence[np.ndarray], photos: int, faces: int = 1) -> str | None:
    """Why what the transparent of so many photos do not show is unknown, by the outlines of these, so many of
    which in a row are faces of one panorama; None where it is empty."""
    if not outlines:
        return None
    if len(outlines) < LEAST_PHOTOS * photos:
        return "most photos show something everywhere"
    shown = np.stack(outlines)
    # Neighbours are like one another in any case, and a face is compared with the same one of another file.
    other = np.roll(shown, max(len(shown) // 3 // faces, 1) * faces, axis=0)
    shown_alike = (shown & other).sum() >= ALIKE * (shown | other).sum()
    gone_alike = (~shown & ~other).sum() >= GONE_ALIKE * (~shown | ~other).sum()
    if len(shown) > 1 and shown.mean() >= LEAST_SHOWN and shown_alike and gone_alike:
        return "all are so in the same place, as around what a lens has seen"
    return None


def without_unknown(pixels: Pixels) -> Pixels:
    """A photo of which what is not opaque does not count."""
    if pixels.alpha is None:
        return pixels
    shown = pixels.alpha >= OPAQUE
    mask = shown if pixels.mask is None else shown & pixels.mask
    mask.flags.writeable = False
    return replace(pixels, mask=None if mask.all() else mask, alpha=None)
