"""Changes: the alterations by one operation, reversible and compact.

A change is made before anything is altered; applying it can fail half way only by lack of memory, and then
the parts applied so far are reverted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Protocol

import numpy as np

from splatview.edit.kernels import marks as kernels
from splatview.edit.state import SceneFile, SplatSet, State
from splatview.scene import Gaussians, InputError, concatenate
from splatview.scene.edits import IDENTITY, MOST_ADJUSTMENTS, PALETTE_SHIFT, Adjustment, Crop
from splatview.scene.gaussians import ARRAYS

ADJUSTMENT_BYTES = 1000
"""Approximate memory of a palette entry."""


class Part(Protocol):
    """A part of a change. Each direction needs the state that the other one leaves."""

    def apply(self, state: State) -> None: ...

    def revert(self, state: State) -> None: ...

    @property
    def nbytes(self) -> int: ...


@dataclass(frozen=True, eq=False)
class Toggle:
    """Flags flipped on some splats: its own inverse."""

    splats: SplatSet
    bits: int

    def apply(self, state: State) -> None:
        if len(self.splats):
            self.splats.toggle(state.marks, self.bits)
            state.marks_changed(*self.splats.span)

    revert = apply

    @property
    def nbytes(self) -> int:
        return self.splats.nbytes


@dataclass(frozen=True, eq=False)
class SplatEntries:
    """The palette index of each splat of a set, in the smallest type that holds them."""

    values: np.ndarray


Reentry = int | np.ndarray | SplatEntries
"""New palette indices: by bits to flip, by a lookup (P,) uint32, or one by one."""


@dataclass(frozen=True, eq=False)
class Readjust:
    """Other adjustments for some splats, one for each that they had, and the palettes before and after."""

    splats: SplatSet
    before: tuple[Adjustment, ...]
    after: tuple[Adjustment, ...]
    there: Reentry
    back: Reentry

    def apply(self, state: State) -> None:
        self._write(state, self.there)
        state.set_palette(self.after)

    def revert(self, state: State) -> None:
        self._write(state, self.back)
        state.set_palette(self.before)

    def _write(self, state: State, entries: Reentry) -> None:
        if isinstance(entries, int):
            if entries == 0:
                return  # the palette alone changes
            self.splats.toggle(state.marks, entries)
        elif isinstance(entries, SplatEntries):
            mask = self.splats.mask
            flags = state.marks[mask] & np.uint32((1 << PALETTE_SHIFT) - 1)
            state.marks[mask] = flags | entries.values.astype(np.uint32) << np.uint32(PALETTE_SHIFT)
        else:
            kernels.remap(state.marks, self.splats.mask, entries)
        state.marks_changed(*self.splats.span)

    @property
    def nbytes(self) -> int:
        new = len(set(self.after) - set(self.before))
        stored = sum(
            entries.nbytes if isinstance(entries, np.ndarray) else entries.values.nbytes
            for entries in (self.there, self.back)
            if not isinstance(entries, int)
        )
        return self.splats.nbytes + stored + new * ADJUSTMENT_BYTES


@dataclass(frozen=True, eq=False)
class Recrop:
    """Other crops."""

    before: tuple[Crop, ...]
    after: tuple[Crop, ...]

    def apply(self, state: State) -> None:
        state.set_crops(self.after)

    def revert(self, state: State) -> None:
        state.set_crops(self.before)

    @property
    def nbytes(self) -> int:
        return ADJUSTMENT_BYTES * len(set(self.after) ^ set(self.before))


@dataclass(frozen=True, eq=False)
class Refile:
    """Other names, switches or placements of the scene's files, or one file more."""

    before: tuple[SceneFile, ...]
    after: tuple[SceneFile, ...]

    def apply(self, state: State) -> None:
        state.set_files(self.after)

    def revert(self, state: State) -> None:
        state.set_files(self.before)

    @property
    def nbytes(self) -> int:
        return ADJUSTMENT_BYTES * len(set(self.after) ^ set(self.before))


