"""Rows of a .ply body in pieces of bounded size, binary or ascii, with list properties left out.

The file is read with plain `readinto` rather than mapped: a mapped file that another program cuts
short kills the process (SIGBUS), and 500,000 splats take the same time either way (34 and 35 ms, medians of
15 in turn).
"""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np

from ..errors import InputError
from .excerpt import excerpt
from .ply_header import Element
from .progress import Watch

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
