"""Scenes and cameras from and to files: one module a format."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ..gaussians import Gaussians
from .ply import load_ply
from .progress import LoadCancelled, Watch

__all__ = ["LoadCancelled", "load_scene"]


def load_scene(
    path: str | os.PathLike[str],
    *,
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Gaussians:
    """The splats in a file; the format is told by its first bytes.

    `progress` gets the share done, 0 to 1; `cancelled` is asked every few milliseconds. Both are called
    from this thread.

    Raises:
        InputError: the file is missing, damaged or of another kind.
        LoadCancelled: `cancelled` returned true.
    """
    return load_ply(Path(path), Watch(progress=progress, cancelled=cancelled))
