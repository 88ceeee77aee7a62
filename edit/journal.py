"""Autosave: each step is written to a journal as it is done, so that a crash loses nothing.

One JSON object per line: first the scene, then ``{"do": step}`` and ``{"position": steps in force}``, where
the second may also have ``"kept": {file: copy}`` or ``"saved": file, "at": steps``. The file is locked as
long as its program runs and removed when that ends well; a journal without a lock was left by a crash.

Steps start from the files as they were opened. One that is written over stays beside the journal until that
goes, as a hard link that costs nothing, so that steps before and after saving, and undoing them, can be
restored to the bit.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import shutil
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from splatview.edit.document import Document, Event, Step
from splatview.edit.operations import Merge, Operation, operation_from_json
from splatview.edit.recipe import Recipe
from splatview.scene import InputError
from splatview.scene.formats.io import take_lock

FORMAT = "splatview_journal"
VERSION = 1

SUFFIX = ".journal.jsonl"

LONGEST_NAME = 100
"""Characters that a copy has of its file's name, the last ones."""

LOCK_SECONDS = 1.0
"""Longest wait for the lock: far longer than another program takes to look at a new journal."""

SYNC_SECONDS = 2.0
"""Interval of syncing to disk: a crash of the program loses no step, one of the machine those since then."""

_NO_JOURNAL = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
"""Errors of reading something else as a journal."""


