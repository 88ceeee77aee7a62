"""Columns of a .ply element into arrays, in pieces, so that no second copy of the file is ever held."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.io import Watch, excerpt
from splatview.scene.formats.ply_header import Element, Header

# ---- Rows of a .ply body in pieces of bounded size, binary or ascii, with list properties left out.
#
# The file is read with plain `readinto` rather than mapped: a mapped file that another program cuts
# short kills the process (SIGBUS), and 500,000 splats take the same time either way (34 and 35 ms, medians of
# 15 in turn).


CHUNK_BYTES = 1 << 20
"""Read at once: small enough for a second-level cache and for a cancel within milliseconds."""

MAX_LINE_BYTES = 1 << 22
"""Of an ascii body; a row of a splat has some 600."""

TEXT_CHUNK_BYTES = 1 << 18
"""Parsed at once: text takes ten times as long as binary."""

WALK_ROWS = 4096
"""Rows with lists taken at once."""


class BinaryRows:
    """Walks a binary body from where `file` stands."""

    def __init__(self, file: io.BufferedReader, file_bytes: int, path: object, watch: Watch) -> None:
        self._file, self._file_bytes, self._path, self._watch = file, file_bytes, path, watch

    def skip(self, element: Element) -> None:
        """Goes behind all rows of `element`."""
        if not element.has_lists:
            self._file.seek(element.count * element.min_row_bytes, io.SEEK_CUR)
            return
        for _ in self._walk(element):
            pass

    def blocks(self, element: Element) -> Iterator[np.ndarray]:
        """(rows, bytes of the scalars) uint8 pieces of `element`; each is overwritten by the next."""
        if element.has_lists:
            yield from self._walk(element)
            return
        row_bytes = element.min_row_bytes
        chunk = max(1, min(CHUNK_BYTES // row_bytes, element.count))
        buffer = np.empty((chunk, row_bytes), dtype=np.uint8)
        for start in range(0, element.count, chunk):
            block = buffer[: min(chunk, element.count - start)]
            if self._file.readinto(block.reshape(-1).data) < block.size:
                raise self._ended(element)
            yield block

    def _walk(self, element: Element) -> Iterator[np.ndarray]:
        """`blocks` of an element whose rows are of different lengths: one by one."""
        for start in range(0, element.count, WALK_ROWS):
            rows = min(WALK_ROWS, element.count - start)
            packed = b"".join(self._row(element) for _ in range(rows))
            # Who skips has no progress to tell, but must hear a cancel.
            self._watch.check()
            yield np.frombuffer(packed, dtype=np.uint8).reshape(rows, -1).copy()

    def _row(self, element: Element) -> bytes:
        """The scalars of the next row."""
        scalars = []
        for prop in element.properties:
            raw = self._read(prop.min_bytes, element)
            if prop.count_dtype is None:
                scalars.append(raw)
                continue
            items = int(np.frombuffer(raw, dtype=prop.count_dtype)[0])
            if not 0 <= items * prop.dtype.itemsize <= self._file_bytes:
                raise InputError(
                    f"{self._path}: a list {excerpt(prop.name)} claims {items:,} items, more than the file "
                    "holds; the file is damaged"
                )
            self._read(items * prop.dtype.itemsize, element)
        return b"".join(scalars)

    def _read(self, size: int, element: Element) -> bytes:
        raw = self._file.read(size)
        if len(raw) < size:
            raise self._ended(element)
        return raw

    def _ended(self, element: Element) -> InputError:
        return InputError(
            f"{self._path}: the file ends within the {element.count:,} rows of {element.name} that its "
            "header promises; it is truncated, or was cut while it was read"
        )


class AsciiRows:
    """Walks an ascii body from where `file` stands: a row a line, blank lines left out."""

    def __init__(self, file: io.BufferedReader, file_bytes: int, path: object, watch: Watch) -> None:
        self._file, self._path, self._watch = file, path, watch

    def skip(self, element: Element) -> None:
        """Goes behind all rows of `element`."""
        # A row without a value is an empty line, and those do not count.
        for start in range(0, element.count if element.properties else 0, WALK_ROWS):
            self._lines(element, min(WALK_ROWS, element.count - start))
            self._watch.check()

    def blocks(self, element: Element) -> Iterator[np.ndarray]:
        """(rows, scalars) float64 pieces of `element`."""
        columns = len(element.scalars)
        # Some 12 characters a value.
        chunk = max(1, TEXT_CHUNK_BYTES // (12 * len(element.properties)))
        for start in range(0, element.count, chunk):
            lines = self._lines(element, min(chunk, element.count - start))
            if element.has_lists:
                lines = [self._without_lists(element, line) for line in lines]
            try:
                block = np.loadtxt(lines, dtype=np.float64, comments=None, ndmin=2)
            except ValueError:
                block = np.empty((0, 0))
            if block.shape != (len(lines), columns):
                raise InputError(
                    f"{self._path}: rows {start:,} to {start + len(lines) - 1:,} of {element.name} are not "
                    f"{columns} numbers each; the file is damaged"
                )
            yield block

    def _lines(self, element: Element, count: int) -> list[str]:
        lines, blank = [], 0
        while len(lines) < count:
            line = self._file.readline(MAX_LINE_BYTES)
            if not line:
                raise InputError(
                    f"{self._path}: the file ends within the {element.count:,} rows of {element.name} that "
                    "its header promises; it is truncated"
                )
            if len(line) == MAX_LINE_BYTES:
                raise InputError(f"{self._path}: a line of {element.name} is endless; the file is damaged")
            if line.strip():
                lines.append(line.decode("latin-1"))
                continue
            blank += 1
            if blank % WALK_ROWS == 0:
                self._watch.check()
        return lines

    def _without_lists(self, element: Element, line: str) -> str:
        words = iter(line.split())
        try:
            scalars = []
            for prop in element.properties:
                if prop.count_dtype is None:
                    scalars.append(next(words))
                else:
                    for _ in range(int(next(words))):
                        next(words)
        except (StopIteration, ValueError):
            raise InputError(
                f"{self._path}: a row of {element.name} is {excerpt(line.strip())}, not what its header "
                "promises; the file is damaged"
            ) from None
        return " ".join(scalars)


@dataclass(frozen=True, eq=False, kw_only=True)
class Target:
    """Columns of an element that belong in one array."""

    columns: Sequence[int]
    """Which of the element's scalar properties; as many as a row of `array` has values."""
    array: np.ndarray
    """(N, ...) C-contiguous, in the machine's byte order; values are cast to its dtype."""

    def rows(self, start: int, stop: int) -> np.ndarray:
        """(stop - start, columns): a view to write to."""
        return self.array[start:stop].reshape(stop - start, len(self.columns))


