"""Columns of a .ply element into arrays, in pieces, so that no second copy of the file is ever held."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .excerpt import excerpt
from .ply_header import Element, Header
from .ply_rows import AsciiRows, BinaryRows
from .progress import Watch


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
