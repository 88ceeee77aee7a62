"""Reading scenes in a thread, so that the window never waits for a disk."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from splatview.renderers.demo_cache import cached_demo
from splatview.renderers.gl.scene_buffers import upload_plan
from splatview.scene import Gaussians, InputError, RenderSettings, concatenate
from splatview.scene.effects.effect import Effect
from splatview.scene.effects.overrides import quick_settings, settings_for
from splatview.scene.effects.report import scene_effects
from splatview.scene.errors import printable
from splatview.scene.first_view import Front
from splatview.scene.formats import load_scene
from splatview.scene.formats.sequence import SceneSequence
from splatview.scene.framing import robust_bounds
from splatview.scene.health import Finding, check
from splatview.scene.progress import Cancelled, Progress
from splatview.viewer.picture import EMPTY
from splatview.viewer.tasks import Result, Task

Stamp = tuple[int, int, int]
"""Inode, size and time of a file, which tell whether it is still the one that was read."""


def stamp_of(path: Path) -> Stamp | None:
    """None where there is no such file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def stamps_of(paths: Sequence[Path]) -> dict[Path, Stamp]:
    """Stamps of `paths`, by the files that links lead to."""
    found = {Path(os.path.realpath(path)): stamp_of(path) for path in paths}
    return {path: stamp for path, stamp in found.items() if stamp is not None}


