"""How kernels of codecs are compiled and run: plain IEEE arithmetic, in pieces, on all cores."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba

from splatview.scene.compiling import available_threads, compiled_into, even_ranges, kernel_cache, run
from splatview.scene.progress import NO_PROGRESS, Progress

_CACHE = kernel_cache((Path(__file__).parent,))

PIECE = 1 << 14
"""Splats of a task at most: their rows stay in the second-level cache."""


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles an entry point: called from Python, releases the GIL. No sum is contracted."""
    return compiled_into(_CACHE, function)


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them."""
    return numba.njit(nogil=True, error_model="numpy")(function)


def over_splats(
    kernel: Callable[..., Any], count: int, *common: Any, progress: Progress = NO_PROGRESS, step: int = 1
) -> list[Any]:
    """Calls `kernel(start, stop, *common)` for runs that make up [0, count) and begin at multiples of `step`,
    on all cores; results in any order. Raises Cancelled."""
    pieces = even_ranges(count, -(-count // PIECE), step=step) if count else []
    threads = available_threads()
    # Threads work far from each other: of two that touch the same new page of 2 MiB both clear one, and one
    # is thrown away. Filling 76 MB of new memory in two threads took 34 ms, and takes 10 so.
    apart = -(-len(pieces) // threads)
    far = [piece for start in range(apart) for piece in pieces[start::apart]]
    caller, done = threading.get_ident(), itertools.count(1)

    def work(start: int, stop: int) -> Any:
        progress.check()
        result, share = kernel(start, stop, *common), next(done) / len(pieces)
        if threading.get_ident() == caller:
            progress.step(share)
        return result

    return run(work, far, (), threads)
