"""What every operation is: data that says what to do, and a plan of what that alters."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from splatview.edit.changes import Change, Part, Recrop, Toggle, readjust, splats_in_words
from splatview.edit.serialization import from_json, to_json
from splatview.edit.state import SplatSet
from splatview.scene.edits import DELETED, LOCKED, SELECTED, Adjustment, Crop, quat_product
from splatview.scene.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from splatview.edit.document import Document


@dataclass(frozen=True, kw_only=True)
class Operation(ABC):
    """One kind of editing, with the numbers that it needs.

    Raises:
        ValueError: a number makes no sense; the message names the field.
    """

    op: ClassVar[str]
    """Its name in a recipe."""
    summary: ClassVar[str]
    """One sentence for people who look for it."""

    @abstractmethod
    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        """What it alters, as the document stands. Alters nothing itself.

        Raises:
            InputError: it cannot be done here.
        """

    def to_json(self) -> dict[str, Any]:
        return {"op": self.op, **to_json(self)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        """`data` without its key ``op``. Raises InputError that names the field."""
        return from_json(cls, data)


# ---- Which splats an operation is about, and what giving them an adjustment alters.


Scope = Literal["selection", "scene"]
"""The scene is all splats but deleted and locked ones: hidden and cropped ones go along."""


def check_scope(scope: str) -> None:
    if scope not in ("selection", "scene"):
        raise ValueError(f"scope must be selection or scene, got {scope!r}")


def splats_of(document: Document, scope: Scope) -> SplatSet:
    return document.selected if scope == "selection" else document.splats(DELETED | LOCKED, 0)


def adjusting(document: Document, scope: Scope, adjustment: Adjustment, verb: str) -> Change:
    """The change that puts `adjustment` on the splats; where the whole scene moves, crops move too."""
    splats = splats_of(document, scope)
    parts: list[Part] = []
    if len(splats) and adjustment != Adjustment():
        parts.append(readjust(document.state, splats, adjustment))
        if scope == "scene" and adjustment.moves and document.crops:
            moved = tuple(moved_crop(crop, adjustment) for crop in document.crops)
            parts.append(Recrop(document.crops, moved))
    return Change(title=f"{verb} {splats_in_words(len(splats))}", count=len(splats), parts=tuple(parts))


def moved_crop(crop: Crop, adjustment: Adjustment) -> Crop:
    """The crop that leaves of moved splats what `crop` left of them before."""
    rotation = quat_product(np.array(adjustment.rotation), np.array(crop.rotation))
    w, x, y, z = (rotation / np.linalg.norm(rotation)).tolist()
    cx, cy, cz = (adjustment.linear @ np.array(crop.centre) + np.array(adjustment.translation)).tolist()
    ex, ey, ez = (np.array(crop.half_extents) * adjustment.scale).tolist()
    return Crop(
        name=crop.name,
        shape=crop.shape,
        centre=(cx, cy, cz),
        half_extents=(ex, ey, ez),
        rotation=(w, x, y, z),
        keep=crop.keep,
        enabled=crop.enabled,
    )


def deleting(document: Document, doomed: np.ndarray, title: str, notes: tuple[str, ...] = ()) -> Change:
    """The change that deletes `doomed` (N,) bool, none of which is deleted yet."""
    splats = SplatSet.of_mask(doomed)
    parts: list[Part] = []
    if len(splats):
        selected = SplatSet.of_mask(doomed & ((document.marks & SELECTED) != 0))
        parts = [Toggle(selected, SELECTED)] if len(selected) else []
        parts.append(Toggle(splats, DELETED))
    return Change(title=title, count=len(splats), parts=tuple(parts), notes=notes)