def check_size(header: Header, element: Element, file_bytes: int, path: object) -> None:
    """Raises InputError where a file is shorter than its header says, or larger than memory.

    To be called before memory is taken.
    """
    left = file_bytes - header.body_offset
    for earlier in header.elements:
        # In ascii every value has at least one digit and the blank or line end behind it (the last may not).
        row_bytes = 2 * len(earlier.properties) if header.is_ascii else earlier.min_row_bytes
        if earlier.count * row_bytes > left + header.is_ascii:
            raise InputError(
                f"{path}: the header promises {earlier.count:,} rows of {earlier.name}, but the file holds "
                f"{max(left, 0) // row_bytes:,} at most: it is truncated or damaged; copy or export it again"
            )
        if earlier is element:
            break
        left -= earlier.count * row_bytes

    # Files can be larger than memory, on purpose (sparse ones) or not.
    needed = element.count * sum(prop.dtype.itemsize for prop in element.scalars)
    if needed > physical_memory():
        raise InputError(
            f"{path}: {element.count:,} rows of {element.name} need {needed / 2**30:.1f} GiB, and this "
            f"machine has {physical_memory() / 2**30:.1f} GiB; thin the scene out elsewhere first"
        )


def physical_memory() -> float:
    """Bytes of this machine; infinite where the system does not tell."""
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return math.inf


def read_rows(
    file: io.BufferedReader,
    file_bytes: int,
    header: Header,
    element: Element,
    targets: Sequence[Target],
    path: object,
    watch: Watch,
) -> None:
    """Fills `targets` from the rows of `element`; `file` stands at the start of the body.

    Raises:
        InputError: the file ends too early, or a row is not what the header says.
        LoadCancelled: see `Watch`.
    """
    source = (AsciiRows if header.is_ascii else BinaryRows)(file, file_bytes, path, watch)
    for earlier in header.elements:
        if earlier is element:
            break
        source.skip(earlier)
    start = 0
    for block in source.blocks(element):
        stop = start + len(block)
        if header.is_ascii:
            _cast(block, element, targets, start, stop, path)
        else:
            _unpack(block, element, targets, start, stop)
        start = stop
        watch.step(start / element.count)


def _unpack(block: np.ndarray, element: Element, targets: Sequence[Target], start: int, stop: int) -> None:
    """Rows of every target from `block` (rows, bytes) uint8, which may be overwritten."""
    dtypes = {prop.dtype for prop in element.scalars}
    uniform = None
    if len(dtypes) == 1:
        # Every column of one type, as in nearly all splat files: one gather a target.
        dtype = dtypes.pop()
        uniform = block.view(dtype)
        if not dtype.isnative:
            uniform = uniform.byteswap(inplace=True).view(dtype.newbyteorder("="))
    offsets = np.cumsum([0, *(prop.dtype.itemsize for prop in element.scalars)])
    for target in targets:
        rows = target.rows(start, stop)
        if uniform is not None and uniform.dtype == rows.dtype:
            # With mode="clip" numpy writes to `out` itself, not to a copy first.
            np.take(uniform, target.columns, axis=1, out=rows, mode="clip")
            continue
        for i, column in enumerate(target.columns):
            if uniform is not None:
                values = uniform[:, column]
            else:
                dtype = element.scalars[column].dtype
                values = np.ndarray(len(block), dtype, block, offsets[column], block.strides[:1])
            with np.errstate(over="ignore", invalid="ignore"):
                rows[:, i] = values


def _cast(
    block: np.ndarray, element: Element, targets: Sequence[Target], start: int, stop: int, path: object
) -> None:
    """Rows of every target from `block` (rows, scalars) float64."""
    for target in targets:
        rows = target.rows(start, stop)
        values = block[:, target.columns]
        if rows.dtype.kind in "iu":
            limits = np.iinfo(rows.dtype)
            fits = (values >= limits.min) & (values <= limits.max) & (values == np.floor(values))
            if not fits.all():
                prop = element.scalars[target.columns[0]]
                raise InputError(
                    f"{path}: a value of {excerpt(prop.name)} is no {rows.dtype.name}; the file is damaged"
                )
        with np.errstate(over="ignore", invalid="ignore"):
            rows[:] = values
