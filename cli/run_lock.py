"""Who writes where: two runs must not write the same scene and checkpoint in turns."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path
from typing import IO

from splatview.scene import InputError
from splatview.scene.formats.io import take_lock
from splatview.scene.user_dirs import cache_folder

_held: dict[Path, IO[bytes]] = {}
"""Claims last as long as the process, which may make one again."""


def lock_run(path: Path) -> None:
    """Keeps `path` for this process to write. Marks lie in the cache's folder, not beside the file; where
    none can be made nothing is claimed, which is no reason not to work.

    Raises:
        InputError: another process of this user's has it.
    """
    digest = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:16]
    mark = cache_folder() / "claims" / f"{digest}.lock"
    if mark in _held:
        return
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        file = open(mark, "a+b")  # noqa: SIM115, for as long as the process
        if take_lock(file):
            file.truncate(0)
            file.write(str(os.getpid()).encode())
            file.flush()
            _held[mark] = file
            return
        file.seek(0)
        who = file.read(20).decode(errors="replace")
        file.close()
    except OSError:
        return
    raise InputError(
        f"{path}: another splatview (process {who}) trains into it; wait for it, or name another file with -o"
    )
