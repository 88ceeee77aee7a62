"""Files that are either wholly written or not touched."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from ..errors import InputError


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A file to write to that takes the name `path` when the block ends well, and vanishes when it does not.

    The bytes are on the disk (fsync) before the name changes, so that a kill or a power cut at any moment
    leaves the old file or the new one. A link stays a link: the file that it leads to is replaced.

    Raises:
        InputError: the operating system refuses, be it the folder's permissions or a full disk.
    """
    try:
        target = path.resolve()
        if target.is_dir():
            raise InputError(f"{path}: is a folder; name a file in it")
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: is a device or a pipe, not a file; name a file")
        if not target.parent.is_dir():
            raise InputError(f"{path}: the folder {target.parent} does not exist; make it first")
        # In the same folder, for a rename between file systems would be a copy.
        temporary = target.parent / f".{target.name[:100]}.{secrets.token_hex(4)}.tmp"
        try:
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                temporary.chmod(target.stat().st_mode & 0o777)
            temporary.replace(target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _sync_folder(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _sync_folder(folder: Path) -> None:
    """Makes the new name last. Windows cannot open folders, and does so itself."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
