"""Work over many splats cut into pieces, done on all cores, watched between the pieces."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import cache

from ..watch import UNWATCHED, Watch

PIECE = 1 << 16
"""Splats at a time: what is computed of them stays in the second-level cache, and one asks often enough
whether to stop."""


@cache
def _cores() -> int:
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


@cache
def _executor() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_cores(), thread_name_prefix="edit")


def in_pieces(
    count: int, work: Callable[[int, int], object], *, watch: Watch = UNWATCHED, piece: int = PIECE
) -> None:
    """Calls `work(start, stop)` for runs that make up [0, count), several at once.

    The first exception of a piece is raised here, when the pieces already begun have ended; so is
    Cancelled where the watch says so.
    """
    starts = range(0, count, piece)
    if len(starts) <= 1 or _cores() == 1:
        for start in starts:
            watch.step(start / count)
            work(start, min(start + piece, count))
        watch.step(1.0)
        return
    running: set[Future[object]] = set()
    ended = 0
    try:
        for start in starts:
            watch.step(ended / len(starts))
            if len(running) > _cores():
                done, running = wait(running, return_when=FIRST_COMPLETED)
                ended += len(done)
                for future in done:
                    future.result()
            running.add(_executor().submit(work, start, min(start + piece, count)))
        for future in running:
            future.result()
    finally:
        wait(running)
    watch.step(1.0)
