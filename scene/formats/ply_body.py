"""Columns of a .ply element into arrays, in pieces, so that no second copy of the file is ever held.

plyfile reads rows with lists, piece by piece. Rows without lists are read by numpy: plyfile makes a Python
object of every value, or maps the file, and a mapped file that another program cuts short kills the process
(SIGBUS).
"""

from __future__ import annotations

import io
import math
import os
import re
import threading
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from plyfile import PlyElement, PlyListProperty, PlyParseError, PlyProperty

from splatview.scene.errors import InputError, bytes_in_words
from splatview.scene.formats.io import excerpt, physical_memory
from splatview.scene.formats.ply_header import Header, scalar_types
from splatview.scene.progress import Progress

CHUNK_BYTES = 1 << 20
"""Read at once: small enough for a second-level cache and for a cancel within milliseconds."""

MAX_LINE_BYTES = 1 << 22
"""Bytes of a line of an ascii body; a row of a splat has some 600."""

TEXT_CHUNK_BYTES = 1 << 18
"""Parsed at once: text takes ten times as long as binary."""

WALK = 4096
"""Values of rows with lists, and lines of text, between two questions whether to go on."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """Columns of an element that belong in one array."""

    names: Sequence[str]
    """Scalar properties of the element; as many as a row of `array` has values."""
    array: np.ndarray
    """(N, ...) C-contiguous, in the machine's byte order; values are cast to its dtype."""

    def rows(self, start: int, stop: int) -> np.ndarray:
        """(stop - start, names): a view to write to."""
        return self.array[start:stop].reshape(stop - start, len(self.names))


def _min_row_bytes(element: PlyElement) -> int:
    """Bytes of a binary row; where it has lists, of a row whose lists are empty."""
    return sum(
        np.dtype(prop.len_dtype if isinstance(prop, PlyListProperty) else prop.val_dtype).itemsize
        for prop in element.properties
    )


def free_memory() -> int:
    """Bytes that programs can take before the machine swaps: half of all where the system does not tell,
    and 4 GiB where it does not even tell that."""
    try:
        found = re.search(r"^MemAvailable: *(\d+) kB", Path("/proc/meminfo").read_text(), re.MULTILINE)
    except OSError:
        found = None
    size = physical_memory()
    return min(int(found[1]) << 10, int(size)) if found else int(min(size / 2, 4 << 30))


SPLAT_BYTES = 56
"""Of a splat in memory at least: what a point cloud stores becomes more."""


