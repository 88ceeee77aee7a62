"""The text that begins a .ply: what the file says it holds. Bounded, whatever the file is.

Format: Turk 1994, "The PLY Polygon File Format".
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.io import excerpt

MAX_HEADER_BYTES = 1 << 20
"""Headers are a few KiB, comments included; a file that goes on longer is something else."""

BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}

TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}

OBJ_INFO = "obj_info "
"""Comments that begin so were (and are written as) lines of that keyword."""


@dataclass(frozen=True, kw_only=True)
class Property:
    """One property of an element."""

    name: str
    dtype: np.dtype
    """In the file's byte order; of one item where the property is a list."""
    count_dtype: np.dtype | None = None
    """Type of the length in front of a list; None: a scalar."""

    @property
    def min_bytes(self) -> int:
        """Bytes in a binary row; for a list those of its length alone."""
        return (self.count_dtype or self.dtype).itemsize


@dataclass(frozen=True, kw_only=True)
class Element:
    """A table of the file."""

    name: str
    count: int
    properties: tuple[Property, ...]

    @property
    def scalars(self) -> tuple[Property, ...]:
        """The properties that are no lists: the columns that can be read."""
        return tuple(prop for prop in self.properties if prop.count_dtype is None)

    @property
    def has_lists(self) -> bool:
        return len(self.scalars) < len(self.properties)

    @property
    def min_row_bytes(self) -> int:
        """Bytes of a binary row; where it has lists, of a row whose lists are empty."""
        return sum(prop.min_bytes for prop in self.properties)


@dataclass(frozen=True, kw_only=True)
class Header:
    """All that comes before the body."""

    is_ascii: bool
    elements: tuple[Element, ...]
    comments: tuple[str, ...]
    """Without the word ``comment``; lines of ``obj_info`` begin with that word."""
    body_offset: int
    """Bytes from the start of the file."""

    def element(self, name: str) -> Element | None:
        return next((element for element in self.elements if element.name == name), None)


def read_header(file: BinaryIO, path: object) -> Header:
    """Reads from the start of `file` to just behind ``end_header``. `path` is for messages only.

    Raises:
        InputError: it is no .ply header; the message names the line.
    """
    lines = _header_lines(file, path)
    body_offset = file.tell()
    byte_order = is_ascii = None
    elements: list[tuple[str, int, list[Property]]] = []
    comments: list[str] = []
    for number, line in enumerate(lines, start=1):
        words = line.split()

        def fail(what: str, number: int = number, line: str = line) -> InputError:
            return InputError(f"{path}: header line {number} ({excerpt(line)}) {what}")

        match words:
            case []:
                continue
            case ["comment", *_]:
                comments.append(line.strip()[len("comment") :].strip())
            case ["obj_info", *_]:
                comments.append(OBJ_INFO + line.strip()[len("obj_info") :].strip())
            case ["format", name, _version] if name in BYTE_ORDERS:
                byte_order, is_ascii = BYTE_ORDERS[name], name == "ascii"
            case ["format", *_]:
                raise fail("names no format of .ply: ascii, binary_little_endian or binary_big_endian 1.0")
            case ["element", name, count]:
                if not re.fullmatch(r"[0-9]{1,18}", count):
                    raise fail("must end in a number of rows")
                if any(name == earlier for earlier, _, _ in elements):
                    raise fail(f"is a second element {excerpt(name)}")
                elements.append((name, int(count), []))
            case ["property", *_] if not elements:
                raise fail("is a property before any element")
            case ["property", *_] if byte_order is None:
                raise fail("comes before the format line")
            case ["property", "list", count_type, item_type, name]:
                count_dtype, dtype = _dtype(count_type, byte_order), _dtype(item_type, byte_order)
                if dtype is None or count_dtype is None or count_dtype.kind not in "iu":
                    raise fail("has a type that .ply does not have")
                elements[-1][2].append(Property(name=name, dtype=dtype, count_dtype=count_dtype))
            case ["property", type_name, name] if type_name != "list":
                dtype = _dtype(type_name, byte_order)
                if dtype is None:
                    raise fail(f"has a type that .ply does not have: {excerpt(type_name)}")
                elements[-1][2].append(Property(name=name, dtype=dtype))
            case _:
                raise fail("is not understood; the file is damaged or not a .ply")
    if is_ascii is None:
        raise InputError(f"{path}: the .ply header has no format line; the file is damaged")
    return Header(
        is_ascii=is_ascii,
        elements=tuple(
            Element(name=name, count=count, properties=tuple(properties))
            for name, count, properties in elements
        ),
        comments=tuple(comments),
        body_offset=body_offset,
    )


def _dtype(type_name: str, byte_order: str | None) -> np.dtype | None:
    return np.dtype(f"{byte_order}{TYPES[type_name]}") if type_name in TYPES else None


def _header_lines(file: BinaryIO, path: object) -> list[str]:
    """The lines between ``ply`` and ``end_header``, the first of them as an empty string."""
    lines: list[str] = []
    left = MAX_HEADER_BYTES
    while left > 0:
        raw = file.readline(left)
        left -= len(raw)
        if not raw.endswith(b"\n"):
            break
        raw = raw.rstrip(b"\r\n")
        if raw.strip() == b"end_header":
            return lines
        try:
            line = raw.decode("utf-8")
        except UnicodeDecodeError:
            line = raw.decode("latin-1")
        lines.append(line if lines else "")
    if left > 0:
        raise InputError(f"{path}: the .ply header ends without end_header; the file is truncated")
    raise InputError(f"{path}: no end_header in the first {MAX_HEADER_BYTES >> 20} MiB; not a splat .ply")
