"""Files that one process has for itself as long as it holds them open."""

from __future__ import annotations

import os
from typing import IO

LOCKED_BYTE = 1 << 40
"""Far behind all text: where bytes are locked rather than files, the text can still be read."""


def take_lock(file: IO[bytes]) -> bool:
    """Takes the open `file` for this process until it is closed, or the process ends however it may; False
    where another has it.

    Raises:
        OSError: the file system has no locks.
    """
    if os.name == "nt":
        import msvcrt

        locking, mode = getattr(msvcrt, "locking"), getattr(msvcrt, "LK_NBLCK")  # noqa: B009
        at = file.tell()
        try:
            file.seek(LOCKED_BYTE)
            locking(file.fileno(), mode, 1)
        except OSError:
            return False
        finally:
            file.seek(at)
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True
