"""Scenes from .sog, splats as pictures: a zip or a folder of lossless WebP and a meta.json.

Texel i of every picture is splat i. Versions 1 (ranges) and 2 (codebooks), and streamed SOG: a lod-meta.json
whose tree names parts of several such folders, one per level of detail, of which the finest is read. Source:
playcanvas/splat-transform, read-sog.ts, read-sog-v1.ts and read-lod.ts (MIT), read for facts.
"""

from __future__ import annotations

import io
import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.io import excerpt, open_regular
from splatview.scene.formats.packing import (
    LOGITS,
    SQRT_HALF,
    check_expansion,
    check_room,
    empty_arrays,
    parsed_json,
    rows_of,
    scene_of,
)
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians, concatenate
from splatview.scene.progress import Progress

META, LOD_META = "meta.json", "lod-meta.json"

MAX_META_BYTES = 1 << 24

PALETTE_COLUMNS = 64
"""Palette entries side by side in the picture of the centroids."""

TAGS = {"antialiased": "antialiased 1", "2dgs": "SplatRenderMode: 2dgs"}
"""The file's word for its model -> the comment that says so."""

MOST_CHUNKS = 1 << 16
"""Files that a streamed scene may name."""


class Source(Protocol):
    """Where the files of a scene come from."""

    name: Path
    """For messages."""
    held: int
    """Bytes in all."""

    def read(self, name: str, most: int) -> bytes:
        """A file of at most `most` bytes. Raises InputError."""
        ...


def is_zip(start: bytes) -> bool:
    return start.startswith(b"PK\x03\x04")


def is_sog_folder(path: Path) -> bool:
    """Whether `path` is such a folder, or the file in it that describes the others."""
    if path.name in (META, LOD_META):
        return os.path.isfile(path)
    # os.path: unlike Path's, its questions have an answer for every name.
    return os.path.isdir(path) and any(os.path.isfile(path / name) for name in (META, LOD_META))


DAMAGED_ZIP = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error),
    *(NotImplementedError, RuntimeError, EOFError, UnicodeDecodeError),
)
"""What zipfile raises."""


def read_sog(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats of a zip. Raises InputError and Cancelled."""
    _check_directory(file, path)
    try:
        with zipfile.ZipFile(file) as archive:
            source = _Zip(archive, path, os.fstat(file.fileno()).st_size)
            return _read_unit(source, _meta_of(source, META), progress, room)
    except DAMAGED_ZIP as error:
        raise InputError(f"{path}: is a damaged zip ({error}); copy or export it again") from None


MOST_DIRECTORY = 1 << 20
"""Bytes of a zip's list of its files, which zipfile makes ten times as many of Python's objects of: there are
eight files, of some 60 bytes each."""


def _check_directory(file: io.BufferedReader, path: Path) -> None:
    """Raises InputError where a zip lists more than it can hold of a scene. Source: APPNOTE.TXT, 4.3.14 and
    4.3.16."""
    size = file.seek(0, io.SEEK_END)
    file.seek(max(0, size - 2**16 - 128))
    tail = file.read()
    file.seek(0)
    end, wide_end = tail.rfind(b"PK\5\6"), tail.rfind(b"PK\6\6")
    sizes = [int.from_bytes(tail[end + 12 : end + 16], "little")] if end >= 0 else []
    if sizes == [2**32 - 1]:
        sizes = [int.from_bytes(tail[wide_end + 40 : wide_end + 48], "little")] if wide_end >= 0 else []
    if any(size > MOST_DIRECTORY for size in sizes):
        raise InputError(f"{path}: lists more files than a scene has: it is damaged; export it again")


def read_sog_folder(path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats of a folder, or of the finest level of a streamed scene. Raises InputError and Cancelled."""
    folder = path if path.is_dir() else path.parent
    streamed = path.name == LOD_META or not os.path.isfile(folder / META)
    source = _Folder(folder)
    if streamed:
        return _read_streamed(source, folder, progress, room)
    return _read_unit(source, _meta_of(source, META), progress, room)


class _Zip:
    def __init__(self, archive: zipfile.ZipFile, path: Path, held: int) -> None:
        self.name, self._archive, self.held = path, archive, held

    def read(self, name: str, most: int) -> bytes:
        try:
            entry = self._archive.getinfo(_plain(name, self.name))
        except KeyError:
            raise InputError(f"{self.name}: has no {excerpt(name)}; export it again") from None
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            # Dictionaries of others are as large as the file says, before a byte of it is unpacked.
            raise InputError(
                f"{self.name}: its {name} is packed in a way that .sog does not have; export it again"
            )
        with self._archive.open(entry) as file:
            # An entry may lie about its size.
            data = file.read(most + 1)
        if len(data) > most:
            raise InputError(
                f"{self.name}: its {name} is larger than {most:,} bytes: it is damaged, or made to fill the "
                "memory"
            )
        return data


class _Folder:
    def __init__(self, folder: Path) -> None:
        self.name = folder
        try:
            with os.scandir(folder) as entries:
                self.held = sum(entry.stat().st_size for entry in entries if entry.is_file())
        except OSError as error:
            raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from None

    def read(self, name: str, most: int) -> bytes:
        path = self.name / _plain(name, self.name)
        with open_regular(path) as file:
            data = file.read(most + 1)
        if len(data) > most:
            raise InputError(f"{path}: is larger than {most:,} bytes: it is damaged")
        return data


def _plain(name: Any, where: Path) -> str:
    """`name` if it is that of a file beside meta.json; nothing else is ever opened. Raises InputError."""
    if not isinstance(name, str) or not name or name in (".", "..") or any(c in name for c in "/\\:\0"):
        raise InputError(
            f"{where}: names {excerpt(str(name))} as one of its files: only plain names are read"
        )
    return name


def _meta_of(source: Source, name: str) -> dict[str, Any]:
    meta = parsed_json(source.read(name, MAX_META_BYTES), source.name, f"its {name}")
    if not isinstance(meta, dict):
        raise InputError(f"{source.name}: its {name} holds no object; export it again")
    return meta


@contextmanager
def _described(source: Source) -> Iterator[None]:
    """Whatever is not as meta.json should have it is told in one line."""
    try:
        yield
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, AttributeError) as error:
        raise InputError(
            f"{source.name}: its {META} is not that of a scene ({type(error).__name__}: {excerpt(str(error))}"
            "); export it again"
        ) from None


