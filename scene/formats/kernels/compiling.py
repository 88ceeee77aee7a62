"""How kernels of codecs are compiled and run: plain IEEE arithmetic, in pieces, on all cores."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numba

from splatview.scene.compiling import available_threads, compiled_into, even_ranges, kernel_cache, run
from splatview.scene.progress import NO_PROGRESS, Progress

_CACHE = kernel_cache((Path(__file__).parent,))

PIECE = 1 << 14
"""Splats of a task at most: their rows stay in the second-level cache."""

GROUP = 1 << 18
"""Splats between two questions whether to go on: some 20 ms."""


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles an entry point: called from Python, releases the GIL. No sum is contracted."""
    return compiled_into(_CACHE, function)


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them."""
    return numba.njit(nogil=True, error_model="numpy")(function)


def over_splats(
    kernel: Callable[..., Any],
    count: int,
    *common: Any,
    progress: Progress = NO_PROGRESS,
    step: int = 1,
) -> list[Any]:
    """Calls `kernel(start, stop, *common)` for runs that make up [0, count) and begin at multiples of `step`,
    on all cores; results in order. Raises Cancelled."""
    threads, results = available_threads(), []
    group = GROUP // step * step
    for first in range(0, count, group):
        size = min(group, count - first)
        pieces: Sequence[tuple[int, int]] = [
            (first + start, first + stop) for start, stop in even_ranges(size, -(-size // PIECE), step=step)
        ]
        results += run(kernel, pieces, common, threads)
        progress.step((first + size) / count)
    return results
