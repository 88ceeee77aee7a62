"""Scenes from .sog, splats as pictures: a zip or a folder of lossless WebP and a meta.json.

Texel i of every picture is splat i. Versions 1 (ranges) and 2 (codebooks). Source:
playcanvas/splat-transform, read-sog.ts and read-sog-v1.ts (MIT), read for facts.
"""

from __future__ import annotations

import io
import os
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
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
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress

META = "meta.json"

MAX_META_BYTES = 1 << 24

PALETTE_COLUMNS = 64
"""Palette entries side by side in the picture of the centroids."""

PALETTE_ROWS = 1 << 12
"""Entries that are looked up at once: numpy makes eight bytes of the index of each of their numbers."""

TAGS = {"antialiased": "antialiased 1", "2dgs": "SplatRenderMode: 2dgs"}
"""The file's word for its model -> the comment that says so."""


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
            return read_unit(source, progress, room)
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


class _Zip:
    def __init__(self, archive: zipfile.ZipFile, path: Path, held: int) -> None:
        self.name, self._archive, self.held = path, archive, held

    def read(self, name: str, most: int) -> bytes:
        try:
            entry = self._archive.getinfo(plain(name, self.name))
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


class SogFolder:
    def __init__(self, folder: Path) -> None:
        self.name = folder
        try:
            with os.scandir(folder) as entries:
                self.held = sum(entry.stat().st_size for entry in entries if entry.is_file())
        except OSError as error:
            raise InputError(f"{folder}: cannot be read: {error.strerror or error}") from None

    def read(self, name: str, most: int) -> bytes:
        path = self.name / plain(name, self.name)
        with open_regular(path) as file:
            # Python makes room for all that is asked for.
            data = file.read(min(most, os.fstat(file.fileno()).st_size) + 1)
        if len(data) > most:
            raise InputError(f"{path}: is larger than {most:,} bytes: it is damaged")
        return data


def plain(name: Any, where: Path) -> str:
    """`name` if it is that of a file beside meta.json; nothing else is ever opened. Raises InputError."""
    if not isinstance(name, str) or not name or name in (".", "..") or any(c in name for c in "/\\:\0"):
        raise InputError(
            f"{where}: names {excerpt(str(name))} as one of its files: only plain names are read"
        )
    return name


def meta_of(source: Source, name: str) -> dict[str, Any]:
    meta = parsed_json(source.read(name, MAX_META_BYTES), source.name, f"its {name}")
    if not isinstance(meta, dict):
        raise InputError(f"{source.name}: its {name} holds no object; export it again")
    return meta


@contextmanager
def described(source: Source) -> Iterator[None]:
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


def read_unit(source: Source, progress: Progress, room: float) -> Gaussians:
    unit = SogUnit.of(source)
    check_room(source.name, unit.count, unit.degree, room)
    arrays = empty_arrays(unit.count, unit.degree)
    unit.decode(arrays, progress)
    return scene_of(arrays, unit.comments)


@dataclass(frozen=True, kw_only=True)
class SogUnit:
    """A scene of one meta.json whose counts have been checked, and nothing of which is decoded yet."""

    source: Source
    meta: dict[str, Any]
    version: int
    count: int
    degree: int

    @staticmethod
    def of(source: Source) -> SogUnit:
        """Raises InputError."""
        meta = meta_of(source, META)
        with described(source):
            version = meta.get("version", 1)
            if version not in (1, 2):
                raise InputError(
                    f"{source.name}: is version {excerpt(str(version))} of .sog; 1 and 2 are read"
                )
            n = meta["count"] if version == 2 else meta["means"]["shape"][0]
            if isinstance(n, bool) or not isinstance(n, int) or not 0 <= n < 2**31:
                raise InputError(f"{source.name}: a count of {excerpt(str(n))} splats: it is damaged")
            check_expansion(source.name, BYTES * n, source.held)
            shn = meta.get("shN") or None
            degree = _palette_degree(source, shn, version) if shn else 0
            return SogUnit(source=source, meta=meta, version=version, count=n, degree=degree)

    @property
    def comments(self) -> tuple[str, ...]:
        tag = TAGS.get(str(self.meta.get("model", "")))
        if tag is None and self.meta.get("antialias") is True:
            tag = TAGS["antialiased"]
        return (tag,) if tag else ()

    def decode(self, arrays: dict[str, np.ndarray], progress: Progress) -> None:
        """Fills arrays of `Gaussians` of its count; SH bands above its own become zeros. Raises InputError
        and Cancelled."""
        with described(self.source):
            _decode(self, arrays, progress)


BYTES = 20
"""Of a splat's texels, of which files hold fewer."""


