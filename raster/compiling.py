"""How the kernels are compiled: without the GIL, cached on disk, and with a word to the user first.

numba's own cache notices a change of the file that a kernel is in, but not of the files that it calls
into. Here every source of this package is part of the cache's path, so a kernel can never be stale.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config as _numba_config

config: Any = _numba_config

BOUNDSCHECK = bool(config.BOUNDSCHECK)
"""Whether every array access of the kernels is checked (environment variable NUMBA_BOUNDSCHECK=1)."""

KEEP_DAYS = 30
"""Caches of other versions of these sources are removed after so long without use."""

_sources = hashlib.sha256(str((numba.__version__, BOUNDSCHECK)).encode())
for _file in sorted(Path(__file__).parent.glob("*.py")):
    _sources.update(_file.read_bytes())


def _cache_root() -> Path:
    """NUMBA_CACHE_DIR where it is set, else the user's cache folder by the platform's custom."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        return Path(os.environ["NUMBA_CACHE_DIR"]) / "splatview"
    if os.name == "nt" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"]) / "splatview" / "kernels"
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "splatview" / "kernels"


CACHE = _cache_root() / _sources.hexdigest()[:16]
"""Where compiled kernels of exactly these sources lie."""


def _prepare_cache() -> bool:
    """Makes the folder and drops long unused neighbours; False where the disk may not be written."""
    try:
        CACHE.mkdir(parents=True, exist_ok=True)
        os.utime(CACHE)
        writable = os.access(CACHE, os.W_OK)
    except OSError:
        return False
    for other in CACHE.parent.iterdir():
        if (
            other != CACHE
            and len(other.name) == 16
            and time.time() - other.stat().st_mtime > KEEP_DAYS * 86400
        ):
            _remove_cache(other)
    return writable


def _remove_cache(folder: Path) -> None:
    """Removes compiled files (.nbi, .nbc) and the folders that this leaves empty; nothing else."""
    for path in sorted(folder.rglob("*"), reverse=True):
        try:
            if path.suffix in (".nbi", ".nbc"):
                path.unlink()
            elif path.is_dir():
                path.rmdir()
        except OSError:
            continue
    try:
        folder.rmdir()
    except OSError:
        return


_cached = _prepare_cache()


_kernels: list[Any] = []


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles an entry point: called from Python, releases the GIL, cached on disk."""
    before = config.CACHE_DIR
    config.CACHE_DIR = str(CACHE)
    try:
        compiled = numba.njit(nogil=True, cache=_cached, error_model="numpy", fastmath={"contract"})(function)
    finally:
        config.CACHE_DIR = before
    _kernels.append(compiled)
    return compiled


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them."""
    return numba.njit(nogil=True, error_model="numpy", fastmath={"contract"})(function)


def will_compile() -> bool:
    """Whether the first picture has to wait some seconds for the compiler: nothing of this version of the
    sources is in memory or on disk yet."""
    if any(compiled.signatures for compiled in _kernels):
        return False
    return not (_cached and any(CACHE.rglob("*.nbc")))