@dataclass(frozen=True, eq=False)
class Rewrite:
    """Other values of one attribute for some splats. The scene's array is not written to: the state gets a
    scene with a new one, which shares all others."""

    attribute: str
    splats: SplatSet
    before: np.ndarray
    after: np.ndarray
    """(count, ...), in the attribute's type."""

    def apply(self, state: State) -> None:
        self._write(state, self.after)

    def revert(self, state: State) -> None:
        self._write(state, self.before)

    def _write(self, state: State, rows: np.ndarray) -> None:
        values = getattr(state.gaussians, self.attribute).copy()
        values[self.splats.mask] = rows
        state.set_scene(replace(state.gaussians, **{self.attribute: values}))

    @property
    def nbytes(self) -> int:
        return self.splats.nbytes + self.before.nbytes + self.after.nbytes


class Append:
    """More splats, after the present ones. What was there before is cut out of the longer scene again: kept
    are only arrays of it that this one holds in another type, or not at all."""

    def __init__(self, before: Gaussians, added: Gaussians, marks: np.ndarray, owners: np.ndarray) -> None:
        """`marks`: (added,) uint32; `owners`: (added,) uint16."""
        self._added, self._marks, self._owners = added, marks, owners
        # Made now: it may be in a thread, which `apply` is not.
        self._planned: Gaussians | None = concatenate([before, added])
        self._comments = before.comments
        longer = _arrays(self._planned)
        self._arrays = {
            name: None
            if name in longer and (longer[name].dtype, longer[name].shape[1:]) == (own.dtype, own.shape[1:])
            else own
            for name, own in _arrays(before).items()
        }

    def apply(self, state: State) -> None:
        planned = self._planned or concatenate([state.gaussians, self._added])
        rows = ((state.marks, self._marks), (state.owners, self._owners))
        marks, owners = (np.concatenate(both) for both in rows)
        state.set_scene(planned, (marks, owners))
        self._planned = None

    def revert(self, state: State) -> None:
        count = len(state.gaussians) - len(self._added)
        longer = _arrays(state.gaussians)
        arrays = {name: longer[name][:count] if own is None else own for name, own in self._arrays.items()}
        extras = {name[len(EXTRA) :]: values for name, values in arrays.items() if name.startswith(EXTRA)}
        own = {name: arrays[name] for name in ARRAYS}
        before = Gaussians(**own, extras=extras, comments=self._comments)
        state.set_scene(before, (state.marks[:count].copy(), state.owners[:count].copy()))

    @property
    def nbytes(self) -> int:
        kept = sum(own.nbytes for own in self._arrays.values() if own is not None)
        return self._added.nbytes + self._marks.nbytes + self._owners.nbytes + kept


EXTRA = "extras."


