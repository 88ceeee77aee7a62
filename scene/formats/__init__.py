"""Scenes and cameras from and to files: the table of scene formats, each in a module of its own."""

from __future__ import annotations

import io
import math
import os
import shutil
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.effects.appearance import antialiasing, is_flat, is_tag
from splatview.scene.errors import InputError
from splatview.scene.formats import compressed_ply, splat, spz
from splatview.scene.formats.cameras import read_cameras_file, write_camera
from splatview.scene.formats.colmap import find_model, is_colmap
from splatview.scene.formats.compressed_ply import save_compressed
from splatview.scene.formats.folders import atomic_folder, folder_target
from splatview.scene.formats.gltf import is_glb, read_glb, read_gltf, save_glb
from splatview.scene.formats.io import atomic_write, open_regular, target_of
from splatview.scene.formats.ksplat import is_ksplat, read_ksplat
from splatview.scene.formats.packing import slices, storable
from splatview.scene.formats.ply import is_ply, read_ply, save_ply
from splatview.scene.formats.sog import META, is_zip, read_sog
from splatview.scene.formats.sog_folder import (
    LOD_META,
    foreign_name,
    is_sog_folder,
    read_sog_folder,
    save_sog_folder,
    save_streamed,
)
from splatview.scene.formats.sog_write import save_sog
from splatview.scene.formats.splat import read_splat, save_splat
from splatview.scene.formats.spz import is_record, is_spz, read_spz, save_spz
from splatview.scene.gaussians import NOTE, Gaussians, near_plane
from splatview.scene.image_model import BLUR, NEAR
from splatview.scene.progress import NO_PROGRESS, Cancelled, Progress
from splatview.scene.sh import SH_C0


@dataclass(frozen=True, kw_only=True)
class Format:
    """A format of scene files."""

    suffix: str
    """Lower case, with its dot; of a `folder`, a slash and the name of the file that it is opened by."""
    folder: bool = False
    """Whether it is all files of a folder."""
    sniff: Callable[[bytes], bool] | None = None
    """Whether a file with these first SNIFFED bytes is one; None: they do not tell, and the suffix does."""
    read: Callable[[io.BufferedReader, Path, Progress, float], Gaussians]
    """Reader of a file from its start into so many bytes of memory at most; the path is for messages."""
    write: Callable[..., None] | None = None
    """Writer of a whole file, atomically: (gaussians, path, progress), and the knobs by name. None: not
    written."""
    knobs: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    """Keywords of `write` that make a file smaller and worse: their values, the finest last."""
    sh_knobs: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    """The same of the SH above the constant band; one at most."""
    sh: bool = True
    """Whether it holds bands above the constant one, as all that follows are things that it may hold."""
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """The least and the largest of values in RANGED that it holds, where they are few; those beyond become
    the nearest."""
    comments: bool = False
    held_comment: Callable[[str], bool] = lambda comment: False
    """Whether one without `comments` has a place of its own for this one."""
    extras: bool = False
    """Properties that are not a splat's own."""
    doubles: bool = False
    """Positions in float64."""
    exact: bool = False
    """Numbers as they are, not in fewer bits."""
    antialiased: bool = False
    """The tag that a scene was trained so."""
    discs: bool = False
    """The tag that splats are planar."""

    @property
    def all_knobs(self) -> dict[str, tuple[Any, ...]]:
        return {**self.knobs, **self.sh_knobs}


