"""One module a command of `splatview`, and `start`, where the installed command begins."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def start() -> int:
    """Runs `splatview` with the process's arguments; returns the exit code.

    Nothing is imported before signals are taken care of: loading numpy and the command takes longer than it
    takes to press Ctrl-C.
    """
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end_at_once)
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        # Who ignores one, as nohup does, has a reason.
        if number is not None and signal.getsignal(number) is signal.SIG_DFL:
            signal.signal(number, _leave)
    try:
        from splatview.cli.main import main

        return main(on_loaded=_let_interrupts_raise)
    finally:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _end_at_once)  # the interpreter's own end would be a traceback too


def _let_interrupts_raise() -> None:
    """From now on Ctrl-C is a KeyboardInterrupt: the command is loaded, and cleans up after itself."""
    if signal.getsignal(signal.SIGINT) is _end_at_once:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _end_at_once(number: int, frame: FrameType | None) -> None:
    """Before the command and after it there is nothing to clean up; an exception would be a traceback."""
    os._exit(128 + number)


def _leave(number: int, frame: FrameType | None) -> None:
    """A request to end: files that are half written are removed on the way out."""
    signal.signal(number, signal.SIG_IGN)  # once is enough
    sys.exit(128 + number)
