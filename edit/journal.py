"""Autosave: each step is written to a journal as it is done, so that a crash loses nothing.

One JSON object per line: first the scene, then ``{"do": step}`` and ``{"position": steps in force}``. The
file is locked as long as its program runs and removed when that ends well; a journal without a lock was left
by a crash.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from splatview.edit.document import Document, Event, Step
from splatview.edit.operations import Operation, operation_from_json
from splatview.edit.recipe import Recipe
from splatview.scene import InputError
from splatview.scene.formats.io import take_lock

FORMAT = "splatview_journal"
VERSION = 1

SUFFIX = ".journal.jsonl"

LOCK_SECONDS = 1.0
"""Longest wait for the lock: far longer than another program takes to look at a new journal."""

SYNC_SECONDS = 2.0
"""Interval of syncing to disk: a crash of the program loses no step, one of the machine those since then."""

_NO_JOURNAL = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)
"""Errors of reading something else as a journal."""


class Journal:
    """Records the steps of `document` from now on. Never raises: see `problem`."""

    def __init__(self, document: Document, folder: Path, *, scene: Path | None = None) -> None:
        """`folder` is made at the first step, if need be; `scene` is the file that was opened."""
        self.problem: str | None = None
        """Why nothing is saved any more, for the user; None: all is well."""
        self._document, self._folder, self._scene = document, folder, scene
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
                self._begin()
            self._append(line)
        except OSError as error:
            self.problem = f"{self._folder}: steps are not autosaved: {error.strerror or error}"

    def _begin(self) -> None:
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
                "path": None if self._scene is None else str(self._scene.absolute()),
                "folder": None if document.folder is None else str(document.folder.absolute()),
                "time": time.time(),
            }
        )
        # Steps from before there was a journal.
        for step in document.history.steps[: max(document.history.position - 1, 0)]:
            self._append({"do": step.operation.to_json()})

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
    scene: Path | None
    """The file that was open."""
    recipe: Recipe
    """The steps that were in force."""
    time: float
    """Time of the first step, seconds since the epoch."""

    def discard(self) -> None:
        """Removes the file."""
        with contextlib.suppress(OSError):
            self.file.unlink()


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
            if journal.recipe.steps:
                found.append(journal)
            else:
                journal.discard()  # all was undone: there is nothing to restore
    return sorted(found, key=lambda journal: journal.time, reverse=True)


def _read(path: Path, lines: list[bytes]) -> AbandonedJournal:
    """Raises one of the errors above where `lines` are no journal."""
    head = json.loads(lines[0])
    if head[FORMAT] != VERSION:
        raise ValueError(f"a journal of version {head[FORMAT]}")
    steps: list[Operation] = []
    position = 0
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
        except (InputError, *_NO_JOURNAL):
            break  # the lines before are whole
    folder = head["folder"]
    recipe = Recipe(
        steps=tuple(steps[:position]),
        scene=dict(head["scene"]),
        folder=None if folder is None else Path(folder),
    )
    scene = head["path"]
    return AbandonedJournal(
        file=path,
        scene=None if scene is None else Path(scene),
        recipe=recipe,
        time=float(head["time"]),
    )


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
