"""How the loops of this package are compiled: without the GIL, and cached on disk.

numba's own cache notices a change of the file that a kernel is in, but not of the files that it calls
into. So all sources of this package are part of the cache's path, and no kernel can be stale.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numba
from numba.core import config as _numba_config

_config: Any = _numba_config


def _cache_folder() -> Path | None:
    """Where kernels of exactly these sources lie, beside those of the rasteriser, which removes what is
    long unused; None where the disk may not be written."""
    if os.environ.get("NUMBA_CACHE_DIR"):
        root = Path(os.environ["NUMBA_CACHE_DIR"]) / "splatview"
    elif os.name == "nt" and os.environ.get("LOCALAPPDATA"):
        root = Path(os.environ["LOCALAPPDATA"]) / "splatview" / "kernels"
    else:
        try:
            home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        except RuntimeError:  # there is no home
            return None
        root = Path(home) / "splatview" / "kernels"
    stamp = hashlib.sha256(str((numba.__version__, bool(_config.BOUNDSCHECK))).encode())
    for file in sorted(Path(__file__).parent.glob("*.py")):
        stamp.update(file.read_bytes())
    try:
        folder = root / f"edit-{stamp.hexdigest()[:16]}"
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


_CACHE = _cache_folder()


def kernel(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles an entry point: called from Python, releases the GIL. NaN and infinity keep their meaning."""
    before = _config.CACHE_DIR
    _config.CACHE_DIR = str(_CACHE or "")
    try:
        return numba.njit(nogil=True, cache=_CACHE is not None, error_model="numpy")(function)
    finally:
        _config.CACHE_DIR = before


def inline(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compiles a helper that kernels call; LLVM folds it into them."""
    return numba.njit(nogil=True, error_model="numpy")(function)
