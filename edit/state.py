"""A scene under edit at one moment: splats, flags, adjustments and crops, and the queries that operations
make."""

from __future__ import annotations

import json
import math
import os
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from splatview.edit.detectors import Detector, contributions
from splatview.edit.kernels import marks as kernels
from splatview.edit.kernels.compiling import in_pieces
from splatview.edit.serialization import to_json
from splatview.edit.tools import NoTools, Tools
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.edits import (
    ANY_LOCK,
    DELETED,
    FILE_HIDDEN,
    FILE_LOCKED,
    HIDDEN,
    IDENTITY,
    LOCKED,
    NOT_SHOWN,
    PREVIEW,
    SELECTED,
    Adjustment,
    Crop,
    SceneEdits,
    crop_rows,
)
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.progress import NO_PROGRESS, Progress

MAX_SPLATS = 2**31 - 1
"""Largest scene that can be edited: runs are counted in 32 bits."""

CHANGES_KEPT = 64
"""Runs of changed marks that are remembered: a renderer that missed more reads all marks anew."""


@dataclass(frozen=True, eq=False)
class SplatSet:
    """Some of N splats, as the history stores them: runs, or where those would take more room, one bit per
    splat.

    Never more than N / 8 bytes, so the history of a scene has a bound that does not depend on how scattered
    the selections are.
    """

    size: int
    """N."""
    count: int
    """Splats in the set."""
    span: tuple[int, int]
    """Least (start, stop) around the set; (0, 0) if it is empty."""
    stored: np.ndarray
    """(R, 2) int32 start and count, or (ceil(N / 8),) uint8 bits, lowest first."""

    @classmethod
    def of_mask(cls, mask: np.ndarray) -> SplatSet:
        """The set of `mask` (N,) bool."""
        mask = np.ascontiguousarray(mask, bool)
        size, count = len(mask), int(np.count_nonzero(mask))
        if not count:
            return cls(size, 0, (0, 0), np.empty((0, 2), np.int32))
        runs = int(np.count_nonzero(mask[1:] > mask[:-1])) + int(mask[0])
        stop = size - int(mask[::-1].argmax())
        span = (int(mask.argmax()), stop)
        if 8 * runs <= (size + 7) // 8:
            return cls(size, count, span, kernels.mask_runs(mask, runs))
        return cls(size, count, span, np.packbits(mask, bitorder="little"))

    @classmethod
    def of_flags(cls, marks: np.ndarray, care: int, value: int) -> SplatSet:
        """Splats whose flags within `care` are exactly `value`; marks (N,) uint32."""
        return cls.of_mask(kernels.flag_mask(marks, care, value))

    @property
    def mask(self) -> np.ndarray:
        """(N,) bool."""
        if self.stored.ndim == 1:
            return np.unpackbits(self.stored, count=self.size, bitorder="little").view(bool)
        mask = np.zeros(self.size, bool)
        kernels.fill_mask(self.stored, mask)
        return mask

    @property
    def indices(self) -> np.ndarray:
        """(count,) int64, ascending."""
        return np.flatnonzero(self.mask)

    def toggle(self, marks: np.ndarray, bits: int) -> None:
        """Flips `bits` of the set's `marks` (N,) uint32, in place."""
        if self.stored.ndim == 1:
            kernels.toggle_mask(marks, self.mask, bits)
        else:
            kernels.toggle_runs(marks, self.stored, bits)

    @property
    def nbytes(self) -> int:
        return self.stored.nbytes

    def __len__(self) -> int:
        return self.count


MOST_FILES = 1 << 16
"""Most files of a scene: each splat has the number of its file in 16 bits."""


@dataclass(frozen=True, kw_only=True)
class SceneFile:
    """One of the files that a scene under edit is made of."""

    name: str
    source: str = ""
    """Path of the file, for the user."""
    hidden: bool = False
    locked: bool = False
    """Whether tools, crops and clean-up leave its splats alone."""
    removed: bool = False
    """Whether it was taken out of the scene."""
    placement: Adjustment = IDENTITY
    """Where it was put: rotation, scale and translation of the coordinates in the file. What was done to a
    selection of its splats is not in it."""


@dataclass(frozen=True, kw_only=True)
class Counts:
    """Numbers of splats by their flags, crops apart."""

    total: int
    selected: int
    hidden: int
    """Hidden, or of a hidden file, and not deleted."""
    deleted: int
    locked: int
    """Locked, or of a locked file, and not deleted."""
    shown: int
    """Neither hidden nor deleted."""
    selectable: int
    """Neither hidden, deleted nor locked."""

    @property
    def kept(self) -> int:
        """Not deleted."""
        return self.total - self.deleted


