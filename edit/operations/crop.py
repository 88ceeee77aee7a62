"""Operations on crop boxes and spheres."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from splatview.edit.changes import Change, Part, Recrop, Toggle, splats_in_words
from splatview.edit.operations.base import Operation, deleting
from splatview.edit.state import SplatSet, State
from splatview.scene import InputError
from splatview.scene.edits import ANY_LOCK, DELETED, SELECTED, Crop, shown
from splatview.scene.errors import printable
from splatview.scene.progress import NO_PROGRESS, Progress

MOST_CROPS = 64
"""Most crops: renderers evaluate all of them for each splat."""


@dataclass(frozen=True, kw_only=True)
class AddCrop(Operation):
    op: ClassVar[str] = "add_crop"
    summary: ClassVar[str] = "Add a crop box or sphere; nothing is deleted"

    crop: Crop

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        if len(state.crops) >= MOST_CROPS:
            raise InputError(f"there are {MOST_CROPS} crops already; remove one first")
        return _recropped(state, (*state.crops, self.crop), f"Add {self.crop.shape} {self.crop.name}")


@dataclass(frozen=True, kw_only=True)
class _OneCrop(Operation):
    index: int
    """Index of the crop, from 0."""

    def __post_init__(self) -> None:
        if not self.index >= 0:
            raise ValueError(f"index must be at least 0, got {self.index}")

    def _crop(self, state: State) -> Crop:
        if not self.index < len(state.crops):
            raise InputError(f"index {self.index}: there are {len(state.crops)} crops, counted from 0")
        return state.crops[self.index]

    def _replaced(self, state: State, *by: Crop) -> tuple[Crop, ...]:
        return (*state.crops[: self.index], *by, *state.crops[self.index + 1 :])


@dataclass(frozen=True, kw_only=True)
class ChangeCrop(_OneCrop):
    op: ClassVar[str] = "change_crop"
    summary: ClassVar[str] = "Move, turn, resize, rename or turn inside out a crop"

    crop: Crop

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        self._crop(state)
        return _recropped(state, self._replaced(state, self.crop), f"Change {self.crop.name}")


@dataclass(frozen=True, kw_only=True)
class RemoveCrop(_OneCrop):
    op: ClassVar[str] = "remove_crop"
    summary: ClassVar[str] = "Remove a crop; what it cut away is back"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        title = f"Remove {self._crop(state).name}"
        return _recropped(state, self._replaced(state), title)


@dataclass(frozen=True, kw_only=True)
class EnableCrop(_OneCrop):
    op: ClassVar[str] = "enable_crop"
    summary: ClassVar[str] = "Switch a crop on or off"

    enabled: bool

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        crop = replace(self._crop(state), enabled=self.enabled)
        title = f"Switch {crop.name} {'on' if self.enabled else 'off'}"
        return _recropped(state, self._replaced(state, crop), title)


@dataclass(frozen=True, kw_only=True)
class DeleteCropped(Operation):
    op: ClassVar[str] = "delete_cropped"
    summary: ClassVar[str] = "Delete what the crops cut away, and remove those crops"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        if not any(crop.enabled for crop in state.crops):
            raise InputError("no crop is in force that could be made permanent")
        # By the exporter's own arithmetic: a splat on the very surface must not change sides.
        outside = ~shown(state.gaussians, state.edits, hidden=True) & ((state.marks & DELETED) == 0)
        locked = outside & ((state.marks & ANY_LOCK) != 0)
        outside &= ~locked
        kept = tuple(crop for crop in state.crops if not crop.enabled)
        stay = int(np.count_nonzero(locked))
        title = f"Delete {splats_in_words(int(np.count_nonzero(outside)))} outside of the crops"
        notes = (f"{splats_in_words(stay)} outside stay: they are locked",) if stay else ()
        change = deleting(state, outside, title, notes)
        return replace(change, parts=(*change.parts, Recrop(state.crops, kept)))


def _recropped(state: State, crops: tuple[Crop, ...], title: str) -> Change:
    """Replaces the crops and deselects what they cut away, so that nothing invisible is edited."""
    title = printable(title)
    if crops == state.crops:
        return Change(title=title, count=0)
    parts: list[Part] = [Recrop(state.crops, crops)]
    if state.counts.selected:
        visible = state.cropped_in(crops=crops, only=SELECTED)
        if len(visible):
            parts.append(Toggle(SplatSet.of_mask(~visible), SELECTED))
    return Change(title=title, count=0, parts=tuple(parts))
