"""The text that begins a .ply: what the file says it holds. Bounded, whatever the file is.

Format: Turk 1994, "The PLY Polygon File Format". plyfile reads the declarations. Lines, comments and counts
are taken here: plyfile sets no bounds, and knows ASCII only.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from plyfile import PlyData, PlyElement, PlyHeaderParseError, PlyListProperty

from splatview.scene.errors import InputError
from splatview.scene.formats.io import excerpt

MAX_HEADER_BYTES = 1 << 20
"""Headers are a few KiB, comments included; a file that goes on longer is something else."""

OBJ_INFO = "obj_info "
"""Comments that begin so were (and are written as) lines of that keyword."""

_END = re.compile(rb"^[ \t]*end_header[ \t\r]*\n", re.MULTILINE)


@dataclass(frozen=True, kw_only=True)
class Header:
    """All that comes before the body."""

    is_ascii: bool
    byte_order: str
    """numpy's sign for it: ``<`` or ``>``, and ``=`` for ascii."""
    elements: dict[str, PlyElement]
    """Tables by name, in the order of the file; none has data yet."""
    comments: tuple[str, ...]
    """Without the word ``comment``; lines of ``obj_info`` begin with that word."""
    body_offset: int
    """Bytes from the start of the file."""


def scalar_types(element: PlyElement) -> dict[str, np.dtype]:
    """Types of the properties that are no lists, in the machine's byte order, by name."""
    return {
        prop.name: np.dtype(prop.val_dtype)
        for prop in element.properties
        if not isinstance(prop, PlyListProperty)
    }


def read_header(file: BinaryIO, path: object) -> Header:
    """Reads from the start of `file` to just behind ``end_header``. `path` is for messages only.

    Raises:
        InputError: it is no .ply header; the message names the line.
    """
    lines = _header_lines(file, path)
    declarations: list[str] = []
    comments: list[str] = []
    counts: list[int] = []
    for number, line in enumerate(lines[1:-1], start=2):
        line = line.strip()
        if re.match(r"(comment|obj_info)(\s|$)", line):
            keyword, text = line[:8].strip(), line[8:].strip()
            comments.append(OBJ_INFO + text if keyword == "obj_info" else text)
            line = ""
        line = line.encode("ascii", "backslashreplace").decode()
        words = line.split()
        if words[:1] == ["element"] and len(words) == 3:
            if not re.fullmatch(r"[0-9]{1,18}", words[2]):
                raise InputError(
                    f"{path}: header line {number} ({excerpt(line)}) must end in a number of rows; "
                    "the file is damaged"
                )
            counts.append(int(words[2]))
            # plyfile takes memory for as many rows as it is told.
            line = f"element {words[1]} 0"
        # plyfile refuses an empty line, but not a blank one.
        declarations.append(f" {line}")
    text = "\n".join(["ply", *declarations, "end_header", ""])
    try:
        declared = PlyData.read(io.BytesIO(text.encode()), mmap="")
    except PlyHeaderParseError as error:
        line = lines[int(error.line or 1) - 1].strip()
        raise InputError(
            f"{path}: header line {error.line} ({excerpt(line)}) is not understood: "
            f"{excerpt(error.message)}; the file is damaged or not a .ply"
        ) from None
    except ValueError as error:
        raise InputError(f"{path}: the header has {error}; the file is damaged") from None
    for element in declared.elements:
        for prop in element.properties:
            if isinstance(prop, PlyListProperty) and prop.len_dtype.startswith("f"):
                raise InputError(
                    f"{path}: the list {excerpt(prop.name)} has lengths of a type that .ply does not have "
                    f"for them: {np.dtype(prop.len_dtype)}; the file is damaged"
                )
    return Header(
        is_ascii=declared.text,
        byte_order=declared.byte_order,
        elements={
            element.name: PlyElement(element.name, element.properties, count)
            for element, count in zip(declared.elements, counts, strict=True)
        },
        comments=tuple(comments),
        body_offset=file.tell(),
    )


def _header_lines(file: BinaryIO, path: object) -> list[str]:
    """The lines from ``ply`` to ``end_header``; `file` stands behind them."""
    start = file.read(MAX_HEADER_BYTES)
    end = _END.search(start)
    if end is None and len(start) < MAX_HEADER_BYTES:
        raise InputError(f"{path}: the .ply header ends without end_header; the file is truncated")
    if end is None:
        raise InputError(f"{path}: no end_header in the first {MAX_HEADER_BYTES >> 20} MiB; not a splat .ply")
    file.seek(end.end())
    raw = start[: end.end() - 1]
    try:
        return raw.decode("utf-8").split("\n")
    except UnicodeDecodeError:
        return raw.decode("latin-1").split("\n")


def header_text(elements: list[PlyElement], comments: tuple[str, ...], path: object) -> bytes:
    """The header of a little-endian file of `elements`. Raises InputError where nobody could read it."""
    # plyfile takes comments of ASCII only. A comment may not bring in header lines of its own.
    lines = [line for comment in comments for line in re.split(r"[\r\n]+", comment)]
    lines = [line if line.startswith(OBJ_INFO) else f"comment {line}".rstrip() for line in lines]
    magic, form, *declarations = PlyData(elements, byte_order="<").header.split("\n")
    header = "\n".join([magic, form, *lines, *declarations, ""]).encode("utf-8", "replace")
    if len(header) > MAX_HEADER_BYTES:
        raise InputError(
            f"{path}: cannot be written: comments of {len(header):,} bytes make no readable header"
        )
    return header