class State:
    """The scene with its edits in force. Only `changes` alter it, and each alteration raises the version of
    what it alters. `gaussians` is never written to."""

    def __init__(
        self,
        gaussians: Gaussians,
        *,
        folder: Path | None = None,
        tools: Tools | None = None,
        load: Callable[..., Gaussians] = load_scene,
        save: Callable[[Gaussians, Path], None] = save_scene,
        files: Sequence[tuple[str, int]] = (),
    ) -> None:
        """`folder` is what relative paths of operations start from (default: the working directory). `load`
        and `save` read and write the scenes that operations name, as `load_scene` and `save_scene` do.
        `files`: paths and numbers of splats of the files that the scene was read from, in order; one of all
        splats where none is given.

        Raises:
            ValueError: the files have more or fewer splats than the scene.
        """
        files = tuple(files) or (("scene", len(gaussians)),)
        if sum(count for _, count in files) != len(gaussians) or len(files) > MOST_FILES:
            raise ValueError(f"files must have {len(gaussians)} splats together")
        self.gaussians = gaussians
        """The scene to be drawn with `edits`; another object whenever its values or their number change."""
        self.marks = np.zeros(len(gaussians), np.uint32)
        """(N,) uint32, splat flags and palette index; only to be read."""
        self.owners = np.repeat(np.arange(len(files), dtype=np.uint16), [count for _, count in files])
        """(N,) uint16, index in `files` of each splat; only to be read."""
        self.files: tuple[SceneFile, ...] = tuple(
            SceneFile(name=Path(path).name, source=path) for path, _ in files
        )
        """Those that were removed keep their place."""
        self.palette: tuple[Adjustment, ...] = (IDENTITY,)
        self.crops: tuple[Crop, ...] = ()
        self.folder = folder
        self.tools: Tools = tools or NoTools()
        self.load, self.save = load, save
        self.revision = 0
        """Number of edits so far; highlights are none."""
        self.scene_version = 0
        self.marks_version = 0
        self.palette_version = 0
        self.crops_version = 0
        self.changes: deque[tuple[int, int, int]] = deque(maxlen=CHANGES_KEPT)
        """(marks_version, start, stop) of the last changes of marks."""
        self._highlighted = 0
        self._measurement: tuple[Hashable, np.ndarray] | None = None
        self._edits: tuple[tuple[int, ...], SceneEdits] | None = None
        self._counts: tuple[int, Counts] | None = None
        self._file_counts: tuple[int, tuple[int, ...]] | None = None

    @property
    def room(self) -> float:
        """Bytes of memory that the next edit may take."""
        return math.inf

    def require_room(self, needed: float) -> None:
        """Raises InputError where an edit that takes `needed` bytes has no room. To be called before they are
        taken."""
        if not needed <= self.room:
            raise InputError(
                f"this takes {bytes_in_words(needed)} of memory, and editing has {bytes_in_words(self.room)} "
                "left: select fewer splats, or let it have more (--memory; in the window, Memory in the "
                "History panel)"
            )

    @property
    def versions(self) -> tuple[int, int, int, int]:
        """Versions of scene, marks, palette and crops: equal exactly if nothing has changed in between."""
        return (self.scene_version, self.marks_version, self.palette_version, self.crops_version)

    @property
    def edits(self) -> SceneEdits:
        """The edits in the form that renderers read: the same object as long as nothing changes."""
        versions = self.versions
        if self._edits is None or self._edits[0] != versions:
            counts = self.counts
            flags = SELECTED * (counts.selected > 0) | DELETED * (counts.deleted > 0)
            # A deleted splat may also be hidden or locked: those counts do not tell.
            flags |= HIDDEN * (counts.hidden > 0 or counts.deleted > 0)
            flags |= LOCKED * (counts.locked > 0 or counts.deleted > 0)
            flags |= PREVIEW * (self._highlighted > 0)
            flags |= FILE_HIDDEN * any(file.hidden for file in self.files)
            flags |= FILE_LOCKED * any(file.locked for file in self.files)
            edits = SceneEdits(
                marks=self.marks,
                palette=self.palette,
                crops=self.crops,
                marks_version=self.marks_version,
                palette_version=self.palette_version,
                crops_version=self.crops_version,
                changes=tuple(self.changes),
                flags=flags,
            )
            self._edits = (versions, edits)
        return self._edits[1]

    @property
    def counts(self) -> Counts:
        """Numbers of splats by flags, counted once after each change of the marks."""
        version = self.marks_version
        if self._counts is None or self._counts[0] != version:
            selected, hidden, deleted, locked, shown, selectable = kernels.flag_counts(self.marks).tolist()
            counts = Counts(
                total=len(self.marks),
                selected=selected,
                hidden=hidden,
                deleted=deleted,
                locked=locked,
                shown=shown,
                selectable=selectable,
            )
            self._counts = (version, counts)
        return self._counts[1]

    def cropped_in(self, *, crops: tuple[Crop, ...] | None = None, only: int = 0) -> np.ndarray:
        """Whether the crops in force, or `crops` in their stead, keep each splat: (N,) bool, or of length 0
        where there are none. Splats without any flag of `only` are kept without a look."""
        rows = crop_rows(self.crops if crops is None else crops)
        if not len(rows):
            return np.zeros(0, bool)
        places = kernels.places_of(self.gaussians, self.edits)
        kept = np.empty(len(self.marks), bool)
        in_pieces(len(kept), lambda start, stop: kernels.cropped_in(start, stop, places, rows, only, kept))
        return kept

    @property
    def editable(self) -> np.ndarray:
        """Splats neither hidden, deleted, locked nor cropped away: (N,) bool."""
        free = (self.marks & (NOT_SHOWN | ANY_LOCK)) == 0
        kept = self.cropped_in()
        return free & kept if len(kept) else free

    @property
    def file_counts(self) -> tuple[int, ...]:
        """Numbers of splats of the `files`, without deleted ones; counted once after each change."""
        version = self.marks_version
        if self._file_counts is None or self._file_counts[0] != version:
            counts = kernels.file_counts(self.marks, self.owners, len(self.files))
            self._file_counts = (version, tuple(counts.tolist()))
        return self._file_counts[1]

    def splats(self, care: int, value: int) -> SplatSet:
        """Splats whose flags within `care` are exactly `value`."""
        return SplatSet.of_flags(self.marks, care, value)

    @property
    def selected(self) -> SplatSet:
        return self.splats(SELECTED, SELECTED)

    def path(self, text: str) -> Path:
        """The file that an operation names."""
        return Path(self.folder or os.curdir, text)

    def scores(
        self, detector: Detector, cameras: tuple[Camera, ...] = (), *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        """The detector's scores of the scene as it is now, (N,) float32; kept until the next edit, so that an
        operation need not repeat its preview.

        Raises:
            InputError: it needs a renderer where there is none.
            Cancelled: nobody waits for it any more.
        """
        return self._measured(
            (type(detector), json.dumps(to_json([detector, *cameras]))),
            lambda: detector.scores(self.gaussians, self._frozen, self.tools, cameras, progress=progress),
        )

    def contributions(
        self, cameras: tuple[Camera, ...] = (), *, progress: Progress = NO_PROGRESS
    ) -> np.ndarray:
        """(N,) float64: each splat's contributions to the views, or to sample views if there are none. Kept
        and raises as `scores`."""
        return self._measured(
            (contributions, json.dumps(to_json(cameras))),
            lambda: contributions(self.gaussians, self._frozen, self.tools, cameras, progress=progress),
        )

    @property
    def _frozen(self) -> SceneEdits:
        """The edits with marks of their own: measuring takes long, and in a thread it may be given up for an
        edit, whose marks name what the palette from before does not have."""
        edits = self.edits
        return replace(edits, marks=edits.marks.copy())

    def _measured(self, what: Hashable, measure: Callable[[], np.ndarray]) -> np.ndarray:
        key = (self.revision, what)
        if self._measurement is None or self._measurement[0] != key:
            self._measurement = (key, measure())
        return self._measurement[1]

    def highlight(self, mask: np.ndarray | None) -> int:
        """Highlights the splats of `mask` (N,) bool that could be selected, and no others; None: none.

        For previews of tools: it is no edit, and ends with the next one. Returns the number of splats.
        """
        if mask is None and not self._highlighted:
            return 0
        hits = np.zeros(0, bool) if mask is None else np.ascontiguousarray(mask, bool)
        if mask is not None and hits.shape != self.marks.shape:
            raise ValueError(f"mask must have shape {self.marks.shape}, got {hits.shape}")
        self._highlighted, start, stop = kernels.set_highlight(self.marks, hits)
        if stop > start:
            self.marks_changed(start, stop, edited=False)
        return self._highlighted

    def marks_changed(self, start: int, stop: int, *, edited: bool = True) -> None:
        """Notes that `marks[start:stop]` was written to."""
        self.revision += edited
        self.marks_version += 1
        self.changes.append((self.marks_version, start, stop))

    def set_palette(self, palette: tuple[Adjustment, ...]) -> None:
        self.revision += 1
        self.palette = palette
        self.palette_version += 1

    def set_crops(self, crops: tuple[Crop, ...]) -> None:
        self.revision += 1
        self.crops = crops
        self.crops_version += 1

    def set_files(self, files: tuple[SceneFile, ...]) -> None:
        self.revision += 1
        self.files = files

    def set_scene(self, gaussians: Gaussians, rows: tuple[np.ndarray, np.ndarray] | None = None) -> None:
        """Replaces the scene, and where it has more or fewer splats `marks` and `owners` by `rows`."""
        self.revision += 1
        self.gaussians = gaussians
        self.scene_version += 1
        if rows is not None:
            self.marks, self.owners = rows
            self.marks_version += 1
            self.changes.clear()
