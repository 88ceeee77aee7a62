"""Edits in force, read while splats are loaded: no copy of the scene, and no instruction where there are
none.

A kernel's `edits` is an `EditArrays` or None, two types and so two kernel variants.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import inline
from splatview.scene.edits import (
    FILE_LOCKED,
    LARGEST_LOGIT,
    NOT_SHOWN,
    PALETTE_SHIFT,
    ROW,
    SceneEdits,
    adjustment_rows,
    crop_rows,
)

# Columns of `EditArrays.palette`, after those of `scene.edits.adjustment_rows`.
QUAT, COLOUR, OPACITY = 12, 16, 28
LOG_FACTOR, R_INVERSE, MOVES, FADES, RECOLOURS = ROW, ROW + 1, ROW + 10, ROW + 11, ROW + 12
COLUMNS = ROW + 13

# Columns of `scene.edits.crop_rows`.
IS_SPHERE, KEEPS_INSIDE = 12, 13


class EditArrays(NamedTuple):
    """`scene.edits.SceneEdits` in the kernels' form."""

    marks: np.ndarray
    """(N,) uint32, splat flags and palette index."""
    palette: np.ndarray
    """(P, COLUMNS) float64, adjustments."""
    crops: np.ndarray
    """(C, CROP_ROW) float64."""
    keeps_inside: bool
    """Whether a crop keeps its inside: then only splats within such a crop are shown."""


def edit_arrays(edits: SceneEdits | None, count: int) -> EditArrays | None:
    """None where nothing is in force.

    Raises:
        ValueError: the marks are not those of `count` splats.
    """
    if edits is None or not edits.in_force:
        return None
    marks = edits.marks
    if not isinstance(marks, np.ndarray) or marks.shape != (count,) or marks.dtype != np.uint32:
        raise ValueError(f"edits.marks must be uint32 ({count},), got {getattr(marks, 'shape', type(marks))}")
    palette = np.zeros((len(edits.palette), COLUMNS))
    palette[:, :ROW] = adjustment_rows(edits.palette)
    for row, adjustment in zip(palette, edits.palette, strict=True):
        row[LOG_FACTOR] = math.log(adjustment.scale) + math.log(adjustment.size)
        row[R_INVERSE : R_INVERSE + 9] = adjustment.R.T.ravel()
        row[MOVES] = adjustment.moves
        row[FADES] = adjustment.opacity != type(adjustment)().opacity
        row[RECOLOURS] = adjustment.colour != type(adjustment)().colour
    crops = crop_rows(edits.crops)
    return EditArrays(np.ascontiguousarray(marks), palette, crops, bool((crops[:, KEEPS_INSIDE] > 0).any()))


@inline
def palette_row(edits, splat):
    """The row of the palette that a splat names, len(palette) if it names one that is not there."""
    return min(np.int64(edits.marks[splat]) >> PALETTE_SHIFT, edits.palette.shape[0])


@inline
def is_shown(edits, splat, x, y, z):
    """Whether a splat is neither hidden nor deleted, and its adjusted mean not cropped away."""
    mark = np.int64(edits.marks[splat])
    if mark & NOT_SHOWN:
        return False
    if mark & FILE_LOCKED:
        return True
    kept = not edits.keeps_inside
    removed = False
    for index in range(edits.crops.shape[0]):
        crop = edits.crops[index]
        u = crop[0] * x + crop[1] * y + crop[2] * z + crop[3]
        v = crop[4] * x + crop[5] * y + crop[6] * z + crop[7]
        w = crop[8] * x + crop[9] * y + crop[10] * z + crop[11]
        if crop[IS_SPHERE] > 0:
            within = u * u + v * v + w * w <= 1
        else:
            within = abs(u) <= 1 and abs(v) <= 1 and abs(w) <= 1
        if crop[KEEPS_INSIDE] > 0:
            kept = kept or within
        else:
            removed = removed or within
    return kept and not removed


@inline
def moved(row, x, y, z):
    """scale·R·(x, y, z) + translation."""
    return (
        row[0] * x + row[1] * y + row[2] * z + row[3],
        row[4] * x + row[5] * y + row[6] * z + row[7],
        row[8] * x + row[9] * y + row[10] * z + row[11],
    )


@inline
def turned(row, w, x, y, z):
    """The palette's quaternion times (w, x, y, z)."""
    a, b, c, d = row[QUAT], row[QUAT + 1], row[QUAT + 2], row[QUAT + 3]
    return (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )


@inline
def faded(row, logit):
    """The logit of the adjusted opacity; NaN of NaN."""
    opacity = row[OPACITY] / (1.0 + math.exp(-logit)) + row[OPACITY + 1]
    opacity = min(max(opacity, row[OPACITY + 2]), row[OPACITY + 3])
    changed = math.log(opacity) - math.log1p(-opacity)
    return min(max(changed, -LARGEST_LOGIT), LARGEST_LOGIT) + (logit - logit if logit != logit else 0.0)


@inline
def turned_back(row, x, y, z):
    """A direction as the splat saw it before it was turned: SH are evaluated there, not turned."""
    at = R_INVERSE
    return (
        row[at] * x + row[at + 1] * y + row[at + 2] * z,
        row[at + 3] * x + row[at + 4] * y + row[at + 5] * z,
        row[at + 6] * x + row[at + 7] * y + row[at + 8] * z,
    )


@inline
def recoloured(row, red, green, blue):
    at = COLOUR
    return (
        row[at] * red + row[at + 1] * green + row[at + 2] * blue + row[at + 3],
        row[at + 4] * red + row[at + 5] * green + row[at + 6] * blue + row[at + 7],
        row[at + 8] * red + row[at + 9] * green + row[at + 10] * blue + row[at + 11],
    )