class PlyBody:
    """Rows behind a header, read from where `file` stands. plyfile reads from it as from a stream."""

    def __init__(
        self,
        file: io.BufferedReader,
        header: Header,
        path: Path,
        progress: Progress,
        room: float = math.inf,
    ) -> None:
        """`room`: bytes of memory that the splats may take."""
        self.header, self.path = header, path
        self._room = min(room, physical_memory())
        self._file, self._file_bytes = file, os.fstat(file.fileno()).st_size
        self._progress = progress
        self._lock = threading.Lock()
        """Of the place where `file` stands."""
        self._lines = 0
        self._passed: set[str] = set()
        """Elements that the file stands behind."""

    def check_size(self, element: PlyElement) -> None:
        """Raises InputError where the file is shorter than its header says, or `element` larger than memory.

        To be called before memory is taken.
        """
        left, is_ascii = self._file_bytes - self.header.body_offset, self.header.is_ascii
        for earlier in self.header.elements.values():
            # In ascii every value has at least one digit and the blank or line end behind it (the last may
            # not).
            row_bytes = 2 * len(earlier.properties) if is_ascii else _min_row_bytes(earlier)
            if earlier.count * row_bytes > left + is_ascii:
                raise InputError(
                    f"{self.path}: the header promises {earlier.count:,} rows of {earlier.name}, but the "
                    f"file holds {max(left, 0) // row_bytes:,} at most: it is truncated or damaged; copy or "
                    "export it again"
                )
            if earlier is element:
                break
            left -= earlier.count * row_bytes

        # Files can be larger than memory, on purpose (sparse ones) or not.
        row = max(SPLAT_BYTES, sum(dtype.itemsize for dtype in scalar_types(element).values()))
        needed = element.count * row
        if not needed <= self._room:
            raise InputError(
                f"{self.path}: {element.count:,} rows of {element.name} need {bytes_in_words(needed)} of "
                f"memory, and there are {bytes_in_words(self._room)} for them; thin the scene out elsewhere "
                "first"
            )

    def read_rows(
        self, element: PlyElement, targets: Sequence[Target], progress: Progress | None = None
    ) -> None:
        """Fills `targets` from the rows of `element`; elements must be read in the order of the file.

        Raises:
            InputError: the file ends too early, or a row is not what the header says.
            Cancelled: nobody waits for it any more.
        """
        for earlier in self.header.elements.values():
            if earlier is element:
                break
            if earlier.name not in self._passed:
                self.skip(earlier)
            self._passed.add(earlier.name)
        self._passed.add(element.name)
        start, progress = 0, progress or self._progress
        stored = _as_stored(element, targets, self.header)
        for block in self.blocks(element) if stored is None else self._fill(stored, element):
            stop = start + len(block)
            if stored is None:
                _unpack(block, targets, start, stop, self.path)
            start = stop
            progress.step(start / element.count)

    def row_reader(
        self, element: PlyElement, names: Sequence[str], dtype: type[np.generic]
    ) -> Callable[[int, int], np.ndarray]:
        """What gives rows [start, stop) of the columns `names`, an array (stop - start, names) of `dtype`, to
        any thread: from the file, where they are the file's to the byte, else of all of them, which are read
        now. To be asked for in the order of the file, and before any rows are given.

        Raises, as what it returns does:
            InputError: the file ends too early, or a row is not what the header says.
            Cancelled: nobody waits for it any more.
        """
        offset = self._offset_of(element)
        whole = Target(names=names, array=np.empty((element.count, len(names)), dtype))
        if offset is None or _as_stored(element, [whole], self.header) is None:
            self.read_rows(element, [whole], self._progress.part(0.0, 0.0))
            return lambda start, stop: whole.array[start:stop]

        def rows(start: int, stop: int) -> np.ndarray:
            self._progress.check()
            part = np.empty((stop - start, len(names)), dtype)
            with self._lock:
                self._file.seek(offset + start * part[:1].nbytes)
                if self._file.readinto(part.data.cast("B")) < part.nbytes:
                    raise self._ended(element)
            return part

        return rows

    def _offset_of(self, element: PlyElement) -> int | None:
        """Where the rows of `element` begin; None where what lies before them has no certain size."""
        offset = self.header.body_offset
        for earlier in self.header.elements.values():
            if earlier is element:
                break
            if self.header.is_ascii or earlier.dtype().hasobject:
                return None
            offset += earlier.count * earlier.dtype().itemsize
        return offset

    def _fill(self, rows: np.ndarray, element: PlyElement) -> Iterator[np.ndarray]:
        """Fills the `rows` (N, columns) of an array that is as the file has them, and yields each piece."""
        step = max(1, CHUNK_BYTES // rows[:1].nbytes)
        for start in range(0, len(rows), step):
            part = rows[start : start + step]
            if self._file.readinto(part.data.cast("B")) < part.nbytes:
                raise self._ended(element)
            yield part

    def read(self, size: int) -> bytes:
        """Bytes of a binary body. Raises EOFError where a damaged list asks for more than any file has."""
        if not 0 <= size <= self._file_bytes:
            raise EOFError
        return self._file.read(size)

    def readline(self) -> str:
        """The next line of an ascii body that is not blank; empty at the end of the file."""
        while line := self._file.readline(MAX_LINE_BYTES):
            if len(line) == MAX_LINE_BYTES:
                raise InputError(f"{self.path}: a line of the body is endless; the file is damaged")
            self._lines += 1
            if self._lines % WALK == 0:
                self._progress.check()
            if line.strip():
                return line.decode("latin-1")
        return ""

    def skip(self, element: PlyElement) -> None:
        """Goes behind all rows of `element`."""
        dtype = element.dtype()
        if not element.properties:
            return
        if self.header.is_ascii:
            # A line a row, whatever is in it.
            if sum(1 for _ in islice(iter(self.readline, ""), element.count)) < element.count:
                raise self._ended(element)
        elif dtype.hasobject:
            for _ in self.blocks(element):
                # Who skips has no progress to tell, but must hear a cancel.
                self._progress.check()
        else:
            self._file.seek(element.count * dtype.itemsize, io.SEEK_CUR)

    def blocks(self, element: PlyElement) -> Iterator[np.ndarray]:
        """Rows of `element` as structured arrays, each overwritten by the next; of float64 in ascii."""
        is_ascii, name, properties = self.header.is_ascii, element.name, element.properties
        if is_ascii:
            # Some programs write whole numbers as 7.0.
            properties = [
                prop if isinstance(prop, PlyListProperty) else PlyProperty(prop.name, "f8")
                for prop in properties
            ]
        dtype = PlyElement(name, properties, 0).dtype(self.header.byte_order)
        if dtype.hasobject:
            chunk = WALK // len(properties)
        else:
            # Some 12 characters a value.
            chunk = TEXT_CHUNK_BYTES // (12 * len(properties)) if is_ascii else CHUNK_BYTES // dtype.itemsize
        chunk = max(1, min(chunk, element.count))
        buffer = np.empty(0 if is_ascii or dtype.hasobject else chunk, dtype)
        for start in range(0, element.count, chunk):
            count = min(chunk, element.count - start)
            try:
                if dtype.hasobject:
                    block = self._with_lists(PlyElement(name, properties, count))
                elif is_ascii:
                    lines = list(islice(iter(self.readline, ""), count))
                    if len(lines) < count:
                        raise self._ended(element)
                    block = np.loadtxt(lines, dtype, comments=None, ndmin=1)
                else:
                    block = buffer[:count]
                    if self._file.readinto(block.view(np.uint8).data) < block.nbytes:
                        raise self._ended(element)
            except InputError:
                raise
            except (PlyParseError, ValueError, OverflowError) as error:
                raise InputError(
                    f"{self.path}: rows {start:,} to {start + count - 1:,} of {name} are not what the "
                    f"header promises ({excerpt(getattr(error, 'message', str(error)))}); the file is "
                    "truncated or damaged; copy or export it again"
                ) from None
            yield block

    def _with_lists(self, piece: PlyElement) -> np.ndarray:
        """The next rows, as many as `piece` has, by plyfile."""
        if self.header.is_ascii:
            with warnings.catch_warnings():
                # plyfile has numpy warn of every empty list.
                warnings.filterwarnings("ignore", "loadtxt: input contained no data", UserWarning)
                piece._read_txt(self)
        else:
            piece._read_bin(self, self.header.byte_order)
        return piece.data

    def _ended(self, element: PlyElement) -> InputError:
        return InputError(
            f"{self.path}: the file ends within the {element.count:,} rows of {element.name} that its "
            "header promises; it is truncated, or was cut while it was read"
        )


def _as_stored(element: PlyElement, targets: Sequence[Target], header: Header) -> np.ndarray | None:
    """The rows of the only target where they are the file's to the byte, so that nothing is between them."""
    if header.is_ascii or len(targets) != 1 or not element.count:
        return None
    rows = targets[0].rows(0, element.count)
    dtype = np.dtype([(name, rows.dtype) for name in targets[0].names])
    return rows if element.dtype(header.byte_order) == dtype else None


def _unpack(block: np.ndarray, targets: Sequence[Target], start: int, stop: int, path: Path) -> None:
    """Rows of every target from `block`, a structured array, which may be overwritten."""
    columns = {name: i for i, name in enumerate(block.dtype.names or ())}
    dtypes = {block.dtype[i] for i in columns.values()}
    uniform = None
    if len(dtypes) == 1:
        # Every column of one type, as in nearly all splat files: one gather a target.
        dtype = dtypes.pop()
        uniform = block.view(dtype).reshape(len(block), -1)
        if not dtype.isnative:
            uniform = uniform.byteswap(inplace=True).view(dtype.newbyteorder("="))
            block = block.view(block.dtype.newbyteorder("="))
    for target in targets:
        rows = target.rows(start, stop)
        if uniform is not None and uniform.dtype == rows.dtype:
            at = [columns[name] for name in target.names]
            if at == list(range(at[0], at[0] + len(at))):
                rows[...] = uniform[:, at[0] : at[0] + len(at)]  # three times as fast as a gather
                continue
            # With mode="clip" numpy writes to `out` itself, not to a copy first.
            np.take(uniform, at, axis=1, out=rows, mode="clip")
            continue
        for i, name in enumerate(target.names):
            values = block[name]
            if rows.dtype.kind in "iu" and values.dtype.kind == "f":
                limits = np.iinfo(rows.dtype)
                if not ((values >= limits.min) & (values <= limits.max) & (values == np.floor(values))).all():
                    raise InputError(
                        f"{path}: a value of {excerpt(name)} is no {rows.dtype.name}; the file is damaged"
                    )
            with np.errstate(over="ignore", invalid="ignore"):
                rows[:, i] = values
