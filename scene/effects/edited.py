"""Edits in force: what is left out, moved or recoloured, and what is only lit up."""

from __future__ import annotations

import math

import numpy as np

from ..adjustment import IDENTITY_COLOUR
from ..crop import cropped_in
from ..edits import DELETED, HIDDEN, PALETTE_SHIFT, SELECTED, SceneEdits, adjusted_means
from ..gaussians import Gaussians
from .effect import Effect, Saving

MARK_BYTES = 4
"""A splat, for its state and its adjustment."""

GRADE_OPERATIONS = 18
"""A 3x3 matrix and a sum."""

MOVE_OPERATIONS = 18 + 28
"""A similarity of the mean, and a product of quaternions."""

CROP_OPERATIONS = 21
"""A 3x4 matrix and a comparison of each axis, a crop."""


def edit_effects(gaussians: Gaussians, edits: SceneEdits | None) -> list[Effect]:
    """Of the edits in force; all off where there are none."""
    if edits is None:
        edits = SceneEdits(marks=np.zeros(len(gaussians), np.uint32))
    return [
        _selection(gaussians, edits),
        _hidden(gaussians, edits),
        _crop(gaussians, edits),
        _moves(gaussians, edits),
        _grade(gaussians, edits),
    ]


def _counted(name: str, count: int, of: int, what: str, none: str, saving: Saving) -> Effect:
    """An effect that is needed where it concerns a splat."""
    return Effect(
        name=name,
        on=count > 0,
        why=f"{count:,} of {of:,} splats {what}" if count else none,
        saving=saving,
        bound=math.inf if count else 0.0,
    )


def _marked(edits: SceneEdits, flags: int) -> int:
    return int(np.count_nonzero(edits.marks & flags)) if edits.flags & flags else 0


def _selection(gaussians: Gaussians, edits: SceneEdits) -> Effect:
    n = len(gaussians)
    return _counted(
        "selection",
        _marked(edits, SELECTED),
        n,
        "are selected and lit up",
        "nothing is selected",
        Saving(what="looking up a tint, at every splat"),
    )


def _hidden(gaussians: Gaussians, edits: SceneEdits) -> Effect:
    n = len(gaussians)
    return _counted(
        "hidden splats",
        _marked(edits, HIDDEN | DELETED),
        n,
        "are hidden or deleted",
        "no splat is hidden or deleted",
        Saving(bytes=n * MARK_BYTES),
    )


def _crop(gaussians: Gaussians, edits: SceneEdits) -> Effect:
    n, crops = len(gaussians), edits.crops_in_force
    if not crops:
        return _counted("crop", 0, n, "", "there is no crop", Saving())
    outside = n - int(cropped_in(crops, adjusted_means(gaussians, edits)).sum())
    # One that cuts nothing off is computed all the same: what lies outside it is known only then.
    return Effect(
        name="crop",
        on=True,
        why=f"{len(crops):,} in force, which leave {outside:,} of {n:,} splats out",
        saving=Saving(operations=n * len(crops) * CROP_OPERATIONS),
        bound=math.inf if outside else 0.0,
    )


def _entries(edits: SceneEdits, wanted: list[bool]) -> int:
    """Splats whose adjustment is one that is wanted, by its place in the palette."""
    if not any(wanted):
        return 0
    return int(np.array(wanted)[edits.marks >> PALETTE_SHIFT].sum())


def _moves(gaussians: Gaussians, edits: SceneEdits) -> Effect:
    n = len(gaussians)
    wanted = [
        entry.moves or entry.size != 1 or entry.opacity != (1.0, 0.0, 0.0, 1.0) for entry in edits.palette
    ]
    return _counted(
        "adjusted splats",
        _entries(edits, wanted),
        n,
        "are moved, resized or more or less opaque than in the file",
        "no splat is moved, resized or faded",
        Saving(operations=n * MOVE_OPERATIONS, bytes=n * MARK_BYTES),
    )


def _grade(gaussians: Gaussians, edits: SceneEdits) -> Effect:
    n = len(gaussians)
    return _counted(
        "colour grade",
        _entries(edits, [entry.colour != IDENTITY_COLOUR for entry in edits.palette]),
        n,
        "have another colour than in the file",
        "no colour is changed",
        Saving(operations=n * GRADE_OPERATIONS, bytes=n * MARK_BYTES),
    )