class Journal:
    """Records the steps of `document` from now on. Never raises: see `problem`."""

    def __init__(self, document: Document, folder: Path, *, scenes: Sequence[Path] = ()) -> None:
        """`folder` is made at the first step, if need be; `scenes` are the files that were opened."""
        self.problem: str | None = None
        """Why nothing is saved any more, for the user; None: all is well."""
        self.scenes = tuple(scenes)
        self._kept: dict[Path, Path] = {}
        self._owns_kept = True
        self._document, self._folder = document, folder
        self._file: IO[bytes] | None = None
        self._path: Path | None = None
        self._synced = 0.0
        self._syncing: threading.Thread | None = None
        document.listeners.append(self._listen)

    def close(self, *, keep: bool = False) -> None:
        """The document has been closed in good order: nothing is left to restore, unless `keep`."""
        with contextlib.suppress(ValueError):
            self._document.listeners.remove(self._listen)
        file, self._file = self._file, None
        if self._syncing is not None:
            self._syncing.join()
        if file is not None and self._path is not None:
            with contextlib.suppress(OSError):
                file.close()
            if not keep:
                with contextlib.suppress(OSError):
                    self._path.unlink()
        if not keep and self._owns_kept:
            for copy in self._kept.values():
                _remove(copy)

    def keep(self, target: Path) -> None:
        """To be called before `target` is written over: if steps start from it, what is in it now stays."""
        real = Path(os.path.realpath(target))
        operations = [step.operation for step in self._document.history.steps]
        merged = [self._document.path(one.path) for one in operations if isinstance(one, Merge)]
        sources = {os.path.realpath(path) for path in (*self.scenes, *merged)}
        if str(real) not in sources or real in self._kept or self.problem is not None:
            return
        try:
            if self._file is None:
                self._begin(self._document.history.position)
            if self._path is not None and os.path.lexists(real):
                name = self._path.name.removesuffix(SUFFIX)
                copy = self._folder / f"{name}-{len(self._kept)}-{real.name[-LONGEST_NAME:]}"
                _link_or_copy(real, copy)
                self._kept[real] = copy
                self._append(self._kept_line)
        except OSError as error:
            self._give_up(error)

    def saved(self, target: Path, *, at: int | None = None) -> None:
        """The steps in force, or the first `at` of them, are in the file `target` now."""
        if self._file is not None:
            position = self._document.history.position
            at = position if at is None else at
            self._write({"saved": str(target.absolute()), "at": at, "position": position})

    def continue_from(self, abandoned: AbandonedJournal) -> None:
        """Before its steps are done again: this journal starts from the same files."""
        self.scenes, self._kept, self._owns_kept = abandoned.scenes, dict(abandoned.kept), False

    def replace(self, abandoned: AbandonedJournal) -> None:
        """Its steps have been done again: this journal stands for that one."""
        self._owns_kept = True
        if abandoned.saved is not None:
            self.saved(abandoned.saved, at=abandoned.saved_at)
        abandoned.discard(copies=False)

    @property
    def _kept_line(self) -> dict[str, Any]:
        kept = {str(path): str(copy) for path, copy in self._kept.items()}
        return {"kept": kept, "position": self._document.history.position}

    def _listen(self, event: Event, step: Step) -> None:
        if event == "apply":
            self._write({"do": step.operation.to_json()})
        elif event in ("undo", "redo"):
            self._write({"position": self._document.history.position})

    def _write(self, line: dict[str, Any]) -> None:
        if self.problem is not None:
            return
        try:
            if self._file is None:
                self._begin(max(self._document.history.position - 1, 0))
            self._append(line)
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        self.problem = f"{self._folder}: steps are not autosaved: {error.strerror or error}"

    def _begin(self, done: int) -> None:
        """Makes the file, with the first `done` steps, which were there before the journal."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._path = self._folder / f"{time.strftime('%Y%m%d-%H%M%S')}-{secrets.token_hex(4)}{SUFFIX}"
        self._file = open(self._path, "xb", buffering=0)  # noqa: SIM115, open as long as the document
        until = time.monotonic() + LOCK_SECONDS
        while not take_lock(self._file) and time.monotonic() < until:
            time.sleep(0.001)  # another program that starts just now looks whether it was left behind
        document = self._document
        self._append(
            {
                FORMAT: VERSION,
                "scene": document.identity,
                "paths": [str(scene.absolute()) for scene in self.scenes],
                "folder": None if document.folder is None else str(document.folder.absolute()),
                "time": time.time(),
            }
        )
        for step in document.history.steps[:done]:
            self._append({"do": step.operation.to_json()})
        if self._kept:
            self._append({**self._kept_line, "position": done})

    def _append(self, line: dict[str, Any]) -> None:
        if self._file is None:
            return
        _write_whole(self._file, json.dumps(line, allow_nan=False).encode() + b"\n")
        now = time.monotonic()
        if now - self._synced >= SYNC_SECONDS and (self._syncing is None or not self._syncing.is_alive()):
            self._synced = now
            # A slow disk must not hold up the picture.
            self._syncing = threading.Thread(target=_sync, args=(self._file.fileno(),), daemon=True)
            self._syncing.start()


@dataclass(frozen=True, eq=False, kw_only=True)
class AbandonedJournal:
    """The journal of a program that did not end well."""

    file: Path
    scenes: tuple[Path, ...]
    """The files that were opened; none: the demo."""
    recipe: Recipe
    """The steps that were in force."""
    time: float
    """Time of the first step, seconds since the epoch."""
    kept: Mapping[Path, Path]
    """Copies of files that have been written over since."""
    saved: Path | None = None
    """The file in which the scene was saved last."""
    saved_at: int | None = None
    """Steps that are in it; None where some of those have been undone and replaced."""

    @property
    def scene(self) -> Path | None:
        """The first of the files."""
        return self.scenes[0] if self.scenes else None

    @property
    def opened(self) -> list[Path]:
        """What is to be opened: each file, or its copy."""
        return [self.source(path) for path in self.scenes]

    def source(self, path: Path) -> Path:
        """`path`, or the copy of what it was."""
        return self.kept.get(Path(os.path.realpath(path)), path)

    @property
    def unsaved(self) -> bool:
        """Whether something would be lost without it."""
        steps = self.recipe.steps
        if self.saved is None:
            return bool(steps)
        if self.saved_at is None or self.saved_at > len(steps):
            return True
        return any(step.alters_file for step in steps[self.saved_at :])

    def discard(self, *, copies: bool = True) -> None:
        """Removes the file, and the `copies` that it has."""
        with contextlib.suppress(OSError):
            self.file.unlink()
        for copy in self.kept.values() if copies else ():
            _remove(copy)


def find_abandoned_journals(folder: Path) -> list[AbandonedJournal]:
    """Journals to restore, latest first, without those of running programs."""
    found, names = [], []
    with contextlib.suppress(OSError):  # none there, or out of reach
        names = os.listdir(folder)
    for path in (folder / name for name in names if name.endswith(SUFFIX)):
        with contextlib.suppress(OSError, InputError, *_NO_JOURNAL):
            with open(path, "r+b") as file:
                if not take_lock(file):
                    continue
                lines = file.read().split(b"\n")
            journal = _read(path, lines)
            if journal.unsaved:
                found.append(journal)
            else:
                journal.discard()  # all was undone, or saved: there is nothing to restore
    return sorted(found, key=lambda journal: journal.time, reverse=True)


def _read(path: Path, lines: list[bytes]) -> AbandonedJournal:
    """Raises one of the errors above where `lines` are no journal."""
    head = json.loads(lines[0])
    if head[FORMAT] != VERSION:
        raise ValueError(f"a journal of version {head[FORMAT]}")
    steps: list[Operation] = []
    position = 0
    kept: dict[Path, Path] = {}
    saved: tuple[Path, list[Operation]] | None = None
    # The text behind the last line break was being written when the program ended.
    for text in lines[1:-1]:
        try:
            line = json.loads(text)
            if "do" in line:
                operation = operation_from_json(line["do"])
                del steps[position:]
                steps.append(operation)
                position = len(steps)
            else:
                position = min(max(int(line["position"]), 0), len(steps))
                if "kept" in line:
                    kept = {Path(path): Path(copy) for path, copy in line["kept"].items()}
                if "saved" in line:
                    saved = (Path(line["saved"]), steps[: int(line["at"])])
        except (InputError, *_NO_JOURNAL):
            break  # the lines before are whole
    folder = head["folder"]
    recipe = Recipe(
        steps=tuple(steps[:position]),
        scene=dict(head["scene"]),
        folder=None if folder is None else Path(folder),
    )
    if "paths" in head:
        scenes = tuple(Path(scene) for scene in head["paths"])
    else:  # before there were several
        scenes = () if head["path"] is None else (Path(head["path"]),)
    in_file = saved is not None and all(
        then is now for then, now in zip(saved[1], recipe.steps, strict=False)
    )
    return AbandonedJournal(
        file=path,
        scenes=scenes,
        recipe=recipe,
        time=float(head["time"]),
        kept=kept,
        saved=None if saved is None else saved[0],
        saved_at=len(saved[1]) if saved is not None and in_file else None,
    )


def _link_or_copy(source: Path, copy: Path) -> None:
    """The same bytes under another name, whatever takes the old one's place: a link where the file system has
    them. A folder is gone through."""
    if source.is_dir():
        copy.mkdir()
        for entry in source.iterdir():
            _link_or_copy(entry, copy / entry.name)
        return
    try:
        os.link(source, copy)
    except OSError:
        shutil.copyfile(source, copy)


def _remove(copy: Path) -> None:
    if copy.is_dir():
        shutil.rmtree(copy, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            copy.unlink()


def _write_whole(file: IO[bytes], line: bytes) -> None:
    """Writes all of `line` or nothing: a part of a line, on a full disk, would spoil the lines after it."""
    begin, written = file.tell(), 0
    try:
        while written < len(line):
            written += file.write(line[written:])
    except OSError:
        with contextlib.suppress(OSError):
            file.truncate(begin)
            file.seek(begin)
        raise


def _sync(descriptor: int) -> None:
    with contextlib.suppress(OSError):
        os.fsync(descriptor)
