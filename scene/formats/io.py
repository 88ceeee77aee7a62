"""What all formats need of files: written wholly or not at all, opened, locked, quoted."""

from __future__ import annotations

import contextlib
import glob
import io
import json
import math
import os
import re
import secrets
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, BinaryIO

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from PIL import Image

IMAGE_FORMATS = ("JPEG", "PNG", "WEBP", "TIFF", "BMP", "PPM", "GIF", "JPEG2000", "AVIF", "TGA")
"""Pictures that are read, by Pillow's names and whatever a file is called. Left to itself Pillow starts
Ghostscript on PostScript."""


def open_image(path: Path) -> Image.Image:
    """A picture of `IMAGE_FORMATS`, its pixels not yet decoded. Raises whatever Pillow raises, and InputError
    for what is no file."""
    from PIL import Image

    require_regular_file(path)
    return Image.open(path, formats=IMAGE_FORMATS)


def target_of(path: Path) -> Path:
    """The file behind all links that is written for `path`.

    Raises:
        InputError: there can be none: its folder is missing or out of reach, or something else is there.
    """
    target = Path(os.path.realpath(path))
    try:
        mode = target.stat().st_mode
        if stat.S_ISDIR(mode):
            raise InputError(f"{path}: is a folder; name a file in it")
        if not stat.S_ISREG(mode):
            raise InputError(f"{path}: is a device or a pipe, not a file; name a file")
    except FileNotFoundError:
        if not os.path.isdir(target.parent):
            raise InputError(f"{path}: the folder {target.parent} does not exist; make it first") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{path}: the folder {target.parent} cannot be written to")
    return target


@contextmanager
def atomic_write(path: Path) -> Iterator[BinaryIO]:
    """A file to write to that takes the name `path` when the block ends well, and vanishes when it does not.

    The bytes are on the disk (fsync) before the name changes, so that a kill or a power cut at any moment
    leaves the old file or the new one. A link stays a link: the file that it leads to is replaced. What a
    kill left beside it of an earlier write is removed.

    Raises:
        InputError: the operating system refuses, be it the folder's permissions or a full disk.
    """
    target = target_of(path)
    try:
        # In the same folder, for a rename between file systems would be a copy.
        name = target.name if len(os.fsencode(target.name)) <= 200 else target.name[:50]
        _remove_leftovers(target.parent, f".{name}.")
        temporary = target.parent / f".{name}.{secrets.token_hex(4)}.tmp"
        try:
            with open(temporary, "xb") as file:
                _mark_as_ours(file)
                yield file
                file.flush()
                os.fsync(file.fileno())
                if target.exists():
                    temporary.chmod(target.stat().st_mode & 0o777)
                if os.name == "posix":  # while it is locked
                    temporary.replace(target)
            if os.name != "posix":  # which rename no open files
                temporary.replace(target)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
        sync_folder(target.parent)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from None


LOCKED_WITHIN = 1.0
"""Seconds after which a file that is being written has been locked."""


def _mark_as_ours(file: BinaryIO) -> None:
    """Locks a file that is being written, where the file system can: no other process takes it for a
    leftover."""
    with contextlib.suppress(OSError):
        take_lock(file)


def _remove_leftovers(folder: Path, prefix: str) -> None:
    """Removes files of writes that were killed: those that no living process has locked, or is about to."""
    for leftover in folder.glob(f"{glob.escape(prefix)}*.tmp"):
        with contextlib.suppress(OSError):
            with open(leftover, "r+b") as file:
                free = take_lock(file) and time.time() - os.fstat(file.fileno()).st_mtime > LOCKED_WITHIN
            if free:
                leftover.unlink()


def sync_folder(folder: Path) -> None:
    """Makes the new name last. Windows cannot open folders, and does so itself."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


@contextmanager
def open_regular(path: Path, *, folder: str = "is a folder, not a file") -> Iterator[io.BufferedReader]:
    """The file at `path`, open to read. Whatever the system refuses within the block is an InputError, as are
    folders, devices and pipes, which may never end; `folder` is what to say about those."""
    try:
        with open(path, "rb", opener=_open_regular) as file:
            yield file
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: {folder}") from None
    except PermissionError:
        raise InputError(f"{path}: may not be read; check its permissions") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    except MemoryError:
        raise InputError(f"{path}: does not fit in this machine's memory") from None


def require_regular_file(path: Path) -> None:
    """Raises InputError where `open_regular` would."""
    with open_regular(path):
        pass


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


def excerpt(text: str) -> str:
    """`text` quoted on one line, cut where long: for messages about files that may hold anything."""
    return ascii(text if len(text) <= 60 else text[:57] + "...")


MAX_JSON_BYTES = 1 << 26
"""A camera takes some 500 bytes: this is a hundred thousand. Python's objects take up to 30 times the text:
with a larger limit a damaged file could take all memory."""


def read_json(path: Path, *, what: str, progress: Progress = NO_PROGRESS) -> Any:
    """The content of `path`. Raises InputError and Cancelled; `what` says what the file should have been."""
    with open_regular(path) as file:
        text = file.read(MAX_JSON_BYTES + 1)
    if len(text) > MAX_JSON_BYTES:
        raise InputError(f"{path}: is too large for a {what}")
    try:
        return _parsed(text, progress)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is no {what}: not JSON ({error})") from None


_SPACE = re.compile(r"[ \t\n\r]*")


def _parsed(data: bytes, progress: Progress) -> Any:
    """As json.loads, but a list entry by entry: one call for all would hold up every other thread."""
    text = data.decode(json.detect_encoding(data), "surrogatepass")
    after = lambda place: _SPACE.match(text, place).end()  # noqa: E731 # pyright: ignore
    place, entries, decoder = after(0), [], json.JSONDecoder()
    if text[place : place + 1] != "[":
        return json.loads(text)
    while text[place : place + 1] == ("," if entries else "["):
        progress.step(place / len(text))
        try:
            entry, place = decoder.raw_decode(text, after(place + 1))
        except ValueError:
            break
        entries.append(entry)
        place = after(place)
    # What is empty or wrong json.loads knows best.
    return entries if entries and text[place:].rstrip(" \t\n\r") == "]" else json.loads(text)


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


def physical_memory() -> float:
    """Bytes of this machine, or of the container that it is; infinite where the system does not tell."""
    size = math.inf
    with contextlib.suppress(AttributeError, ValueError, OSError):
        size = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    with contextlib.suppress(ValueError, OSError):
        size = min(size, int(Path("/sys/fs/cgroup/memory.max").read_text()))
    return size


def resident_memory() -> int | None:
    """Bytes of memory that this process has taken; None where it cannot be told without more libraries."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except (OSError, ValueError, IndexError):
        return None
    return pages * os.sysconf("SC_PAGE_SIZE")