def _read_unit(source: Source, meta: dict[str, Any], progress: Progress, room: float) -> Gaussians:
    with _described(source):
        version = meta.get("version", 1)
        if version not in (1, 2):
            raise InputError(f"{source.name}: is version {excerpt(str(version))} of .sog; 1 and 2 are read")
        n = meta["count"] if version == 2 else meta["means"]["shape"][0]
        if isinstance(n, bool) or not isinstance(n, int) or not 0 <= n < 2**31:
            raise InputError(f"{source.name}: a count of {excerpt(str(n))} splats: it is damaged")
        check_expansion(source.name, 20 * n, source.held)
        shn = meta.get("shN") or {}
        check_room(source.name, n, int(shn.get("bands", 3 if shn else 0)), room)
        pictures = _Pictures(source, n)
        return _decoded(pictures, meta, version, n, progress)


class _Pictures:
    """The pictures of a scene of n splats, as rows of texels."""

    def __init__(self, source: Source, n: int) -> None:
        self.source, self._n = source, n

    def texels(self, name: Any, *, alpha: bool = False) -> np.ndarray:
        """(N, 4) uint8, one per splat; (N, 3) where the picture has no `alpha` and none is needed."""
        pixels = self.pixels(name, self._n, alpha=alpha)
        return pixels.reshape(-1, pixels.shape[2])[: self._n]

    def pixels(self, name: Any, least: int, *, alpha: bool = False) -> np.ndarray:
        """(H, W, 3 or 4) uint8, of at least so many texels and at most some rows more. Raises InputError."""
        from PIL import WebPImagePlugin

        source = self.source
        # A WebP is packed already: a zip makes it no smaller.
        data = source.read(name, 2 * source.held + MAX_META_BYTES)
        # Before the library is asked, which makes room for whatever size is said.
        width, height = _size_of_webp(data)
        if width * height < least:
            raise InputError(
                f"{source.name}: {name} has {width}x{height} texels, and {least:,} are needed: it is of "
                "another scene, damaged, or no WebP"
            )
        if width * height > 2 * least + 2**20:
            raise InputError(
                f"{source.name}: {name} has {width}x{height} texels for {least:,} splats: damaged"
            )
        try:
            # Not Image.open, which warns of large pictures and refuses larger ones.
            with WebPImagePlugin.WebPImageFile(io.BytesIO(data)) as image:
                if image.size != (width, height):
                    raise ValueError("its size is not what it says")
                pixels = np.asarray(image if image.mode == "RGBA" or not alpha else image.convert("RGBA"))
                # Kernels are compiled for arrays that can be written to and for others: once is enough.
                pixels.setflags(write=False)
                return pixels
        except (OSError, ValueError, SyntaxError, EOFError) as error:
            raise InputError(
                f"{source.name}: {name} is no WebP that can be read ({error}); export it again"
            ) from None


