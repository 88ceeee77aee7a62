"""A screen without a monitor."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple


class Screen(NamedTuple):
    """A running X server."""

    display: str
    """The value for DISPLAY."""
    pid: int


@contextmanager
def screen(size: str = "1360x860") -> Iterator[Screen]:
    """Runs Xvfb, with nothing of what clients before have left. Raises FileNotFoundError where it is not
    installed, OSError where it does not start."""
    program = shutil.which("Xvfb")
    if program is None:
        raise FileNotFoundError("Xvfb is not installed (Debian: apt-get install xvfb)")
    ready, write_end = os.pipe()
    server = subprocess.Popen(
        [program, "-displayfd", str(write_end), "-screen", "0", f"{size}x24", "-nolisten", "tcp", "-noreset"],
        pass_fds=[write_end],
        stderr=subprocess.DEVNULL,
    )
    os.close(write_end)
    try:
        with os.fdopen(ready) as pipe:
            number = pipe.readline().strip()
            if not number:
                raise OSError(f"Xvfb has ended with {server.wait()}")
            yield Screen(f":{number}", server.pid)
    finally:
        server.terminate()
        server.wait()