@dataclass(frozen=True, eq=False, kw_only=True)
class LoadedScene:
    """A scene and what must be known about it before it is shown."""

    gaussians: Gaussians
    paths: tuple[Path, ...]
    """The files it came from; none for the demo."""
    name: str
    centre: np.ndarray
    """(3,) float64, world: middle of where the splats are."""
    radius: float
    """World units, > 0: outliers left out."""
    settings: RenderSettings
    """Settings that the scene itself calls for, the background apart."""

    @cached_property
    def extent(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Least and greatest x, y, z of all finite centres, world units; kept, as a panel asks in each frame.
        None where no centre is finite."""
        means = self.gaussians.means
        if not np.isfinite(means).all():
            means = means[np.isfinite(means).all(axis=1)]
        return (means.min(axis=0), means.max(axis=0)) if len(means) else None

    seconds: float
    """How long loading took."""
    front: Front | None = None
    """The side that shows most; None of the demo, which has a view of its own, and where nothing is seen."""
    stamps: Mapping[Path, Stamp] = field(default_factory=dict)
    """Stamps of its files, just before they were read."""
    counts: tuple[int, ...] = ()
    """Number of splats of each of several files; () where one file has all."""
    sequence: SceneSequence | None = None
    """Sequence of which it is a frame."""
    frame: int = 0
    """Number of that frame, from 0."""

    @property
    def bookmarked(self) -> Path | None:
        """The file that its bookmarks are beside: of a sequence the first frame's."""
        paths = self.paths if self.sequence is None else self.sequence.paths
        return paths[0] if paths else None


EMPTY_SCENE = LoadedScene(
    gaussians=EMPTY, paths=(), name="", centre=np.zeros(3), radius=1.0, settings=RenderSettings(), seconds=0.0
)
"""The scene of a window in which nothing is open."""


class Reading(Task[Result]):
    """Files under way: `read(progress)` in a thread."""

    def __init__(
        self,
        name: str,
        read: Callable[[Progress], Result],
        *,
        stage: str = "Reading",
        on_done: Callable[[], object] = lambda: None,
    ):
        self.name = name
        self.stage = stage
        self.began = time.monotonic()
        progress = Progress(report=self._advance, cancelled=lambda: self.cancelled)
        super().__init__(lambda _: read(progress), name="splatview-load", on_done=on_done)

    @property
    def problem(self) -> str | None:
        """Error in one line; None where it was cancelled."""
        error = self.error
        if error is None or isinstance(error, Cancelled):
            return None
        if isinstance(error, InputError):
            return str(error)
        if isinstance(error, MemoryError):
            return f"{self.name}: not enough memory to open it"
        # Whatever a reader did not foresee: the window and the old scene must survive it.
        return f"{self.name}: cannot be opened ({type(error).__name__}: {error})"

    def _advance(self, share: float) -> None:
        self.progress = min(max(share, self.progress, 0.0), 1.0)


class Loading(Reading[LoadedScene]):
    """A scene under way, which `read(progress=...)` makes."""

    def __init__(
        self, name: str, paths: Sequence[Path], read: Callable[..., Gaussians], *, stage: str = "Reading"
    ):
        self._paths = tuple(paths)
        self._read = read
        super().__init__(name, self._load, stage=stage)

    def _load(self, progress: Progress) -> LoadedScene:
        return _load(self.name, self._paths, self._read, progress)


def _load(
    name: str,
    paths: tuple[Path, ...],
    read: Callable[..., Gaussians],
    progress: Progress,
    like: LoadedScene | None = None,
) -> LoadedScene:
    began = time.perf_counter()
    stamps = stamps_of(paths)
    gaussians = read(progress=progress)
    progress.check()
    centre, radius = (like.centre, like.radius) if like else robust_bounds(gaussians.means)
    return LoadedScene(
        gaussians=gaussians,
        paths=paths,
        name=name,
        centre=centre,
        radius=radius,
        settings=quick_settings(gaussians) if like else settings_for(gaussians),
        seconds=time.perf_counter() - began,
        front=Front.of(gaussians) if paths else None,
        stamps=stamps,
    )


class Examination(Task[None]):
    """The effects census and health check of a scene that is already shown; takes a second for a million."""

    def __init__(self, gaussians: Gaussians):
        self.effects: tuple[Effect, ...] = ()
        self.findings: tuple[Finding, ...] = ()
        self.settings: RenderSettings | None = None
        """Settings that the scene calls for; None until they are known."""
        self.gaussians = gaussians
        super().__init__(self._examine, name="splatview-examine")

    def _examine(self, task: Task[None]) -> None:
        findings = check(self.gaussians)
        self.effects = tuple(scene_effects(self.gaussians, findings=findings))
        self.settings = settings_for(self.gaussians)
        self.findings = tuple(findings)


class FilesLoading(Loading):
    """A scene of several files under way."""

    def __init__(
        self, name: str, paths: Sequence[Path], read: Callable[..., Gaussians], counts: Sequence[int]
    ):
        """`counts`: to which `read` adds the number of splats of each file."""
        self._counts = counts
        super().__init__(name, paths, read)

    def _load(self, progress: Progress) -> LoadedScene:
        return replace(super()._load(progress), counts=tuple(self._counts))


def load_files(paths: Sequence[Path]) -> Loading:
    """Starts to load `paths` (at least one) into one scene."""
    if len(paths) == 1:
        return Loading(printable(paths[0].name), paths, partial(load_scene, paths[0]))
    sizes = [os.path.getsize(path) if os.path.isfile(path) else 0 for path in paths]
    whole = max(sum(sizes), 1)
    before = [sum(sizes[:i]) for i in range(len(sizes))]

    def read(*, progress: Progress) -> Gaussians:
        parts = []
        for path, size, start in zip(paths, sizes, before, strict=True):
            parts.append(load_scene(path, progress=progress.part(start / whole, (start + size) / whole)))
            counts.append(len(parts[-1]))
        return concatenate(parts)

    counts: list[int] = []
    return FilesLoading(printable(f"{paths[0].name} and {len(paths) - 1} more"), paths, read, counts)


class SequenceLoading(Loading):
    """A sequence under way: the first of its frames, from `start` on, that can be read."""

    def __init__(self, sequence: SceneSequence, start: int = 0):
        self.problems: dict[int, str] = {}
        """Why a frame before that cannot be read, by its number."""
        self._sequence, self._start = sequence, start
        super().__init__(sequence.name, (), load_scene)

    def _load(self, progress: Progress) -> LoadedScene:
        count = len(self._sequence)
        for away in range(count):
            index = (self._start + away) % count
            try:
                return load_frame(self._sequence, index, progress)
            except InputError as error:
                self.problems[index] = str(error)
        first = next(iter(self.problems.values()))
        raise InputError(f"{self.name}: none of its {count:,} frames can be read; the first: {first}")


def load_frame(
    sequence: SceneSequence,
    index: int,
    progress: Progress,
    *,
    like: LoadedScene | None = None,
    by_gl: bool = False,
) -> LoadedScene:
    """A frame. Of one `like` another, which may be gone in a moment, only that is found out without which it
    cannot be shown; what the window's thread would have to compute is ready, also for a picture `by_gl`.

    Raises:
        InputError: it cannot be read.
        Cancelled: nobody waits for it any more.
    """
    path = sequence.paths[index]
    scene = _load(sequence.name, (path,), partial(load_scene, path), progress, like)
    scene = replace(scene, sequence=sequence, frame=index)
    _ = scene.extent
    if by_gl:
        upload_plan(scene.gaussians, every_band=True)
    return scene


def load_demo() -> Loading:
    """Starts to make the bundled scene, which the window opens with when it is given none."""
    made = Loading("Demo", (), cached_demo, stage="Making")
    made.progress = -1.0
    return made
