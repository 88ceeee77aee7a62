"""Sequences: scenes that are the frames of a moving one, in a folder, by a glob, or named one by one.

4D captures are exchanged so: one scene file of any format per moment, numbered.
"""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from splatview.scene.errors import InputError, printable
from splatview.scene.formats import FORMATS, format_of, load_scene
from splatview.scene.formats.colmap import find_model
from splatview.scene.formats.sog_folder import is_sog_folder
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import Progress

LEAST_NAMED = 3
"""Files named one by one that are numbered alike are frames from this many on: two may well be two parts of
one scene, which are merged."""

LEAST_SHARE = 0.5
"""Share of a folder's scenes that are numbered alike, from which on the others are taken for something else:
a mean, a background, another format of the same."""

PHOTOS = (".jpg", ".jpeg", ".png", ".webp", ".tif", ".tiff", ".heic")

NERF = ("transforms.json", "transforms_train.json", "poses_bounds.npy")
"""Files that make a folder a capture: photos with cameras, not scenes."""


@dataclass(frozen=True, kw_only=True)
class SceneSequence:
    """Scenes that are shown one after another, at least two."""

    paths: tuple[Path, ...]
    """Frames in their order: files, or folders of SOG."""
    name: str
    """Name of the whole for titles and messages, in printable characters."""
    folder: Path | None = None
    """Folder whose scenes they are, where that was named."""
    pattern: str = ""
    """Glob that they match, where that was named."""
    left_out: int = 0
    """Scenes of the folder that are no frames."""
    alike: bool = True
    """Whether the names differ in nothing but their numbers."""

    def __len__(self) -> int:
        return len(self.paths)

    @cached_property
    def labels(self) -> tuple[str, ...]:
        """Names of the frames, with those of their folders where these differ."""
        if len({path.parent for path in self.paths}) == 1:
            return tuple(printable(path.name) for path in self.paths)
        whole = [os.path.abspath(path) for path in self.paths]
        common = os.path.commonpath([os.path.dirname(path) for path in whole])
        return tuple(printable(os.path.relpath(path, common)) for path in whole)

    @property
    def in_words(self) -> str:
        """How many frames there are, which is the first, and what is left out; one line."""
        text = f"{len(self):,} frames from {self.labels[0]} to {self.labels[-1]}"
        if not self.alike:
            text = f"{len(self):,} scenes that are not numbered alike, as frames by their names, from "
            text += self.labels[0]
        others = "scene is" if self.left_out == 1 else "scenes are"
        return text + (f"; {self.left_out:,} other {others} left out" if self.left_out else "")

    def again(self) -> SceneSequence:
        """The sequence as it is on the disk now: frames may have come since."""
        source = self.folder or (Path(self.pattern) if self.pattern else None)
        found = self if source is None else resolve(source)
        return found if isinstance(found, SceneSequence) else self


def natural_key(name: str) -> tuple[object, ...]:
    """Sort key by which frame_2 comes before frame_10, and upper case counts as lower."""
    # Texts and numbers alternate, a text first, so that like is compared with like.
    parts = re.split(r"([0-9]+)", name.casefold())
    return tuple(int(part) if i % 2 else part for i, part in enumerate(parts)), name


def in_natural_order(paths: Sequence[Path]) -> list[Path]:
    """Folder by folder, as people count."""
    return sorted(paths, key=lambda path: [natural_key(part) for part in path.parts])


def is_glob(path: Path) -> bool:
    """Whether `path` is a pattern such as ``frames/*.ply``, and no file of that very name."""
    return glob.has_magic(str(path)) and not os.path.lexists(path)


def resolve_all(paths: Sequence[Path], *, merge: bool = False) -> SceneSequence | list[Path]:
    """What the paths that a user opens together are: one sequence, or scenes (and cameras) to be opened at
    once. `merge`: never a sequence.

    Raises:
        InputError: a folder holds nothing that can be opened, or a glob matches other things alone.
    """
    if len(paths) == 1:
        found = resolve(paths[0])
        if isinstance(found, SceneSequence):
            return list(found.paths) if merge else found
        return [found]
    single: list[Path] = []
    for path in paths:
        found = resolve(path) if is_glob(path) else path
        single += found.paths if isinstance(found, SceneSequence) else [found]
    scenes = all(_is_scene(path) for path in single)
    if merge or not scenes or len(set(single)) < LEAST_NAMED or not _alike(single):
        return single
    ordered = in_natural_order(list(dict.fromkeys(single)))
    name = printable(f"{ordered[0].name} to {ordered[-1].name}")
    return SceneSequence(paths=tuple(ordered), name=name)


