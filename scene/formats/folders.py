"""Scenes that are folders, written wholly or not at all: beside their place, and renamed."""

from __future__ import annotations

import contextlib
import glob
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from splatview.scene.errors import InputError
from splatview.scene.formats.io import LOCKED_WITHIN, excerpt, sync_folder


def folder_target(path: Path, ours: Callable[[Path], str | None]) -> Path:
    """The folder, behind all links, that is written for the file `path` in it.

    `ours`: the name of something in a folder that no such scene has, None where all of it is a scene's.

    Raises:
        InputError: there can be none: what is there is no such scene, or is out of reach.
    """
    folder = Path(os.path.realpath(path.parent))
    if not os.path.lexists(folder):
        if not os.path.isdir(folder.parent):
            raise InputError(f"{path}: the folder {folder.parent} does not exist; make it first")
    elif not folder.is_dir():
        raise InputError(f"{path.parent}: is a file, not a folder; name another folder")
    else:
        if folder == Path(os.path.realpath(os.curdir)):
            raise InputError(
                f"{path}: would replace the folder that this runs in; name a folder in it: NAME/{path.name}"
            )
        try:
            foreign = ours(folder)
        except OSError as error:
            raise InputError(f"{path.parent}: cannot be read: {error.strerror or error}") from None
        if foreign is not None:
            raise InputError(
                f"{path.parent}: holds {excerpt(foreign)}, which is no part of a scene, and the whole folder "
                "would be replaced; name another folder"
            )
    if not os.access(folder.parent, os.W_OK):
        raise InputError(f"{path}: the folder {folder.parent} cannot be written to")
    return folder


@contextmanager
def atomic_folder(path: Path, ours: Callable[[Path], str | None]) -> Iterator[Path]:
    """A folder to write to that becomes that of `path` when the block ends well, and vanishes when it does
    not. An older one is replaced as a whole; see `folder_target` for `ours`.

    A kill leaves the old folder or the new one, or, between two renames, the old one under its name with
    ``.old`` behind it. What a kill left beside it of an earlier write is removed.

    Raises:
        InputError: what is there is no such scene, or the system refuses.
    """
    target = folder_target(path, ours)
    try:
        name = target.name if len(os.fsencode(target.name)) <= 200 else target.name[:50]
        _remove_leftovers(target.parent, f".{name}.")
        temporary = target.parent / f".{name}.{secrets.token_hex(4)}.tmp"
        temporary.mkdir()
        try:
            with _locked(temporary):
                yield temporary
                for folder, _, files in os.walk(temporary):
                    for file in files:
                        with open(os.path.join(folder, file), "rb") as written:
                            os.fsync(written.fileno())
                _replace(target, temporary)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        sync_folder(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _replace(target: Path, temporary: Path) -> None:
    """Gives `temporary` the name `target`; no system renames a folder over one that is not empty."""
    if not target.exists():
        temporary.rename(target)
        return
    old = target.with_name(f"{target.name}.{secrets.token_hex(4)}.old")
    target.rename(old)
    try:
        temporary.rename(target)
    except BaseException:
        old.rename(target)
        raise
    shutil.rmtree(old, ignore_errors=True)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Locks a folder that is being written, where the system can."""
    descriptor = None
    with contextlib.suppress(OSError, ImportError):
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _remove_leftovers(parent: Path, prefix: str) -> None:
    """Removes folders of writes that were killed: those that no living process has locked."""
    for leftover in parent.glob(f"{glob.escape(prefix)}*.tmp"):
        if not leftover.is_dir() or leftover.is_symlink():
            continue
        with contextlib.suppress(OSError, ImportError):
            import fcntl

            descriptor = os.open(leftover, os.O_RDONLY)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                free = time.time() - os.fstat(descriptor).st_mtime > LOCKED_WITHIN
            finally:
                os.close(descriptor)
            if free:
                shutil.rmtree(leftover, ignore_errors=True)
