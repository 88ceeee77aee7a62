"""Files that are something else: recognised by their first bytes, and refused with what to do."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from ..errors import InputError
from .ply_header import Header

CONVERT = "convert it to an uncompressed .ply, with `splat-transform IN OUT.ply` or in SuperSplat"

MAGICS = (
    (b"\x1f\x8b", "an .spz file"),
    (b"NGSP", "an .spz file"),
    (b"PK\x03\x04", "an .sog file (or another zip)"),
)

SUFFIXES = {
    ".spz": "an .spz file",
    ".sog": "an .sog file",
    ".splat": "a .splat file",
    ".ksplat": "a .ksplat file",
}

PICTURES = (b"\x89PNG", b"\xff\xd8\xff", b"RIFF", b"GIF8")


def refuse_other_format(file: BinaryIO, path: Path) -> None:
    """Raises InputError unless the file begins as a .ply does; leaves `file` at its start."""
    start = file.read(8)
    file.seek(0)
    if start[:3] == b"ply" and start[3:].lstrip(b" \t").startswith((b"\n", b"\r\n")):
        return
    kind = next((kind for magic, kind in MAGICS if start.startswith(magic)), None)
    kind = kind or SUFFIXES.get(path.suffix.lower())
    if kind:
        raise InputError(f"{path}: {kind} is not supported yet; {CONVERT}")
    if start.startswith(PICTURES):
        raise InputError(f"{path}: is a picture, not a scene; give a .ply file")
    raise InputError(f"{path}: is not a .ply file (it does not begin with the line 'ply')")


def refuse_other_ply(header: Header, path: Path) -> None:
    """Raises InputError where the header is that of a mesh or of a compressed scene."""
    vertex = header.element("vertex")
    names = {prop.name for prop in vertex.properties} if vertex else set()
    if "packed_position" in names:
        raise InputError(f"{path}: a compressed .ply is not supported yet; {CONVERT}")
    if "opacity" in names or "f_dc_0" in names:
        return
    for element in header.elements:
        if element.name in ("face", "tristrips") and element.count > 0:
            raise InputError(
                f"{path}: is a mesh ({element.count:,} rows of {element.name}), not a splat scene; sample "
                "points on it, or train splats from pictures of it"
            )