def _arrays(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Everything with a row per splat, by name; extras behind EXTRA, as they may be called anything."""
    extras = {EXTRA + name: values for name, values in gaussians.extras.items()}
    return {**{name: getattr(gaussians, name) for name in ARRAYS}, **extras}


class SaveOnce:
    """A scene written to a file of its own, the first time that the change is applied. Reverting the change
    leaves the file."""

    def __init__(self, save: Callable[[Gaussians, Path], None], path: Path, scene: Gaussians) -> None:
        self._save, self._path = save, path
        self._scene: Gaussians | None = scene

    def apply(self, state: State) -> None:
        if self._scene is not None:
            self._save(self._scene, self._path)
            self._scene = None

    def revert(self, state: State) -> None:
        pass

    @property
    def nbytes(self) -> int:
        return 0 if self._scene is None else self._scene.nbytes


@dataclass(frozen=True, eq=False, kw_only=True)
class Change:
    """The alterations by one operation."""

    title: str
    """What was done, and to how many splats: for the history."""
    count: int
    """Splats concerned."""
    parts: tuple[Part, ...] = ()
    notes: tuple[str, ...] = field(default=())
    """Further messages to the user."""
    same_file: bool = False
    """Whether a file written after it is the one written before it, although operations of its kind may alter
    the file."""

    def apply(self, state: State) -> None:
        done: list[Part] = []
        try:
            for part in self.parts:
                part.apply(state)
                done.append(part)
        except BaseException:
            for part in reversed(done):
                part.revert(state)
            raise

    def revert(self, state: State) -> None:
        undone: list[Part] = []
        try:
            for part in reversed(self.parts):
                part.revert(state)
                undone.append(part)
        except BaseException:
            for part in reversed(undone):
                part.apply(state)
            raise

    @property
    def nbytes(self) -> int:
        """Approximate memory."""
        return sum(part.nbytes for part in self.parts)


def toggling(splats: SplatSet, bits: int, title: str) -> Change:
    """The change that flips flags of `splats`."""
    parts = (Toggle(splats, bits),) if len(splats) else ()
    return Change(title=title, count=len(splats), parts=parts)


def splats_in_words(count: int) -> str:
    return "1 splat" if count == 1 else f"{count:,} splats"


def readjust(
    state: State,
    splats: SplatSet,
    later: Adjustment,
    known: Mapping[Adjustment, Adjustment] = MappingProxyType({}),
) -> Readjust:
    """Applies `later` after the adjustments of `splats`: one palette entry for all alike, none without use.
    `known`: what comes of some adjustments to the last digit, in place of the product.

    Entries that only these splats used are reused for them, so moving one selection a thousand times takes
    one entry, and moving all splats writes to no mark.

    Raises:
        InputError: the adjustments together leave the range of numbers.
    """
    before = state.palette
    # Deleted splats count: undoing brings them back with their adjustments.
    usage, moved = np.array([[len(state.marks)], [len(splats)]])
    if len(before) > 1:
        usage, moved = kernels.entry_usage(state.marks, splats.mask, len(before))
    staying = usage > moved
    staying[0] = True
    after = [entry if stays else IDENTITY for entry, stays in zip(before, staying, strict=True)]
    slots: dict[Adjustment, int] = {}
    for slot in np.flatnonzero(staying):
        slots.setdefault(before[slot], int(slot))
    lookup = np.arange(len(before), dtype=np.uint32)
    new: list[tuple[int, Adjustment]] = []
    for entry in np.flatnonzero(moved):
        adjustment = known.get(before[entry]) or _then(before[entry], later)
        if adjustment in slots:
            lookup[entry] = slots[adjustment]
        else:
            new.append((int(entry), adjustment))
    free = set(np.flatnonzero(~staying).tolist())
    for entry, adjustment in new:
        if adjustment in slots:
            lookup[entry] = slots[adjustment]
            continue
        # Its own place where that is free now: then no mark has to change.
        slot = entry if entry in free else min(free, default=len(after))
        if slot == len(after):
            after.append(adjustment)
        free.discard(slot)
        after[slot] = adjustment
        slots[adjustment] = slot
        lookup[entry] = slot
    used = staying.tolist() + [True] * (len(after) - len(before))
    for slot in slots.values():
        used[slot] = True
    while not used[-1]:
        used.pop()
        after.pop()
    if len(after) > MOST_ADJUSTMENTS:
        raise InputError(f"the scene has {MOST_ADJUSTMENTS:,} differently edited groups of splats; no more")
    sources = np.flatnonzero(moved)
    if len(sources) == 1:
        bits = int(sources[0] ^ lookup[sources[0]]) << PALETTE_SHIFT
        return Readjust(splats, before, tuple(after), bits, bits)
    back = _back(state, splats, sources, lookup, len(after))
    return Readjust(splats, before, tuple(after), lookup, back)


def _then(first: Adjustment, later: Adjustment) -> Adjustment:
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            return first.then(later)
    except ValueError as error:
        raise InputError(f"after what was done before, this leaves the range of numbers: {error}") from None


def _back(
    state: State, splats: SplatSet, sources: np.ndarray, lookup: np.ndarray, entries: int
) -> np.ndarray | SplatEntries:
    """The inverse of `lookup` for the entries `sources`: an array unless two of them become one."""
    targets = lookup[sources]
    if len(set(targets.tolist())) == len(targets):
        back = np.arange(entries, dtype=np.uint32)
        back[targets] = sources
        return back
    values = state.marks[splats.mask] >> np.uint32(PALETTE_SHIFT)
    return SplatEntries(values.astype(np.min_scalar_type(len(lookup))))
