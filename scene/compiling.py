"""Compiled kernels of any package: cached on disk, run on as many threads as the caller allows.

numba's own cache notices a change of the file that a kernel is in, but not of the files that it calls
into. Here a cache's path has the sources that count for it, so a kernel can never be stale.

Imported late by what reads and writes files: numba takes a while to load, and a plain .ply needs none.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numba
from numba.core import config as _numba_config
from numba.core.caching import FunctionCache
from numba.core.compiler_lock import global_compiler_lock

from splatview.scene.user_dirs import kernel_folder

config: Any = _numba_config

BOUNDSCHECK = bool(config.BOUNDSCHECK)
"""Whether every array access of the kernels is checked (environment variable NUMBA_BOUNDSCHECK=1)."""

# As the process ends, LLVM's memory goes while threads run on: one that is compiling, as a window's warm-up
# may when that is soon closed, would write into freed memory. What has begun is waited for; nothing follows.
atexit.register(global_compiler_lock.acquire)

KEEP_DAYS = 30
"""Caches of other versions of the sources are removed after so long without use."""


def kernel_cache(folders: Iterable[Path], files: Iterable[Path] = ()) -> Path | None:
    """Where kernels lie that are compiled of exactly these sources: of all modules in `folders`, and `files`.
    None where the disk may not be written."""
    stamp = hashlib.sha256(str((numba.__version__, BOUNDSCHECK)).encode())
    modules = [file for folder in dict.fromkeys(folders) for file in sorted(folder.glob("*.py"))]
    for file in (*modules, *files):
        stamp.update(file.read_bytes())
    try:
        folder = kernel_folder() / stamp.hexdigest()[:16]
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        return folder if os.access(folder, os.W_OK) else None
    except (OSError, RuntimeError):  # RuntimeError: there is no home
        return None


def remove_old_caches(root: Path) -> None:
    """Removes compiled files (.nbi, .nbc) long unused, and the folders that this leaves empty; no others."""
    oldest = time.time() - KEEP_DAYS * 86400
    for folder in root.iterdir():
        if folder.is_symlink() or not folder.is_dir() or folder.stat().st_mtime > oldest:
            continue
        for path in sorted(folder.rglob("*"), reverse=True):
            if path.suffix in (".nbi", ".nbc"):
                path.unlink(missing_ok=True)
            elif path.is_dir() and not any(path.iterdir()):
                path.rmdir()
        if not any(folder.iterdir()):
            folder.rmdir()


class DamageTolerantCache(FunctionCache):
    """numba's cache of one kernel, which a damaged file or a full disk only makes slower: what cannot be read
    is compiled anew, what cannot be written is compiled again next time. One line says so."""

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # pickles of damaged files raise nearly anything
            tell_once("read", error)
            with contextlib.suppress(OSError):
                self.flush()  # an empty index: the damaged files are not looked at again
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except Exception as error:
            tell_once("written", error)


_told: set[str] = set()


def tell_once(what: str, error: Exception) -> None:
    if what not in _told:
        _told.add(what)
        reason = " ".join(str(error).split()) or type(error).__name__
        print(
            f"splatview: the cache of compiled kernels cannot be {what} ({reason}); going on without",
            file=sys.stderr,
        )


def compiled_into(folder: Path | None, function: Callable[..., Any], **options: Any) -> Any:
    """`function` by numba.njit with `options`, its machine code kept in `folder`; None: not kept."""
    dispatcher: Any = numba.njit(nogil=True, error_model="numpy", **options)(function)
    if folder is not None:
        before = config.CACHE_DIR
        config.CACHE_DIR = str(folder)
        try:
            dispatcher._cache = DamageTolerantCache(function)  # as enable_caching() does with its own
        finally:
            config.CACHE_DIR = before
    return dispatcher


def available_threads() -> int:
    """Cores that this process may use."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # not on macOS and Windows
        return os.cpu_count() or 1


def threads_for(size: int) -> int:
    """Threads for work on so many bytes: less than a mebibyte is done before another thread has begun."""
    return available_threads() if size >= 1 << 20 else 1


def niceness() -> int:
    """Niceness of the calling thread; 0 where threads have none of their own (they do on Linux only)."""
    return os.getpriority(os.PRIO_PROCESS, 0) if sys.platform == "linux" else 0


def be_nicer(by: int) -> None:
    """Lowers the priority of the calling thread, and of threads that it starts from now on, on Linux; it
    cannot be taken back."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, 0, min(niceness() + by, 19))


@cache
def _executor(niceness: int) -> ThreadPoolExecutor:
    """Helpers for the threads of one priority: a thread is as nice as the one that started it."""
    return ThreadPoolExecutor(max(available_threads(), 2), thread_name_prefix=f"raster{niceness or ''}")


def run(
    kernel: Callable[..., Any], tasks: Iterable[Sequence[Any]], common: Sequence[Any], threads: int
) -> list[Any]:
    """Calls `kernel(*task, *common)` for every task on `threads` threads, the caller's included: a call makes
    progress however busy the helpers are.

    Which thread takes which task is left to chance; results come in the order of the tasks. The first
    exception of a task is raised here, after the tasks already begun have ended.

    Dropped: helpers that watch for the next call for 0.03 to 0.2 ms before they sleep, as OpenMP's do. A call
    of 0.5 ms on two threads took 0.05 ms less; a step of 20,000 splats (`compare_kernels`, in turn, twice)
    0.90 and 1.02 of the time, one of 100,000 1.02, frames 0.95 and 0.99, with 1 to 15 % more processor time.
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
                    for _ in pending:  # no other task begins
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
