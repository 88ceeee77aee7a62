"""What a file in another format is: its size, and how far its pictures are from those of the scene."""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np

from splatview.edit.document import Document
from splatview.edit.sample_views import sample_cameras
from splatview.renderers.rate_distortion import (
    Choice,
    Judge,
    Search,
    Target,
    Trial,
    parse_target,
    search,
    with_degree,
)
from splatview.scene import Camera, Gaussians
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats import (
    Format,
    check_format,
    format_of,
    losses,
    place_copy,
    save_scene,
    stored_bytes,
)
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
    """What the file does not hold, a line each."""
    views: int = VIEWS
    """Number of pictures compared."""
    knobs: Mapping[str, Any] = field(default_factory=dict)
    """Knobs of the format that were chosen to reach a target."""

    @property
    def in_words(self) -> str:
        """Size and quality."""
        size = bytes_in_words(self.bytes)
        if self.psnr == math.inf:
            return f"{size}, every number as it was"
        return f"{size}, {self.psnr:.1f} dB, largest error {255 * self.max_error:.0f} of 255"

    @property
    def knobs_in_words(self) -> str:
        """The knobs, such as ``position bits 14, sh bits 3/2/2``; "" where there are none."""

        def plain(value: object) -> str:
            return "/".join(map(str, value)) if isinstance(value, tuple) else str(value)

        return ", ".join(f"{name.replace('_', ' ')} {plain(value)}" for name, value in self.knobs.items())


class Measured:
    """A file that is written and measured, and waits in a folder of its own for its place."""

    def __init__(self, folder: tempfile.TemporaryDirectory[str], file: Path, found: Conversion) -> None:
        self._folder, self._file = folder, file
        self.found = found

    def write(self, path: Path, progress: Progress = NO_PROGRESS) -> None:
        """Copies it to `path`, of the same format, wholly or not at all. Raises InputError and Cancelled."""
        place_copy(self._file, path, progress)

    def close(self) -> None:
        """Removes it."""
        self._folder.cleanup()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def measure(
    gaussians: Gaussians,
    path: Path,
    *,
    sh_degree: int | None = None,
    target: Target | None = None,
    cameras: Sequence[Camera] | None = None,
    progress: Progress = NO_PROGRESS,
) -> Measured:
    """The scene in the format of `path`, written beside nothing and read back; see `convert`."""
    check_format(path)
    known = format_of(path)
    assert known is not None
    views = sample_views(gaussians) if cameras is None else cameras
    folder = tempfile.TemporaryDirectory(prefix="splatview-", ignore_cleanup_errors=True)
    try:
        scene = gaussians if sh_degree is None else with_degree(gaussians, sh_degree)
        same = scene is gaussians and target is None and keeps_numbers(known, gaussians)
        judge = Judge(gaussians, [] if same else views)
        if target is not None:
            trial = search(scene, path, known, target, judge, Path(folder.name), progress)
        else:
            writer = Search(scene, path, known, Path(folder.name), judge, progress)
            trial = writer.trial(Choice(sh_degree=scene.sh_degree), progress=progress)
        return Measured(folder, trial.file, _conversion(gaussians, path, known, trial, len(views)))
    except BaseException:
        folder.cleanup()
        raise


def convert(
    gaussians: Gaussians,
    path: str | os.PathLike[str],
    *,
    sh_degree: int | None = None,
    target: Target | str | None = None,
    cameras: Sequence[Camera] | None = None,
    on_measured: Callable[[Conversion], object] = lambda found: None,
    progress: Progress = NO_PROGRESS,
) -> Conversion:
    """Writes the scene as `path`; where the file differs from it, after `on_measured` was told what will come
    back from there: until then the file is in a folder of its own, and an older one stays.

    `sh_degree`: the highest that is kept. `target`: what the file is to reach, such as
    "40dB" or "5MB", see `rate_distortion`.
    `cameras`: views to be measured on; None: from around the scene.

    Raises:
        InputError: the format cannot hold the scene or reach the target, or the system refuses.
        Cancelled: nobody waits for it any more.
    """
    path, target = Path(path), parse_target(target) if isinstance(target, str) else target
    known = format_of(path)
    whole = target is None and (sh_degree is None or sh_degree >= gaussians.sh_degree)
    if known is not None and whole and keeps_numbers(known, gaussians) and not losses(gaussians, path):
        save_scene(gaussians, path, progress=progress)
        size = stored_bytes(path)
        found = Conversion(bytes=size, splats=len(gaussians), psnr=math.inf, max_error=0.0, lost=())
        on_measured(found)
        return found
    options = {"sh_degree": sh_degree, "target": target, "cameras": cameras}
    with measure(gaussians, path, **options, progress=progress) as measured:
        on_measured(measured.found)
        measured.write(path, Progress(cancelled=progress.cancelled))
        return measured.found


def keeps_numbers(known: Format, gaussians: Gaussians) -> bool:
    """Whether every number of a scene comes back from a format."""
    return known.exact and (known.doubles or gaussians.means.dtype == np.float32)


def sample_views(gaussians: Gaussians) -> list[Camera]:
    """Views from around a scene."""
    return sample_cameras(gaussians, Document(gaussians).edits, VIEWS) if len(gaussians) else []


def _conversion(gaussians: Gaussians, path: Path, known: Format, trial: Trial, views: int) -> Conversion:
    lost = losses(gaussians, path)
    degree = trial.choice.sh_degree
    if known.sh and degree < gaussians.sh_degree:
        kept = f"SH bands above degree {degree} are left out" if degree else "all SH bands are left out"
        lost.insert(0, f"{kept} (the scene has {gaussians.sh_degree})")
    if trial.choice.kept < 1:
        share = 1 - trial.choice.kept
        lost.insert(0, f"{share:.1%} of the splats are left out: those that add least to pictures")
    return Conversion(
        bytes=trial.bytes,
        splats=trial.splats,
        psnr=trial.psnr,
        max_error=trial.largest,
        lost=tuple(lost),
        views=views,
        knobs=trial.choice.knobs,
    )
