"""Operations on the files that a scene is made of: show, lock, place, rename, remove, select."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from splatview.edit.changes import Change, Part, Refile, Toggle, readjust, splats_in_words
from splatview.edit.operations.base import Operation
from splatview.edit.operations.select import MODES, VERBS, Mode, selection
from splatview.edit.operations.transform import check_places, check_similarity, unit_quat
from splatview.edit.state import SceneFile, SplatSet, State
from splatview.scene import InputError
from splatview.scene.edits import (
    ANY_LOCK,
    DELETED,
    FILE_HIDDEN,
    FILE_LOCKED,
    IDENTITY_ROTATION,
    SELECTED,
    Adjustment,
    Four,
    Vector,
)
from splatview.scene.errors import printable
from splatview.scene.progress import NO_PROGRESS, Progress


@dataclass(frozen=True, kw_only=True)
class _OneFile(Operation):
    file: int
    """Index of the file, from 0, in the order in which they came into the scene; removed ones count."""

    def __post_init__(self) -> None:
        if not self.file >= 0:
            raise ValueError(f"file must be at least 0, got {self.file}")

    def _file(self, state: State) -> SceneFile:
        if not self.file < len(state.files):
            count = "is 1 file" if len(state.files) == 1 else f"are {len(state.files)} files"
            raise InputError(f"file {self.file}: there {count}, counted from 0")
        file = state.files[self.file]
        if file.removed:
            raise InputError(f"file {self.file} ({printable(file.name)}) was removed")
        return file

    def _unlocked(self, state: State) -> SceneFile:
        file = self._file(state)
        if file.locked:
            raise InputError(f"{printable(file.name)} is locked; unlock it first")
        return file

    def _splats(self, state: State, care: int = 0) -> np.ndarray:
        """Splats of the file with no flag of `care`: (N,) bool."""
        mask = state.owners == self.file
        return mask & ((state.marks & care) == 0) if care else mask

    def _refile(self, state: State, **changes: Any) -> Refile:
        files = list(state.files)
        files[self.file] = replace(files[self.file], **changes)
        return Refile(state.files, tuple(files))

    def _switched(self, state: State, flag: int, *, on: bool, title: str, **changes: Any) -> Change:
        """The change that flips a flag of the whole file, and deselects its splats where that sets it."""
        parts: list[Part] = []
        mask = self._splats(state)
        if on and state.counts.selected:
            selected = SplatSet.of_mask(mask & ((state.marks & SELECTED) != 0))
            parts += [Toggle(selected, SELECTED)] if len(selected) else []
        parts += [Toggle(SplatSet.of_mask(mask), flag), self._refile(state, **changes)]
        return Change(title=title, count=state.file_counts[self.file], parts=tuple(parts))


@dataclass(frozen=True, kw_only=True)
class ShowFile(_OneFile):
    op: ClassVar[str] = "show_file"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Show or hide all splats of one of the scene's files"

    shown: bool

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        file = self._file(state)
        title = f"{'Show' if self.shown else 'Hide'} {printable(file.name)}"
        if file.hidden is not self.shown:
            return Change(title=title, count=0)
        return self._switched(state, FILE_HIDDEN, on=not self.shown, title=title, hidden=not self.shown)


@dataclass(frozen=True, kw_only=True)
class LockFile(_OneFile):
    op: ClassVar[str] = "lock_file"
    summary: ClassVar[str] = "Lock or unlock a file of the scene: tools, clean-up and crops leave it alone"

    locked: bool

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        file = self._file(state)
        title = f"{'Lock' if self.locked else 'Unlock'} {printable(file.name)}"
        if file.locked is self.locked:
            return Change(title=title, count=0)
        change = self._switched(state, FILE_LOCKED, on=self.locked, title=title, locked=self.locked)
        # What crops cut away of it is back.
        return replace(change, same_file=not any(crop.enabled for crop in state.crops))


@dataclass(frozen=True, kw_only=True)
class PlaceFile(_OneFile):
    """x' = translation + scale·R·x of the coordinates in the file, in place of where it was before."""

    op: ClassVar[str] = "place_file"
    summary: ClassVar[str] = "Put one of the scene's files to a position, rotation and scale"

    rotation: Four = IDENTITY_ROTATION
    """wxyz of any length above 0."""
    translation: Vector = (0.0, 0.0, 0.0)
    """World units."""
    scale: float = 1.0
    """Above 0."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_similarity(self.rotation, self.scale)
        check_places(translation=self.translation)

    @property
    def placement(self) -> Adjustment:
        w, x, y, z = unit_quat(np.array(self.rotation)).tolist()
        return Adjustment(rotation=(w, x, y, z), scale=self.scale, translation=self.translation)

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        file = self._unlocked(state)
        title = f"Transform {printable(file.name)}"
        before, after = file.placement, self.placement
        if before == after:
            return Change(title=title, count=0)
        splats = SplatSet.of_mask(self._splats(state, DELETED | ANY_LOCK))
        parts: list[Part] = [self._refile(state, placement=after)]
        if len(splats):
            # Splats that nothing else has moved get the very numbers.
            parts.append(readjust(state, splats, way(before, after), known={before: after}))
        return Change(title=title, count=len(splats), parts=tuple(parts))


@dataclass(frozen=True, kw_only=True)
class RenameFile(_OneFile):
    op: ClassVar[str] = "rename_file"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Give one of the scene's files another name in the list"

    name: str

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.name.strip():
            raise ValueError("name must not be empty")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        file = self._file(state)
        title = f"Rename {printable(file.name)} to {printable(self.name)}"
        parts = (self._refile(state, name=self.name),) if self.name != file.name else ()
        return Change(title=title, count=0, parts=parts)


@dataclass(frozen=True, kw_only=True)
class RemoveFile(_OneFile):
    op: ClassVar[str] = "remove_file"
    summary: ClassVar[str] = "Take one of several files out of the scene, with all of its splats"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        file = self._unlocked(state)
        if sum(not other.removed for other in state.files) == 1:
            raise InputError(f"{printable(file.name)} is the only file; open another one instead")
        splats = SplatSet.of_mask(self._splats(state, DELETED))
        selected = SplatSet.of_mask(self._splats(state, DELETED) & ((state.marks & SELECTED) != 0))
        parts: list[Part] = [Toggle(selected, SELECTED)] if len(selected) else []
        parts += [Toggle(splats, DELETED)] if len(splats) else []
        return Change(
            title=f"Remove {printable(file.name)}, {splats_in_words(len(splats))}",
            count=len(splats),
            parts=(*parts, self._refile(state, removed=True)),
        )


@dataclass(frozen=True, kw_only=True)
class SelectFile(_OneFile):
    op: ClassVar[str] = "select_file"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Select the splats of one of the scene's files"

    mode: Mode = "set"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode not in MODES:
            raise ValueError(f"mode must be one of {', '.join(MODES)}, got {self.mode!r}")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        title = f"{VERBS[self.mode]} {printable(self._file(state).name)}"
        return selection(state, self._splats(state), MODES[self.mode], title)


def way(before: Adjustment, after: Adjustment) -> Adjustment:
    """The similarity that takes what is placed by `before` to where `after` places it.

    Raises:
        InputError: it leaves the range of numbers.
    """
    w, x, y, z = before.rotation
    scale = 1 / before.scale
    back = replace(before, rotation=(w, -x, -y, -z), scale=scale, translation=(0.0, 0.0, 0.0))
    tx, ty, tz = (-(back.linear @ np.array(before.translation))).tolist()
    try:
        return replace(back, translation=(tx, ty, tz)).then(after)
    except ValueError as error:
        raise InputError(f"this leaves the range of numbers: {error}") from None
