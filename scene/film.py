"""Films to files: frames one after another into a video, a GIF or a folder of PNG, whole or not at all.

A folder needs nothing else. Videos and GIFs are encoded by PyAV, the extra "film"; its wheel brings SVT-AV1
and libvpx, whose codecs are free to use, and x264 for those who ask for H.264 by name.
"""

from __future__ import annotations

import os
import secrets
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from PIL import Image

from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write, sync_folder, target_of

Codec = Literal["av1", "vp9", "h264"]
CODECS: tuple[Codec, ...] = get_args(Codec)

Write = Callable[[np.ndarray], None]
"""Takes the next frame, (H, W, 3) uint8."""

INSTALL = "PyAV is not installed: pip install av; or name a folder, for PNG files"

LARGEST_GIF_RATE = 50.0
"""Frames a second: a GIF's are shown for hundredths of a second, and programs take one hundredth for ten."""


@dataclass(frozen=True, kw_only=True)
class FilmFormat:
    """One kind of film."""

    title: str
    suffix: str
    """"" for a folder."""
    codecs: tuple[Codec, ...] = ()
    """Of a video, the one that is taken unless another is named first."""


FORMATS = {
    "mp4": FilmFormat(title="Video, .mp4", suffix=".mp4", codecs=("av1", "h264")),
    "webm": FilmFormat(title="Video, .webm", suffix=".webm", codecs=("vp9", "av1")),
    "gif": FilmFormat(title="GIF", suffix=".gif"),
    "folder": FilmFormat(title="Folder of PNG", suffix=""),
}

CODEC_TITLES: dict[Codec, str] = {"av1": "AV1", "vp9": "VP9", "h264": "H.264"}

ENCODERS: dict[Codec, tuple[str, dict[str, str]]] = {
    "av1": ("libsvtav1", {"crf": "24", "preset": "8"}),
    "vp9": ("libvpx-vp9", {"crf": "24", "b": "0", "deadline": "good", "cpu-used": "4", "row-mt": "1"}),
    "h264": ("libx264", {"crf": "17", "preset": "medium"}),
}
"""Name of each codec's encoder, and its options: of a quality at which blocks are not seen."""


def film_format(path: Path) -> FilmFormat:
    """What `path` asks for by its suffix; a name without one is a folder.

    Raises:
        InputError: it has another suffix.
    """
    suffix = path.suffix.lower()
    if os.path.isdir(path):
        suffix = ""
    for known in FORMATS.values():
        if known.suffix == suffix:
            return known
    suffixes = ", ".join(known.suffix for known in FORMATS.values() if known.suffix)
    raise InputError(
        f"{path}: films are written as {suffixes}, or as PNG into a folder, a name without suffix"
    )


def check_film(path: Path, *, size: tuple[int, int], fps: float, codec: Codec | None = None) -> None:
    """Raises InputError, one line, where no such film could be written; before any work is done."""
    known = film_format(path)
    if codec is not None and codec not in known.codecs:
        can = f"holds {' or '.join(known.codecs)}" if known.codecs else "has no codec to choose"
        raise InputError(f"{path}: a film of this kind {can}, not {codec}")
    if not known.suffix:
        check_folder(path)
        return
    target_of(path)
    if known.codecs and (size[0] % 2 or size[1] % 2):
        even = "x".join(str(side + side % 2) for side in size)
        raise InputError(f"{size[0]}x{size[1]}: sides of a video are even; take {even}")
    if known.suffix == ".gif" and not fps <= LARGEST_GIF_RATE:
        raise InputError(f"{path}: a GIF has at most {LARGEST_GIF_RATE:.0f} frames a second, not {fps:g}")
    if find_spec("av") is None:
        raise InputError(f"{path}: {INSTALL}")


def check_folder(path: Path) -> Path:
    """The folder itself behind all links. Raises InputError where it cannot be made, or is not empty."""
    target = Path(os.path.realpath(path))
    try:
        if os.path.lexists(target) and (not os.path.isdir(target) or any(os.scandir(target))):
            raise InputError(f"{path}: is there already; name a new or an empty folder")
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not os.path.isdir(target.parent):
        raise InputError(f"{path}: the folder {target.parent} does not exist; make it first")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{path}: the folder {target.parent} cannot be written to")
    return target


