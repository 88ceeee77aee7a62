"""The bundled demo, made once and then read back: five seconds of numpy become a tenth of a second."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Callable
from importlib import resources

import numpy as np

from ..scene import Gaussians, InputError, demo
from ..scene.demo import demo_scene
from ..scene.files import load_scene, save_scene
from .folders import cache_folder

PATTERN = "demo-*.ply"


def demo_stamp() -> str:
    """Changes with anything that the demo's values depend on: its sources, and numpy's random numbers."""
    digest = hashlib.sha256(np.__version__.encode())
    for source in sorted(resources.files(demo).iterdir(), key=lambda entry: entry.name):
        if source.name.endswith(".py"):
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def cached_demo(
    *, progress: Callable[[float], None] | None = None, cancelled: Callable[[], bool] | None = None
) -> Gaussians:
    """`demo_scene()`, bit for bit, from the user's cache folder where it was made before.

    A cache that cannot be read or written costs only time. Earlier versions' files are removed.

    Raises:
        LoadCancelled: `cancelled` turned true while the cached file was read.
    """
    path = cache_folder() / PATTERN.replace("*", demo_stamp())
    if path.exists():
        with contextlib.suppress(InputError):
            return load_scene(path, progress=progress, cancelled=cancelled)
    gaussians = demo_scene()
    with contextlib.suppress(OSError, InputError):
        path.parent.mkdir(parents=True, exist_ok=True)
        for old in path.parent.glob(PATTERN):
            old.unlink(missing_ok=True)
        save_scene(gaussians, path)
    return gaussians