def resolve(path: Path) -> SceneSequence | Path:
    """The sequence at `path`, a folder or a glob; the only scene in it; else `path` itself, which may be
    anything: a file, a folder that is one scene (SOG) or a capture.

    Raises:
        InputError: the folder holds nothing that can be opened, or the glob matches other things alone.
    """
    if is_glob(path):
        matches = [Path(name) for name in glob.iglob(str(path), recursive=True)]
        found = [one for one in matches if _is_scene(one)]
        if not matches:
            return path  # which is missing, as whoever opens it says
        if not found:
            what = f"none of the {len(matches):,} that match is a scene"
            raise InputError(f"{path}: {what}; scenes are {_suffixes()}")
        ordered = in_natural_order(found)
        if len(ordered) == 1:
            return ordered[0]
        return SceneSequence(
            paths=tuple(ordered),
            name=printable(str(path)),
            pattern=str(path),
            alike=len({_pattern(str(one)) for one in ordered}) == 1,
        )
    if not os.path.isdir(path) or is_sog_folder(path) or is_capture(path):
        return path
    try:
        with os.scandir(path) as entries:
            inside = [Path(entry.path) for entry in entries if not entry.name.startswith(".")]
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    scenes = in_natural_order([one for one in inside if _is_scene(one)])
    if not scenes:
        raise InputError(f"{path}: holds no scene ({_suffixes()}) and no cameras{_hint(path, inside)}")
    if len(scenes) == 1:
        return scenes[0]
    frames = _frames(scenes)
    name = os.path.basename(os.path.abspath(path)) or str(path)
    return SceneSequence(
        paths=tuple(frames),
        name=printable(name),
        folder=path,
        left_out=len(scenes) - len(frames),
        alike=_alike(frames),
    )


def is_capture(folder: Path) -> bool:
    """Whether a folder is one of cameras or photos with cameras, whatever scenes lie in it besides."""
    if any(os.path.isfile(folder / name) for name in NERF):
        return True
    try:
        find_model(folder)
    except InputError:
        return False
    return True


def read_ahead(
    paths: Sequence[Path], *, progress: Progress | None = None
) -> Iterator[tuple[Path, Gaussians | InputError]]:
    """The frames one by one, each read while the caller works on the one before; those that cannot be read
    as the reason why. No more than two are in memory by this."""
    ended = False

    def cancelled() -> bool:
        return ended or (progress is not None and progress.cancelled is not None and progress.cancelled())

    def read(path: Path) -> Gaussians | InputError:
        try:
            return load_scene(path, progress=Progress(cancelled=cancelled))
        except InputError as error:
            return error

    with ThreadPoolExecutor(1, thread_name_prefix="splatview-frames") as pool:
        try:
            coming: Future[Gaussians | InputError] | None = None
            for i, path in enumerate(paths):
                got = (coming or pool.submit(read, path)).result()
                coming = pool.submit(read, paths[i + 1]) if i + 1 < len(paths) else None
                yield path, got
                del got
        finally:
            ended = True  # a frame that nobody waits for any more is given up


def _is_scene(path: Path) -> bool:
    if os.path.isdir(path):
        return is_sog_folder(path)
    return format_of(path) is not None and os.path.lexists(path)


def _pattern(name: str) -> str:
    return re.sub(r"[0-9]+", "#", name.casefold())


def _alike(paths: Sequence[Path]) -> bool:
    """Whether all lie in one folder and differ in nothing but numbers."""
    return len({path.parent for path in paths}) == 1 and len({_pattern(path.name) for path in paths}) == 1


def _frames(scenes: Sequence[Path]) -> list[Path]:
    """Those of a folder's scenes, in order, that are its frames: the largest group that is numbered alike, if
    it is enough of them, else all."""
    groups = Counter(_pattern(path.name) for path in scenes if _pattern(path.name) != path.name.casefold())
    for pattern, count in groups.most_common(1):  # of groups of one size the first in order
        if count >= max(2, LEAST_SHARE * len(scenes)):
            return [path for path in scenes if _pattern(path.name) == pattern]
    return list(scenes)


def _suffixes() -> str:
    return ", ".join(known.suffix for known in FORMATS.values() if known.suffix.count(".") == 1)


def _hint(folder: Path, inside: Sequence[Path]) -> str:
    """What else could be done with a folder without scenes of its own."""
    if any(one.suffix.lower() in PHOTOS for one in inside):
        return "; it holds photos: splatview train makes a scene of photos with known cameras"
    for one in in_natural_order([one for one in inside if os.path.isdir(one)])[:16]:
        below = [Path(name) for name in glob.iglob(str(Path(glob.escape(str(one))) / "*"))]
        scene = next((path for path in below if _is_scene(path)), None)
        if scene is not None:
            return f"; name those in its folders by a glob in quotes: '{folder}/*/*{scene.suffix}'"
    return ""
