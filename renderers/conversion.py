"""What a file in another format is: its size, and how far its pictures are from those of the scene."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatview import raster
from splatview.edit.document import Document
from splatview.edit.sample_views import sample_cameras
from splatview.scene import Gaussians, RenderSettings
from splatview.scene.effects.overrides import settings_for
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats import format_of, load_scene, losses, save_scene
from splatview.scene.formats.io import atomic_write
from splatview.scene.progress import NO_PROGRESS, Progress

VIEWS = 6


@dataclass(frozen=True, kw_only=True)
class Conversion:
    """A scene as a file would give it back."""

    bytes: int
    splats: int
    psnr: float
    """dB over all pixels of the sample views; infinite where the format keeps every number."""
    max_error: float
    """Largest difference of a colour channel, 0 to 1."""
    lost: tuple[str, ...]
    """What the format cannot hold, a line each."""

    @property
    def in_words(self) -> str:
        """Size and quality."""
        size = bytes_in_words(self.bytes)
        if self.psnr == math.inf:
            return f"{size}, every number as it was"
        return f"{size}, {self.psnr:.1f} dB, largest error {255 * self.max_error:.0f} of 255"


def convert(
    gaussians: Gaussians,
    path: str | os.PathLike[str],
    *,
    on_measured: Callable[[Conversion], object] = lambda found: None,
    progress: Progress = NO_PROGRESS,
) -> Conversion:
    """Writes the scene as `path`; where the format rounds, after `on_measured` was told what will come back
    from there: until then the file is in a folder of its own, and an older one stays.

    Raises:
        InputError: the format cannot hold the scene, or the system refuses.
        Cancelled: nobody waits for it any more.
    """
    path = Path(path)
    known = format_of(path)
    lost = tuple(losses(gaussians, path))
    if known is not None and known.exact:
        save_scene(gaussians, path, progress=progress)
        found = Conversion(
            bytes=path.stat().st_size, splats=len(gaussians), psnr=math.inf, max_error=0.0, lost=lost
        )
        on_measured(found)
        return found
    with tempfile.TemporaryDirectory(prefix="splatview-") as folder:
        file = Path(folder) / path.name
        save_scene(gaussians, file, progress=progress.part(0.0, 0.5))
        read = load_scene(file, progress=progress.part(0.5, 0.7))
        error, largest = picture_errors(gaussians, read, progress=progress.part(0.7, 1.0))
        found = Conversion(
            bytes=file.stat().st_size,
            splats=len(read),
            psnr=math.inf if error == 0 else -10 * math.log10(error),
            max_error=largest,
            lost=lost,
        )
        on_measured(found)
        with atomic_write(path) as target, open(file, "rb") as source:
            shutil.copyfileobj(source, target, 1 << 20)
    return found


def picture_errors(
    before: Gaussians, after: Gaussians, *, progress: Progress = NO_PROGRESS
) -> tuple[float, float]:
    """Mean squared and largest error of colours in [0, 1] over views from around the scene, each drawn as its
    own tags say."""
    if not len(before):
        return 0.0, 0.0
    cameras = sample_cameras(before, Document(before).edits, VIEWS)
    settings: list[RenderSettings] = [settings_for(scene) for scene in (before, after)]
    squares, largest = [], 0.0
    for done, camera in enumerate(cameras):
        progress.step(done / len(cameras))
        ours, theirs = (
            np.clip(raster.render(scene, camera, setting)[..., :3].astype(np.float64), 0, 1)
            for scene, setting in zip((before, after), settings, strict=True)
        )
        difference = np.abs(ours - theirs)
        squares.append(np.square(difference).mean())
        largest = max(largest, float(difference.max()))
    mean = float(np.mean(squares))
    return (mean if math.isfinite(mean) else math.inf), largest
