"""Kernels of pictures: compiled without the GIL, cached on disk.

All sources of this package, of the package that a kernel is in, and what else kernels compile are part of the
cache's path (`scene.compiling`).
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numba

from splatview.scene.compiling import (
    BOUNDSCHECK,
    available_threads,
    compiled_into,
    config,
    even_ranges,
    kernel_cache,
    niceness,
    remove_old_caches,
    run,
)

__all__ = (
    "BOUNDSCHECK",
    "SPLATS_PER_TASK",
    "TASKS_PER_THREAD",
    "available_threads",
    "cache_folder",
    "cache_stamp",
    "compiled_into",
    "config",
    "even_ranges",
    "inline",
    "kernel",
    "niceness",
    "run",
    "will_compile",
)

_HERE = Path(__file__).parent

SHARED_SOURCES = (_HERE.parent / "scene" / "lens_formula.py",)
"""Files of other packages with functions that kernels here compile."""


@cache
def cache_folder(package: Path) -> Path | None:
    """Where kernels of exactly these sources lie; None where the disk may not be written."""
    return kernel_cache((_HERE, package), SHARED_SOURCES)


_CACHE = cache_folder(_HERE)
if _CACHE is not None:
    with contextlib.suppress(OSError):  # another process tidies up at the same time, or owns them
        remove_old_caches(_CACHE.parent)

_kernels: list[Any] = []


def kernel(function: Callable[..., Any] | None = None, *, allocates: bool = False) -> Any:
    """Compiles an entry point: called from Python, releases the GIL, cached on disk.

    Sums may be contracted to fused multiply-adds; nothing else is taken lightly, NaN least of all.

    `allocates`: it makes arrays. Only such kernels count references: a count around every array that is
    handed on or sliced is an atomic operation on a cache line that all threads share, and took half of the
    time of loops over splats and pairs.
    """
    if function is None:
        return partial(kernel, allocates=allocates)
    folder = cache_folder(Path(function.__code__.co_filename).parent)
    compiled = compiled_into(folder, function, fastmath={"contract"}, _nrt=allocates)
    _kernels.append(compiled)
    return compiled


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them. It makes no arrays, and calls nothing
    that returns new ones: references are not counted."""
    uncounted: dict[str, Any] = {"_nrt": False}  # numba's types do not know the option
    return numba.njit(nogil=True, error_model="numpy", fastmath={"contract"}, **uncounted)(function)


def cache_stamp() -> str:
    """Name of the kernel cache, different for other sources."""
    return "not cached" if _CACHE is None else _CACHE.name


def will_compile() -> bool:
    """Whether the first picture has to wait some seconds for the compiler: nothing of this version of the
    sources is in memory or on disk yet."""
    if any(compiled.signatures for compiled in _kernels):
        return False
    return _CACHE is None or not any(name.endswith(".nbc") for *_, names in os.walk(_CACHE) for name in names)


TASKS_PER_THREAD = 4
"""Tasks of a stage per thread: enough that threads end together, few enough to be cheap."""

SPLATS_PER_TASK = 1024
"""Tasks over splats begin at multiples of it: fewer cost less to do than to hand out."""
