"""Where a user's settings and caches live, by each platform's custom."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def config_folder() -> Path:
    """The place for settings; SPLATVIEW_CONFIG_DIR overrides it. It may not exist yet."""
    return _folder("SPLATVIEW_CONFIG_DIR", "APPDATA", "Application Support", "XDG_CONFIG_HOME", ".config")


def cache_folder() -> Path:
    """The place for what can be made again; SPLATVIEW_CACHE_DIR overrides it. It may not exist yet."""
    return _folder("SPLATVIEW_CACHE_DIR", "LOCALAPPDATA", "Caches", "XDG_CACHE_HOME", ".cache")


def kernel_folder() -> Path:
    """The place for compiled kernels; NUMBA_CACHE_DIR, which others share, overrides it."""
    folder = _folder("NUMBA_CACHE_DIR", "LOCALAPPDATA", "Caches", "XDG_CACHE_HOME", ".cache")
    return folder / ("splatview" if os.environ.get("NUMBA_CACHE_DIR") else "kernels")


def _folder(override: str, windows: str, mac: str, xdg: str, in_home: str) -> Path:
    """`override`, `windows` and `xdg` are environment variables, `mac` lies in ~/Library, `in_home` in ~."""
    if chosen := os.environ.get(override):
        return Path(chosen)
    if sys.platform == "win32":
        base = Path(os.environ.get(windows) or _home() / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = _home() / "Library" / mac
    else:
        base = Path(os.environ.get(xdg) or _home() / in_home)
    return base / "splatview"


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # neither HOME nor an account: nothing can be kept, and everything else works
        return Path(os.devnull)
