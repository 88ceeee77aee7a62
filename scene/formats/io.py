"""What all formats need of files: written wholly or not at all, opened, locked, quoted."""

from __future__ import annotations

import io
import json
import math
import os
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO

import numpy as np

from splatview.scene.errors import InputError

if TYPE_CHECKING:
    from PIL import Image

IMAGE_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP", "PPM", "GIF", "JPEG2000", "AVIF", "TGA")
"""Pictures that are read, by Pillow's names and whatever a file is called. Left to itself Pillow starts
Ghostscript on PostScript."""


def open_image(path: Path) -> Image.Image:
    """A picture of `IMAGE_FORMATS`, its pixels not yet decoded. Raises whatever Pillow raises."""
    from PIL import Image

    return Image.open(path, formats=IMAGE_FORMATS)


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A file to write to that takes the name `path` when the block ends well, and vanishes when it does not.

    The bytes are on the disk (fsync) before the name changes, so that a kill or a power cut at any moment
    leaves the old file or the new one. A link stays a link: the file that it leads to is replaced.

    Raises:
        InputError: the operating system refuses, be it the folder's permissions or a full disk.
    """
    try:
        target = path.resolve()
        if target.is_dir():
            raise InputError(f"{path}: is a folder; name a file in it")
        if target.exists() and not target.is_file():
            raise InputError(f"{path}: is a device or a pipe, not a file; name a file")
        if not target.parent.is_dir():
            raise InputError(f"{path}: the folder {target.parent} does not exist; make it first")
        # In the same folder, for a rename between file systems would be a copy.
        temporary = target.parent / f".{target.name[:100]}.{secrets.token_hex(4)}.tmp"
        try:
            with open(temporary, "xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            if target.exists():
                temporary.chmod(target.stat().st_mode & 0o777)
            temporary.replace(target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        _sync_folder(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


def _sync_folder(folder: Path) -> None:
    """Makes the new name last. Windows cannot open folders, and does so itself."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def open_scene(path: Path) -> Iterator[io.BufferedReader]:
    """The file at `path`, open to read. Whatever the system refuses within the block is an InputError."""
    try:
        with open(path, "rb", opener=_open_regular) as file:
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, not a scene; name the .ply file in it") from None
    except PermissionError:
        raise InputError(f"{path}: may not be read; check its permissions") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise InputError(f"{path}: does not fit in this machine's memory") from None


def _open_regular(name: str, flags: int) -> int:
    # Without O_NONBLOCK a named pipe would wait here for somebody to write to it.
    try:
        descriptor = os.open(name, flags | getattr(os, "O_NONBLOCK", 0))
    except PermissionError:
        if os.path.isdir(name):  # Windows opens none
            raise IsADirectoryError from None
        raise
    mode = os.fstat(descriptor).st_mode
    if not stat.S_ISREG(mode):
        os.close(descriptor)
        if stat.S_ISDIR(mode):
            raise IsADirectoryError
        raise InputError(f"{name}: is a device or a pipe, not a file")
    return descriptor


LOCKED_BYTE = 1 << 40
"""Far behind all text: where bytes are locked rather than files, the text can still be read."""


def take_lock(file: IO[bytes]) -> bool:
    """Takes the open `file` for this process until it is closed, or the process ends however it may; False
    where another has it.

    Raises:
        OSError: the file system has no locks.
    """
    if os.name == "nt":
        import msvcrt

        locking, mode = getattr(msvcrt, "locking"), getattr(msvcrt, "LK_NBLCK")  # noqa: B009
        at = file.tell()
        try:
            file.seek(LOCKED_BYTE)
            locking(file.fileno(), mode, 1)
        except OSError:
            return False
        finally:
            file.seek(at)
        return True
    import fcntl

    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


CONVERT = "convert it to an uncompressed .ply, with `splat-transform IN OUT.ply` or in SuperSplat"
"""What to do about a format that is recognised and not read."""


def excerpt(text: str) -> str:
    """`text` quoted on one line, cut where long: for messages about files that may hold anything."""
    return ascii(text if len(text) <= 60 else text[:57] + "...")


MAX_JSON_BYTES = 1 << 26
"""A camera takes some 500 bytes: this is a hundred thousand. Python's objects take up to 30 times the text:
with a larger limit a damaged file could take all memory."""


def read_json(path: Path, *, what: str) -> Any:
    """The content of `path`. Raises InputError; `what` says what the file should have been."""
    try:
        # A device or a pipe may never end: only files are opened.
        if not path.is_file():
            raise InputError(f"{path}: no such file")
        if path.stat().st_size > MAX_JSON_BYTES:
            raise InputError(f"{path}: is too large for a {what}")
        return json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is no {what}: not JSON ({error})") from None


def _value(entry: Mapping[str, Any], key: str, where: str) -> Any:
    if key not in entry:
        raise InputError(f"{where}: the key {key!r} is missing")
    return entry[key]


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def number(entry: Mapping[str, Any], key: str, where: str) -> float:
    """`entry[key]`; may be NaN or infinite, as Python's JSON. Raises InputError, as all here."""
    value = _value(entry, key, where)
    if not _is_number(value):
        raise InputError(f"{where}: {key!r} must be a number, not {excerpt(json.dumps(value))}")
    return float(value)


def integer(entry: Mapping[str, Any], key: str, where: str) -> int:
    """`entry[key]`, a count of pixels."""
    value = number(entry, key, where)
    if not (math.isfinite(value) and value == int(value)):
        raise InputError(f"{where}: {key!r} must be a whole number of pixels, not {value:g}")
    return int(value)


def array(entry: Mapping[str, Any], key: str, shape: tuple[int, ...], where: str) -> np.ndarray:
    """`entry[key]`, `shape` of one or two dimensions, float64."""
    value = _value(entry, key, where)
    rows = value if len(shape) == 2 else [value]
    count = shape[-1]
    if not (
        isinstance(rows, list)
        and len(rows) == (shape[0] if len(shape) == 2 else 1)
        and all(isinstance(row, list) and len(row) == count and all(map(_is_number, row)) for row in rows)
    ):
        size = " x ".join(map(str, shape))
        raise InputError(f"{where}: {key!r} must be {size} numbers in brackets")
    return np.array(value, dtype=np.float64)
