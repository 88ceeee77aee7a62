"""Kernels of this package: compiled without the GIL, cached on disk, and run in pieces on all cores.

numba's own cache notices a change of the file that a kernel is in, but not of the files that it calls
into. So all sources of this package are part of the cache's path, and no kernel can be stale.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from splatview.scene.compiling import available_threads, compiled_into, kernel_cache, run
from splatview.scene.progress import NO_PROGRESS, Progress

_CACHE = kernel_cache((Path(__file__).parent,))


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles an entry point: called from Python, releases the GIL. NaN and infinity keep their meaning."""
    return compiled_into(_CACHE, function)


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them."""
    return numba.njit(nogil=True, error_model="numpy")(function)


PIECE = 1 << 16
"""Splats per piece: their results stay in the second-level cache."""

GROUP = 4
"""Pieces of each thread between two questions whether to go on."""


def in_pieces(
    count: int, work: Callable[[int, int], object], *, progress: Progress = NO_PROGRESS, piece: int = PIECE
) -> None:
    """Calls `work(start, stop)` for runs that make up [0, count), several at once.

    The first exception of a piece is raised here, when the pieces already begun have ended; so is
    Cancelled where nobody waits for the rest.
    """
    threads = available_threads()
    group = GROUP * threads * piece
    progress.check()
    for first in range(0, count, group):
        stop = min(first + group, count)
        run(work, [(start, min(start + piece, stop)) for start in range(first, stop, piece)], (), threads)
        progress.step(stop / count)
    progress.step(1.0)