@contextmanager
def film_writer(
    path: Path, *, size: tuple[int, int], fps: float, codec: Codec | None = None
) -> Iterator[Write]:
    """Takes the frames of a film of `size` (width, height) px, which has the name `path` when the block ends
    well; otherwise there is nothing, and a file that was there stays.

    Raises:
        InputError: see `check_film`; or the system refuses.
    """
    check_film(path, size=size, fps=fps, codec=codec)
    known = film_format(path)
    if not known.suffix:
        with _folder(path) as write:
            yield write
        return
    with atomic_write(path) as file, _video(file, known, size, fps, codec) as write:
        yield write


@contextmanager
def _folder(path: Path) -> Iterator[Write]:
    """Numbered PNG files, from 1."""
    target = check_folder(path)
    temporary = target.with_name(f".{target.name[:50]}.{secrets.token_hex(4)}.tmp")
    count = 0

    def write(frame: np.ndarray) -> None:
        nonlocal count
        count += 1
        Image.fromarray(frame).save(temporary / f"frame_{count:05}.png", format="PNG")

    try:
        temporary.mkdir()
        try:
            yield write
            if target.is_dir():
                target.rmdir()  # empty: not every system renames onto a folder
            temporary.replace(target)
        except BaseException:
            shutil.rmtree(temporary, ignore_errors=True)
            raise
        sync_folder(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


@contextmanager
def _video(
    file: Any, known: FilmFormat, size: tuple[int, int], fps: float, codec: Codec | None
) -> Iterator[Write]:
    """Frames into an open file, by PyAV."""
    os.environ.setdefault("SVT_LOG", "0")  # it tells of its settings otherwise, and of films that are stopped
    import av
    from av.error import FFmpegError
    from av.video.reformatter import ColorPrimaries, Colorspace, ColorTrc

    rate = Fraction(fps).limit_denominator(1001)
    width, height = size
    with av.open(file, "w", format=known.suffix[1:]) as container:
        if known.codecs:
            name, options = ENCODERS[codec or known.codecs[0]]
            stream: Any = container.add_stream(name, rate=rate, options=dict(options))
            stream.pix_fmt = "yuv420p"
            context = stream.codec_context
            # sRGB pictures, as players understand a video that is tagged so (BT.709 has the same primaries).
            context.color_primaries, context.color_trc = ColorPrimaries.BT709, ColorTrc.IEC61966_2_1
            context.colorspace, context.color_range = Colorspace.ITU709, 1
            palette = None
        else:
            stream = container.add_stream("gif", rate=rate)
            stream.pix_fmt = "pal8"
            palette = _palette(av, width, height, rate)
        stream.width, stream.height = width, height
        stream.time_base = 1 / rate
        count = 0

        def write(frame: np.ndarray) -> None:
            nonlocal count
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            picture.pts, picture.time_base = count, 1 / rate
            count += 1
            if palette is None:
                picture = picture.reformat(
                    format="yuv420p", dst_colorspace=Colorspace.ITU709, src_color_range=2, dst_color_range=1
                )
            else:
                palette.push(picture)
                picture = palette.pull()
            container.mux(stream.encode(picture))

        try:
            yield write
            container.mux(stream.encode(None))
        except FFmpegError as error:
            raise InputError(f"the film cannot be encoded: {error.strerror or error}") from None


def _palette(av: Any, width: int, height: int, rate: Fraction) -> Any:
    """A filter that gives each frame the 256 colours that suit it, with a pattern that rests for what lies
    between them: diffused errors flicker from frame to frame."""
    graph = av.filter.Graph()
    source = graph.add_buffer(width=width, height=height, format="rgb24", time_base=1 / rate)
    split, choose = graph.add("split"), graph.add("palettegen", "stats_mode=single")
    use, sink = graph.add("paletteuse", "new=1:dither=bayer:bayer_scale=3"), graph.add("buffersink")
    source.link_to(split)
    split.link_to(use, 0, 0)
    split.link_to(choose, 1, 0)
    choose.link_to(use, 0, 1)
    use.link_to(sink)
    graph.configure()
    return graph
