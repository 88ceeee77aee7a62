"""Kernels of this package: compiled without the GIL, cached on disk, and run in pieces on all cores.

numba's own cache notices a change of the file that a kernel is in, but not of the files that it calls
into. So all sources of this package are part of the cache's path, and no kernel can be stale.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from functools import cache
from pathlib import Path
from typing import Any

import numba

from splatview.scene.compiling import compiled_into, kernel_cache
from splatview.scene.progress import NO_PROGRESS, Progress

_CACHE = kernel_cache((Path(__file__).parent,))


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles an entry point: called from Python, releases the GIL. NaN and infinity keep their meaning."""
    return compiled_into(_CACHE, function)


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them."""
    return numba.njit(nogil=True, error_model="numpy")(function)


PIECE = 1 << 16
"""Splats per piece: their results stay in the second-level cache, and cancelling takes effect soon."""


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
    count: int, work: Callable[[int, int], object], *, progress: Progress = NO_PROGRESS, piece: int = PIECE
) -> None:
    """Calls `work(start, stop)` for runs that make up [0, count), several at once.

    The first exception of a piece is raised here, when the pieces already begun have ended; so is
    Cancelled where nobody waits for the rest.
    """
    starts = range(0, count, piece)
    if len(starts) <= 1 or _cores() == 1:
        for start in starts:
            progress.step(start / count)
            work(start, min(start + piece, count))
        progress.step(1.0)
        return
    running: set[Future[object]] = set()
    ended = 0
    try:
        for start in starts:
            progress.step(ended / len(starts))
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
    progress.step(1.0)