class _Pictures:
    """The pictures of a scene of n splats, as rows of texels."""

    def __init__(self, source: Source, n: int) -> None:
        self.source, self._n = source, n

    def texels(self, name: Any) -> np.ndarray:
        """(N, 4) uint8, one per splat. Raises InputError."""
        return self.pixels(name, self._n).reshape(-1, 4)[: self._n]

    def pixels(self, name: Any, least: int) -> np.ndarray:
        """(H, W, 4) uint8, of at least so many texels and at most some rows more. Raises InputError."""
        from webp import WebPColorMode, WebPData, WebPDecoderConfig, WebPError

        source, data = self.source, _webp_of(self.source, name)
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
            # Pillow takes half as long again, and one at a time: it does not let other threads run meanwhile.
            content = WebPData.from_buffer(data)
            config = WebPDecoderConfig.new()
            config.read_features(content)
            if (config.input.width, config.input.height) != (width, height):
                raise WebPError("its size is not what it says")
            return content.decode(WebPColorMode.RGBA)  # pyright: ignore[reportArgumentType]
        except WebPError as error:
            raise InputError(
                f"{source.name}: {name} is no WebP that can be read ({error}); export it again"
            ) from None


def _webp_of(source: Source, name: Any) -> bytes:
    """A picture's file. Raises InputError."""
    # A WebP is packed already: a zip makes it no smaller.
    return source.read(name, 2 * source.held + MAX_META_BYTES)


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


def _decode(unit: SogUnit, arrays: dict[str, np.ndarray], progress: Progress) -> None:
    from splatview.scene.compiling import run, threads_for
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.decoding import decode_sog

    meta, version, n = unit.meta, unit.version, unit.count
    pictures, columns = _Pictures(unit.source, n), 3 * (arrays["sh"].shape[1] - 1)
    names = [*_names(meta["means"], 2), *(_names(meta[entry], 1)[0] for entry in ("quats", "scales", "sh0"))]
    shn = meta.get("shN") or None
    if shn:
        names.append(_names(shn, 2)[1])

    def texels_of(name: Any) -> np.ndarray:
        progress.check()
        return pictures.texels(name)

    # The palette takes the longest.
    tasks = [partial(_palette, pictures, shn, version, unit.degree, columns)] if shn else []
    tasks += [partial(texels_of, name) for name in names]
    made = run(lambda task: task(), [(task,) for task in tasks], (), threads_for(BYTES * n))
    palette = made.pop(0) if shn else np.zeros((1, columns), np.float32)
    texels = made if shn else [*made, made[0]]
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
    over_splats(
        decode_sog,
        n,
        tuple(texels),
        palette,
        (means, QUAT_LEVELS, log_scales, colours, logits),
        rows_of(arrays),
        progress=progress.part(0.7, 1.0),
    )


QUAT_LEVELS = (np.arange(256, dtype=np.float32) * np.float32(2 / 255) - 1) * SQRT_HALF
"""Component of a quaternion for each byte."""


def _levels(entry: dict[str, Any], count: int) -> np.ndarray:
    """(count, 256) float32: what the bytes of each channel mean in version 1."""
    low, high = (_numbers(entry[end], count)[:, None] for end in ("mins", "maxs"))
    return _between(low, high, np.arange(256)[None], 255).astype(np.float32)


def _palette_degree(source: Source, shn: dict[str, Any], version: int) -> int:
    """SH degree of a palette. Raises InputError, KeyError and ValueError."""
    if version == 2:
        degree = int(shn["bands"])
        if not 1 <= degree <= 3:
            raise InputError(f"{source.name}: SH degree {degree}; there are 1 to 3: it is damaged")
        return degree
    width = _size_of_webp(_webp_of(source, _names(shn, 2)[0]))[0]
    if width % PALETTE_COLUMNS or width // PALETTE_COLUMNS + 1 not in SH_COEFFICIENTS[1:]:
        raise InputError(f"{source.name}: a palette {width} texels wide makes no SH bands")
    return SH_COEFFICIENTS.index(width // PALETTE_COLUMNS + 1)


def _palette(pictures: _Pictures, shn: dict[str, Any], version: int, degree: int, columns: int) -> np.ndarray:
    """(entries + 1, columns) float32: the bands above the constant one, for each label, and zeros where there
    are more `columns`. The last is zeros, for labels that are none. Raises InputError, KeyError and
    ValueError."""
    most = int(shn["count"]) if version == 2 else 2**16
    if not 0 < most <= 2**16:
        raise InputError(f"{pictures.source.name}: a palette of {most:,} entries: it is damaged")
    per_channel = SH_COEFFICIENTS[degree] - 1
    # Version 1 does not say how many there are.
    rows = -(-most // PALETTE_COLUMNS) if version == 2 else 1
    pixels = pictures.pixels(_names(shn, 2)[0], rows * PALETTE_COLUMNS * per_channel)
    if pixels.shape[1] != PALETTE_COLUMNS * per_channel:
        raise InputError(f"{pictures.source.name}: a palette {pixels.shape[1]} texels wide makes no SH bands")
    if version == 2:
        levels = _codebook(shn)
    else:
        low, high = float(shn["mins"]), float(shn["maxs"])
        levels = (low + (high - low) * (np.arange(256) / np.float32(255))).astype(np.float32)
    # The coefficients of an entry lie side by side, and so do PALETTE_COLUMNS entries.
    rows = pixels[..., :3].reshape(len(pixels) * PALETTE_COLUMNS, 3 * per_channel)[:most]
    palette = np.zeros((len(rows) + 1, columns), np.float32)
    for start in range(0, len(rows), PALETTE_ROWS):
        part = rows[start : start + PALETTE_ROWS]
        palette[start : start + len(part), : part.shape[1]] = levels[part]
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
