"""Runs kernels on as many threads as the caller allows.

One executor serves all threads of one priority: a viewer and a trainer that ask for one thread each get one
each, and the helpers of a viewer that gives way to its trainer give way as it does. The calling thread always
works too, so a call makes progress however busy the executor is.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from typing import Any

TASKS_PER_THREAD = 4
"""Pieces a stage is cut into for each thread: enough that threads end together, few enough to be cheap."""

SPLATS_PER_TASK = 1024
"""Tasks over splats begin at multiples of it: fewer cost less to do than to hand out."""


def available_threads() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


def niceness() -> int:
    """Of the calling thread, 0 where threads have none of their own (they do on Linux only)."""
    return os.getpriority(os.PRIO_PROCESS, 0) if sys.platform == "linux" else 0


@cache
def _executor(niceness: int) -> ThreadPoolExecutor:
    """A thread is as nice as the one that started it, which here is one that asks for help."""
    return ThreadPoolExecutor(max(available_threads(), 2), thread_name_prefix=f"raster{niceness or ''}")


def run(
    kernel: Callable[..., Any], tasks: Iterable[Sequence[Any]], common: Sequence[Any], threads: int
) -> list[Any]:
    """Calls `kernel(*task, *common)` for every task on `threads` threads, the caller's included.

    Which thread takes which task is left to chance; results come in the order of the tasks. The first
    exception of a task is raised here, after the tasks already begun have ended.
    """
    tasks = list(tasks)
    helpers = min(threads, len(tasks)) - 1
    if helpers < 1:
        return [kernel(*task, *common) for task in tasks]
    results: list[Any] = [None] * len(tasks)
    pending = iter(range(len(tasks)))
    lock = threading.Lock()

    def work() -> None:
        while True:
            with lock:
                index = next(pending, None)
            if index is None:
                return
            try:
                results[index] = kernel(*tasks[index], *common)
            except BaseException:
                with lock:
                    for _ in pending:  # nobody begins another task
                        pass
                raise

    executor = _executor(niceness())
    futures = [executor.submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        begun = [future for future in futures if not future.cancel()]
        errors = [future.exception() for future in begun]
    for error in errors:
        if error is not None:
            raise error
    return results


def even_ranges(count: int, pieces: int, *, step: int = 1) -> list[tuple[int, int]]:
    """[0, count) cut into at most `pieces` even runs (start, stop) that begin at multiples of `step`."""
    steps = -(-count // step)
    pieces = max(1, min(pieces, steps))
    edges = [min(steps * piece // pieces * step, count) for piece in range(pieces + 1)]
    return list(pairwise(edges))
