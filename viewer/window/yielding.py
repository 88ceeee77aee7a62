"""Lets the window wait for the trainer rather than the trainer for the window."""

from __future__ import annotations

import os
import sys

NICENESS = 10
"""Linux weighs a thread of it 110 against 1,024 (sched(7)): where both want a core, training has nine tenths
of it, and the window still answers. A core that training leaves free is the window's as before."""


def give_way() -> bool:
    """Lowers the priority of the calling thread, and of threads that it starts from now on, those of its
    OpenGL driver among them; whether that is possible. It cannot be taken back.

    Only Linux has a priority for each thread that threads inherit; elsewhere the shares of the cores are
    kept by waiting alone.
    """
    if sys.platform != "linux":
        return False
    try:
        os.setpriority(os.PRIO_PROCESS, 0, max(os.getpriority(os.PRIO_PROCESS, 0), NICENESS))
    except OSError:
        return False
    return True
