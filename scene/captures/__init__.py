"""Captures: photos with known cameras, from the formats that reconstruction tools write."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

from ..errors import InputError
from ..files.progress import LoadCancelled, Watch
from .assemble import assemble, capture_name
from .capture import Capture, Photo, Pixels
from .colmap import find_colmap, read_colmap

__all__ = ["Capture", "LoadCancelled", "Photo", "Pixels", "load_capture"]


def load_capture(
    path: str | os.PathLike[str],
    *,
    downscale: int = 1,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> Capture:
    """The capture in a folder, all its photos read once: what cannot be read is known before training.

    Photos become floor(w / downscale) x floor(h / downscale) by averaging areas; lens distortion is taken
    out; transparent photos are laid over `background`, RGB in 0..1. Every 8th photo by sorted name, starting
    with the first, is held out unless the capture says which. `progress` gets the share done, 0 to 1;
    `cancelled` is asked after every photo; both are called from this thread.

    Raises:
        InputError: there is no capture, or a part of it is damaged or does not fit the rest.
        LoadCancelled: `cancelled` returned true.
    """
    if not downscale >= 1:
        raise InputError(f"photos can be downscaled by 1 or more, not {downscale}")
    path = Path(path)
    if not path.is_dir():
        raise InputError(f"{path}: {'is no folder' if path.exists() else 'no such folder'}")
    model = find_colmap(path)
    if model is None:
        raise InputError(f"{path}: holds no capture")
    posed = read_colmap(path, model)
    watch = Watch(progress=progress, cancelled=cancelled)
    return assemble(posed, name=capture_name(path), downscale=downscale, background=background, watch=watch)
