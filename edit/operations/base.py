"""Base of all operations: the numbers of a recipe's step, and the plan of the change that it makes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from splatview.edit.changes import Change, Part, Recrop, Refile, Toggle, readjust, splats_in_words
from splatview.edit.serialization import from_json, to_json
from splatview.edit.state import SceneFile, SplatSet, State
from splatview.scene import InputError
from splatview.scene.edits import ANY_LOCK, DELETED, SELECTED, Adjustment, Crop, quat_product
from splatview.scene.progress import NO_PROGRESS, Progress


@dataclass(frozen=True, kw_only=True)
class Operation(ABC):
    """One kind of editing, with its parameters.

    Raises:
        ValueError: a number makes no sense; the message names the field.
    """

    op: ClassVar[str]
    """Name in a recipe."""
    summary: ClassVar[str]
    """One sentence for the user."""
    alters_file: ClassVar[bool] = True
    """Whether a file written after it differs; not by what is only selected, hidden or locked."""

    @abstractmethod
    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        """The change that it makes to `state` as it is now; alters nothing itself.

        Raises:
            InputError: it cannot be done here.
        """

    def to_json(self) -> dict[str, Any]:
        return {"op": self.op, **to_json(self)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        """`data` without its key ``op``. Raises InputError that names the field."""
        return from_json(cls, data)


Scope = Literal["selection", "scene"]
"""Splats of an operation: the scene is all but deleted and locked ones, so hidden and cropped ones go
along."""


def check_scope(scope: str) -> None:
    if scope not in ("selection", "scene"):
        raise ValueError(f"scope must be selection or scene, got {scope!r}")


def splats_of(state: State, scope: Scope) -> SplatSet:
    return state.selected if scope == "selection" else state.splats(DELETED | ANY_LOCK, 0)


def adjusting(state: State, scope: Scope, adjustment: Adjustment, verb: str) -> Change:
    """The change that applies `adjustment` to the splats; crops and files go along where the whole scene
    moves."""
    splats = splats_of(state, scope)
    parts: list[Part] = []
    if len(splats) and adjustment != Adjustment():
        parts.append(readjust(state, splats, adjustment))
        if scope == "scene" and adjustment.moves and state.crops:
            moved = tuple(moved_crop(crop, adjustment) for crop in state.crops)
            parts.append(Recrop(state.crops, moved))
        if scope == "scene" and adjustment.moves:
            files = tuple(moved_file(file, adjustment) for file in state.files)
            parts.append(Refile(state.files, files))
    return Change(title=f"{verb} {splats_in_words(len(splats))}", count=len(splats), parts=tuple(parts))


def moved_crop(crop: Crop, adjustment: Adjustment) -> Crop:
    """The crop that keeps moved splats where `crop` kept them before the move."""
    rotation = quat_product(np.array(adjustment.rotation), np.array(crop.rotation))
    w, x, y, z = (rotation / np.linalg.norm(rotation)).tolist()
    cx, cy, cz = (adjustment.linear @ np.array(crop.centre) + np.array(adjustment.translation)).tolist()
    ex, ey, ez = (np.array(crop.half_extents) * adjustment.scale).tolist()
    return replace(crop, centre=(cx, cy, cz), half_extents=(ex, ey, ez), rotation=(w, x, y, z))


def moved_file(file: SceneFile, adjustment: Adjustment) -> SceneFile:
    """The file after `adjustment` of the whole scene. Raises InputError where that leaves the range of
    numbers."""
    if file.locked or file.removed:
        return file
    try:
        return replace(file, placement=file.placement.then(similar(adjustment)))
    except ValueError as error:
        raise InputError(f"{file.name}: after what was done before, {error}") from None


def similar(adjustment: Adjustment) -> Adjustment:
    """What `adjustment` does to positions, alone."""
    return Adjustment(
        rotation=adjustment.rotation, scale=adjustment.scale, translation=adjustment.translation
    )


def require_rewrite(state: State, attribute: str, count: int) -> None:
    """Raises InputError where there is no room for new values of `count` splats, computed in float64."""
    values = getattr(state.gaussians, attribute)
    state.require_room(values.nbytes + 6 * count * values[:1].nbytes)


def deleting(state: State, to_delete: np.ndarray, title: str, notes: tuple[str, ...] = ()) -> Change:
    """The change that deletes the splats `to_delete` (N,) bool, none of which is deleted yet."""
    splats = SplatSet.of_mask(to_delete)
    parts: list[Part] = []
    if len(splats):
        selected = SplatSet.of_mask(to_delete & ((state.marks & SELECTED) != 0))
        parts = [Toggle(selected, SELECTED)] if len(selected) else []
        parts.append(Toggle(splats, DELETED))
    return Change(title=title, count=len(splats), parts=tuple(parts), notes=notes)