def _read_folder(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    return read_sog_folder(path, progress, room)


SOG_KNOBS = {
    "position_bits": (9, 11, 12, 13, 14, 16),
    "rotation_bits": (4, 5, 6, 7, 8),
    "codes": (16, 32, 64, 256),
}
SOG_SH_KNOBS = {"palette": (256, 1024, 4096, 16384, 65536)}

FORMATS = {
    "ply": Format(
        suffix=".ply",
        sniff=is_ply,
        read=read_ply,
        write=save_ply,
        comments=True,
        extras=True,
        doubles=True,
        exact=True,
        antialiased=True,
        discs=True,
    ),
    "compressed": Format(
        suffix=".compressed.ply",
        read=read_ply,
        write=save_compressed,
        ranges=compressed_ply.RANGES,
        comments=True,
        antialiased=True,
        discs=True,
    ),
    "splat": Format(suffix=".splat", read=read_splat, write=save_splat, sh=False, ranges=splat.RANGES),
    "spz": Format(
        suffix=".spz",
        sniff=is_spz,
        read=read_spz,
        write=save_spz,
        ranges=spz.RANGES,
        held_comment=is_record,
        antialiased=True,
        knobs={"position_bits": (12, 14, 16, 18, 20, 24)},
        sh_knobs={"sh_bits": ((3, 2, 2), (4, 3, 3), (5, 4, 4), (6, 5, 5), (8, 8, 8))},
    ),
    "ksplat": Format(suffix=".ksplat", sniff=is_ksplat, read=read_ksplat),
    "sog": Format(
        suffix=".sog",
        sniff=is_zip,
        read=read_sog,
        write=save_sog,
        antialiased=True,
        discs=True,
        knobs=SOG_KNOBS,
        sh_knobs=SOG_SH_KNOBS,
    ),
    "sog folder": Format(
        suffix=f"/{META}",
        folder=True,
        read=_read_folder,
        write=save_sog_folder,
        antialiased=True,
        discs=True,
        knobs=SOG_KNOBS,
        sh_knobs=SOG_SH_KNOBS,
    ),
    "streamed": Format(
        suffix=f"/{LOD_META}",
        folder=True,
        read=_read_folder,
        write=save_streamed,
        antialiased=True,
        discs=True,
        knobs=SOG_KNOBS,
        sh_knobs=SOG_SH_KNOBS,
    ),
    "glb": Format(suffix=".glb", sniff=is_glb, read=read_glb, write=save_glb, exact=True),
    "gltf": Format(suffix=".gltf", read=read_gltf),
}
"""Every format that is known, by name; readers, writers, messages and file dialogs go by it."""

SNIFFED = 8
"""Bytes that tell a format."""

CHECKED_BYTES = 1 << 20
"""Camera lists up to this size are looked through before a window is opened for them."""

PICTURES = (b"\x89PNG", b"\xff\xd8\xff", b"RIFF", b"GIF8")


def load_scene(
    path: str | os.PathLike[str], *, progress: Progress = NO_PROGRESS, room: float = math.inf
) -> Gaussians:
    """The splats in a file, in `room` bytes of memory at most; the format is told by its first bytes.

    Raises:
        InputError: the file is missing, damaged, too large or of another kind.
        Cancelled: nobody waits for it any more.
    """
    path = Path(path)
    # Numbers of a file may be anything, and what is computed of them too: nobody draws what is not finite.
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        if is_sog_folder(path):
            return read_sog_folder(path, progress, room)
        with open_regular(path, folder="is a folder, not a scene; name the file in it") as file:
            return _reader(file, path)(file, path, progress, room)


def is_camera_list(path: Path) -> bool:
    """Whether `path` is that of cameras rather than of a scene, by its name."""
    return not is_sog_folder(path) and (is_colmap(path) or path.suffix.lower() == ".json")


def check_opening(path: Path) -> None:
    """Raises InputError where `path` is neither a scene nor cameras, as far as a moment's look tells."""
    if not is_camera_list(path):
        with suppress(Cancelled):
            load_scene(path, progress=Progress(cancelled=lambda: True))
    elif path.is_dir():
        find_model(path)
    elif not path.is_file() or path.stat().st_size <= CHECKED_BYTES:
        load_cameras(path)


def _reader(
    file: io.BufferedReader, path: Path
) -> Callable[[io.BufferedReader, Path, Progress, float], Gaussians]:
    """The reader of the file's format; `file` is at its start before and after. Raises InputError."""
    start = file.read(SNIFFED)
    file.seek(0)
    if not start:
        raise InputError(f"{path}: is empty")
    suffix = path.suffix.lower()
    told = (known.read for known in FORMATS.values() if known.sniff is not None and known.sniff(start))
    # Where the bytes do not tell a format, the suffix does.
    named = (known.read for known in FORMATS.values() if known.sniff is None and known.suffix == suffix)
    reader = next(told, None) or next(named, None)
    if reader is not None:
        return reader
    suffixes = [known.suffix for known in FORMATS.values() if known.suffix.rfind(".") == 0]
    if start.startswith(PICTURES):
        raise InputError(f"{path}: is a picture, not a scene; scenes are {', '.join(suffixes)}")
    if suffix in suffixes:
        raise InputError(f"{path}: is not a {suffix} file (it begins otherwise); export it again")
    raise InputError(f"{path}: is no scene that is known; there are {', '.join(suffixes)}")


def name_patterns(*, written: bool = False) -> str:
    """File name patterns of all formats, or of those that are `written`, as file dialogs want them."""
    suffixes = [
        known.suffix.removeprefix("/") if known.folder else f"*{known.suffix}"
        for known in FORMATS.values()
        if known.write or not written
    ]
    return " ".join(suffixes)


def save_scene(
    gaussians: Gaussians,
    path: str | os.PathLike[str],
    *,
    progress: Progress = NO_PROGRESS,
    knobs: Mapping[str, Any] | None = None,
) -> None:
    """Writes a scene in the format of the suffix, wholly or not at all: an older file stays until then.
    `knobs`: some of the format's, by name.

    Raises:
        InputError: the suffix names no format that can be written, or the system refuses.
    """
    path = Path(path)
    check_format(path)(gaussians, path, progress, **(knobs or {}))


def check_format(path: Path) -> Callable[..., None]:
    """The writer of the format that the suffix names. Raises InputError if that can be none."""
    known = format_of(path)
    if known is None or known.write is None:
        suffixes = " or ".join(
            f"FOLDER{known.suffix}" if known.folder else known.suffix
            for known in FORMATS.values()
            if known.write
        )
        raise InputError(f"{path}: scenes are saved as {suffixes}; give it that suffix")
    return known.write


def format_of(path: Path) -> Format | None:
    """The format that the name of `path` ends with."""
    name = f"/{path.name.lower()}"
    named = [known for known in FORMATS.values() if name.endswith(known.suffix)]
    return max(named, key=lambda known: len(known.suffix), default=None)


def losses(gaussians: Gaussians, path: Path) -> list[str]:
    """What the scene loses by being written to `path`, a line each."""
    known = format_of(path)
    if known is None:
        return []
    lost = []
    left_out = 0 if known.exact else len(gaussians) - int(np.count_nonzero(storable(gaussians)))
    if left_out:
        lost.append(f"{left_out:,} splats with values that nothing can draw are left out")
    if not known.sh and gaussians.sh_degree:
        lost.append(f"SH of degree {gaussians.sh_degree} become one colour from everywhere")
    if not known.exact:
        lost.append("numbers are rounded to fewer bits")
    if not known.doubles and gaussians.means.dtype == np.float64:
        lost.append("positions become float32")
    antialiased, blur, _ = antialiasing(gaussians.comments)
    if antialiased and not known.antialiased:
        lost.append("the tag that it was trained antialiased")
    elif antialiased and blur != BLUR and not known.comments:
        lost.append(f"the kernel of {blur:g} px² that it was trained with; readers take {BLUR:g}")
    if near_plane(gaussians.comments) > NEAR and not known.comments:
        lost.append("its near plane")
    if is_flat(gaussians) and not known.discs:
        lost.append("the tag that its splats are discs")
    for name, (low, high) in known.ranges.items():
        what, values, text = RANGED[name]
        if beyond := _count_beyond(values(gaussians), low, high):
            lost.append(
                f"{beyond:,} splats have {what} beyond its range of {text(low)} to {text(high)}, and get the "
                "nearest"
            )
    said = [one for one in gaussians.comments if not (one.startswith(NOTE) or is_tag(one))]
    comments = sum(not known.held_comment(one) for one in said)
    if comments and not known.comments:
        lost.append("a comment" if comments == 1 else f"{comments} comments")
    if gaussians.extras and not known.extras:
        lost.append(f"properties that are not a splat's own: {', '.join(gaussians.extras)}")
    return lost


RANGED: dict[str, tuple[str, Callable[[Gaussians], np.ndarray], Callable[[float], str]]] = {
    "log_scales": ("sizes", lambda scene: scene.log_scales, lambda value: f"{math.exp(value):.3g}"),
    "colours": ("colours", lambda scene: scene.sh[:, 0], lambda value: f"{round(0.5 + SH_C0 * value, 3):g}"),
    "sh": ("SH coefficients", lambda scene: scene.sh[:, 1:], lambda value: f"{value:.3g}"),
}
"""What formats may have a range of: its word, the values (N, ...), and a limit as users know it."""

BEYOND = 0.002
"""Share of a range by which values are beyond it: what is nearer is rounded to its end, as to any step."""


def _count_beyond(values: np.ndarray, low: float, high: float) -> int:
    """Splats with a value out of a range."""
    low, high = low - BEYOND * (high - low), high + BEYOND * (high - low)
    rows = (values[part].reshape(part.stop - part.start, -1) for part in slices(len(values)))
    return sum(int(((part < low) | (part > high)).any(axis=1).sum()) for part in rows)


def check_saving(path: Path) -> None:
    """Raises InputError where `save_scene` could not write `path`, so that nobody works on it in vain."""
    check_format(path)
    known = format_of(path)
    if known is not None and known.folder:
        folder_target(path, foreign_name)
    else:
        target_of(path)


def named_output(text: str) -> Path:
    """The file that a user means by `text`: a folder's name (one that exists, that ends in a slash, or that
    has no suffix) stands for a folder of .sog."""
    path = Path(text)
    is_folder = text.endswith(("/", os.sep)) or os.path.isdir(path) or not path.suffix
    return path / META if is_folder else path


def place_beside(path: Path) -> Path:
    """What files beside the scene `path` are named after: the folder, of a scene that is one."""
    known = format_of(path)
    return path.parent if known is not None and known.folder else path


def stored_bytes(path: Path) -> int:
    """Size of a scene that was written as `path`."""
    known = format_of(path)
    if known is None or not known.folder:
        return path.stat().st_size
    return sum(
        os.stat(os.path.join(at, file)).st_size for at, _, files in os.walk(path.parent) for file in files
    )


def place_copy(source: Path, path: Path, progress: Progress = NO_PROGRESS) -> None:
    """Copies a written scene to `path`, wholly or not at all. Raises InputError and Cancelled."""
    known = format_of(path)
    if known is not None and known.folder:
        with atomic_folder(path, foreign_name) as folder:
            shutil.copytree(source.parent, folder, dirs_exist_ok=True)
            progress.check()
        return
    with atomic_write(path) as target, open(source, "rb") as file:
        while part := file.read(1 << 22):
            progress.check()
            target.write(part)


def trial_path(folder: Path, path: Path) -> Path:
    """The file in an empty `folder` that is written to try `path`."""
    known = format_of(path)
    return folder / "scene" / path.name if known is not None and known.folder else folder / path.name


def load_cameras(
    path: str | os.PathLike[str],
    *,
    on_note: Callable[[str], None] = lambda note: None,
    progress: Progress = NO_PROGRESS,
) -> list[Camera]:
    """The cameras in a file or folder, at least one.

    Read are our own JSON (one camera or a list), the ``cameras.json`` that the 3DGS trainer writes, and
    COLMAP models (a folder, or its ``cameras`` or ``images`` file, .bin or .txt; sorted by image name).
    `on_note` gets a line about each lens that is no pinhole.

    Raises:
        InputError: the file is missing, damaged or of another kind.
        Cancelled: nobody waits for it any more.
    """
    return read_cameras_file(Path(path), on_note, progress)


def save_camera(camera: Camera, path: str | os.PathLike[str]) -> None:
    """Writes a camera as JSON that `load_cameras` reads, wholly or not at all. Raises InputError."""
    write_camera(camera, Path(path))