def _size_of_webp(data: bytes) -> tuple[int, int]:
    """Width and height that a WebP says to have; (0, 0) of what is none. Source: the container's
    specification, of which the first chunk is enough."""
    kind, body = data[12:16], data[20:30]
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP" or len(body) < 10:
        return 0, 0
    if kind == b"VP8X":
        return 1 + int.from_bytes(body[4:7], "little"), 1 + int.from_bytes(body[7:10], "little")
    if kind == b"VP8L":
        bits = int.from_bytes(body[1:5], "little")
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    if kind == b"VP8 ":
        return int.from_bytes(body[6:8], "little") & 0x3FFF, int.from_bytes(body[8:10], "little") & 0x3FFF
    return 0, 0


def _decoded(
    pictures: _Pictures, meta: dict[str, Any], version: int, n: int, progress: Progress
) -> Gaussians:
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.decoding import decode_sog

    names = [*_names(meta["means"], 2), *(_names(meta[entry], 1)[0] for entry in ("quats", "scales", "sh0"))]
    texels = []
    for name, alpha in zip(names, (False, False, True, False, True), strict=True):
        texels.append(pictures.texels(name, alpha=alpha))
        progress.step(0.1 * len(texels))
    shn = meta.get("shN") or None
    palette = _palette(pictures, shn, version) if shn else NO_PALETTE
    progress.step(0.6)
    texels.append(pictures.texels(_names(shn, 2)[1]) if shn else texels[0])
    progress.step(0.7)
    low, high = (_numbers(meta["means"][end], 3)[:, None] for end in ("mins", "maxs"))
    words = np.arange(2**16)
    if n < len(words) // 4:
        words = np.unique(texels[1][:, :3].astype(np.uint16) << 8 | texels[0][:, :3])
    logs = _between(low, high, words[None], 65535)
    means = np.zeros((3, 2**16), np.float32)
    means[:, words] = np.sign(logs) * np.expm1(np.abs(logs))
    if version == 2:
        log_scales, colours = (np.tile(_codebook(meta[entry]), (3, 1)) for entry in ("scales", "sh0"))
        logits = LOGITS
    else:
        log_scales, colours = _levels(meta["scales"], 3), _levels(meta["sh0"], 4)
        colours, logits = colours[:3], colours[3]
    arrays = empty_arrays(n, SH_COEFFICIENTS.index(1 + palette.shape[1] // 3))
    over_splats(
        decode_sog,
        n,
        tuple(texels),
        palette,
        (means, QUAT_LEVELS, log_scales, colours, logits),
        rows_of(arrays),
        progress=progress.part(0.7, 1.0),
    )
    tag = TAGS.get(str(meta.get("model", "")))
    if tag is None and meta.get("antialias") is True:
        tag = TAGS["antialiased"]
    return scene_of(arrays, (tag,) if tag else ())


QUAT_LEVELS = (np.arange(256, dtype=np.float32) * np.float32(2 / 255) - 1) * SQRT_HALF
"""Component of a quaternion for each byte."""


def _levels(entry: dict[str, Any], count: int) -> np.ndarray:
    """(count, 256) float32: what the bytes of each channel mean in version 1."""
    low, high = (_numbers(entry[end], count)[:, None] for end in ("mins", "maxs"))
    return _between(low, high, np.arange(256)[None], 255).astype(np.float32)


NO_PALETTE = np.zeros((1, 0), np.float32)


def _palette(pictures: _Pictures, shn: dict[str, Any], version: int) -> np.ndarray:
    """(entries + 1, 3 x coefficients) float32: the bands above the constant one, for each label. The last is
    zeros, for labels that are none. Raises InputError, KeyError and ValueError."""
    name = _names(shn, 2)[0]
    most = int(shn["count"]) if version == 2 else 2**16
    if not 0 < most <= 2**16:
        raise InputError(f"{pictures.source.name}: a palette of {most:,} entries: it is damaged")
    pixels = pictures.pixels(name, PALETTE_COLUMNS) if version == 1 else None
    if pixels is None:
        degree = int(shn["bands"])
        if not 1 <= degree <= 3:
            raise InputError(f"{pictures.source.name}: SH degree {degree}; there are 1 to 3: it is damaged")
        rows = -(-most // PALETTE_COLUMNS)
        pixels = pictures.pixels(name, rows * PALETTE_COLUMNS * (SH_COEFFICIENTS[degree] - 1))
    per_channel = pixels.shape[1] // PALETTE_COLUMNS
    if per_channel + 1 not in SH_COEFFICIENTS[1:] or pixels.shape[1] % PALETTE_COLUMNS:
        raise InputError(f"{pictures.source.name}: a palette {pixels.shape[1]} texels wide makes no SH bands")
    if version == 2:
        levels = _codebook(shn)
    else:
        low, high = float(shn["mins"]), float(shn["maxs"])
        levels = (low + (high - low) * (np.arange(256) / np.float32(255))).astype(np.float32)
    # The coefficients of an entry lie side by side, and so do PALETTE_COLUMNS entries.
    rows = pixels[..., :3].reshape(len(pixels) * PALETTE_COLUMNS, 3 * per_channel)[:most]
    palette = np.zeros((len(rows) + 1, rows.shape[1]), np.float32)
    np.take(levels, rows, out=palette[:-1])
    return palette


def _names(entry: dict[str, Any], count: int) -> list[Any]:
    files = entry["files"]
    if not isinstance(files, list) or len(files) != count:
        raise ValueError(f"files must be {count} names")
    return files


def _numbers(values: Any, count: int) -> np.ndarray:
    numbers = np.array(values, np.float64)
    if numbers.shape != (count,) or not np.isfinite(numbers).all():
        raise ValueError(f"{count} finite numbers are needed")
    return numbers


def _codebook(entry: dict[str, Any]) -> np.ndarray:
    """(256,) float32. Old files have null for entries that nothing uses."""
    values = entry["codebook"]
    if not isinstance(values, list) or not 0 < len(values) <= 256:
        raise ValueError("codebook must be 256 numbers")
    known = [0.0 if value is None else float(value) for value in values]
    book = np.zeros(256, np.float32)
    book[: len(known)] = known
    if not np.isfinite(book).all():
        raise ValueError("codebook must be finite")
    return book


def _between(low: np.ndarray, high: np.ndarray, whole: np.ndarray, most: int) -> np.ndarray:
    return low + (high - low) * (whole / most)


def _read_streamed(source: _Folder, folder: Path, progress: Progress, room: float) -> Gaussians:
    """Every leaf of the tree at its finest level: levels show the same things, and are never put together."""
    meta = _meta_of(source, LOD_META)
    with _described(source):
        if meta.get("version", 1) != 1:
            raise InputError(
                f"{folder}: is version {excerpt(str(meta['version']))} of streamed SOG; 1 is read"
            )
        names = meta["filenames"]
        if not isinstance(names, list) or len(names) > MOST_CHUNKS:
            raise InputError(f"{folder}: its {LOD_META} names no files, or too many")
        parts = _finest(meta["tree"], len(names), folder)
        if isinstance(meta.get("environment"), str):
            names, parts = [*names, meta["environment"]], {**parts, len(names): None}
    scenes = []
    for done, (number, ranges) in enumerate(sorted(parts.items())):
        unit = _unit_folder(folder, names[number])
        piece = progress.part(done / len(parts), (done + 1) / len(parts))
        scene = _read_unit(unit, _meta_of(unit, META), piece, room - sum(scene.nbytes for scene in scenes))
        if ranges is not None:
            if any(stop > len(scene) for _, stop in ranges):
                raise InputError(
                    f"{unit.name}: has {len(scene):,} splats, and {LOD_META} asks for more: damaged"
                )
            taken = np.zeros(len(scene), bool)
            for start, stop in ranges:
                taken[start:stop] = True
            scene = scene if taken.all() else scene.take(taken)
        scenes.append(scene)
    if not scenes:
        raise InputError(f"{folder}: its {LOD_META} names no splats")
    levels = meta.get("lodLevels")
    whole = concatenate(scenes) if len(scenes) > 1 else scenes[0]
    note = f"splatview: the finest of {levels} levels of detail, from {len(scenes)} files"
    return whole if levels in (None, 1) else replace(whole, comments=(*whole.comments, note))


def _finest(tree: Any, files: int, folder: Path) -> dict[int, list[tuple[int, int]] | None]:
    """Ranges of splats by number of the file."""
    found: dict[int, list[tuple[int, int]] | None] = {}
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        levels = {int(level): part for level, part in (node.get("lods") or {}).items()}
        if levels:
            part = levels[min(levels)]
            number, start, count = (part[key] for key in ("file", "offset", "count"))
            if any(isinstance(x, bool) or not isinstance(x, int) or x < 0 for x in (number, start, count)):
                raise ValueError("file, offset and count must be whole numbers")
            if number >= files:
                raise InputError(f"{folder}: its tree asks for file {number}, and there are {files}: damaged")
            ranges = found.setdefault(number, [])
            assert ranges is not None
            ranges.append((start, start + count))
        waiting += node.get("children") or []
    return found


def _unit_folder(folder: Path, name: Any) -> _Folder:
    """The folder of a meta.json one level down; no other path is followed. Raises InputError."""
    parts = name.split("/") if isinstance(name, str) else []
    if len(parts) != 2 or parts[1] != META:
        raise InputError(f"{folder}: names {excerpt(str(name))}, and only FOLDER/{META} below it is read")
    return _Folder(folder / _plain(parts[0], folder))
