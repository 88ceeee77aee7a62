"""Splats to a binary little endian .ply that every viewer of the field opens."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..gaussians import Gaussians
from .atomic import atomic_write
from .ply_header import MAX_HEADER_BYTES, OBJ_INFO, TYPES

CHUNK_BYTES = 1 << 20
"""Put together at once; no second copy of the scene is made."""

PLY_NAMES = {
    TYPES[name]: name for name in ("char", "uchar", "short", "ushort", "int", "uint", "float", "double")
}
"""numpy's type codes to the names that the oldest readers know."""

NORMALS = ("nx", "ny", "nz")


def save_ply(gaussians: Gaussians, path: Path) -> None:
    """Writes x y z, nx ny nz, f_dc, f_rest, opacity, scale, rot, then the extras; comments in the header.

    Normals are zeros unless the extras have them. float64 means are written as doubles.

    Raises:
        InputError: an extra has a name or type that .ply cannot hold, or the file cannot be written.
    """
    columns = _columns(gaussians, path)
    dtype = np.dtype([(name, values.dtype.newbyteorder("<")) for name, values in columns.items()])
    n = len(gaussians)
    chunk = max(1, CHUNK_BYTES // dtype.itemsize)
    header = _header(gaussians, dtype).encode("utf-8", "replace")
    if len(header) > MAX_HEADER_BYTES:
        raise InputError(
            f"{path}: cannot be written: comments of {len(header):,} bytes make no readable header"
        )
    with atomic_write(path) as file:
        file.write(header)
        for start in range(0, n, chunk):
            stop = min(start + chunk, n)
            rows = np.empty(stop - start, dtype=dtype)
            for name, values in columns.items():
                rows[name] = values[start:stop]
            file.write(rows.data)


def _columns(gaussians: Gaussians, path: Path) -> dict[str, np.ndarray]:
    """Property name -> values (N,), in the order of the file."""
    zeros = np.broadcast_to(np.float32(0), (len(gaussians),))
    extras = dict(gaussians.extras)
    columns = {name: gaussians.means[:, i] for i, name in enumerate("xyz")}
    columns |= {name: extras.pop(name, zeros) for name in NORMALS}
    columns |= {f"f_dc_{c}": gaussians.sh[:, 0, c] for c in range(3)}
    rest = gaussians.sh[:, 1:].shape[1]
    columns |= {f"f_rest_{c * rest + k}": gaussians.sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns["opacity"] = gaussians.opacity_logits
    columns |= {f"scale_{i}": gaussians.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": gaussians.quats[:, i] for i in range(4)}
    for name, values in extras.items():
        if name in columns or name.startswith("f_rest_"):
            raise InputError(
                f"{path}: cannot be written: the extra property {name!r} has the name of a splat's own"
            )
        if name.split() != [name] or not name.isascii() or not name.isprintable():
            raise InputError(
                f"{path}: cannot be written: {name!r} is no name for a .ply property (one ASCII word)"
            )
        columns[name] = values
    for name, values in columns.items():
        if values.dtype.str[1:] not in PLY_NAMES:
            raise InputError(
                f"{path}: cannot be written: .ply has no type {values.dtype} (property {name}); "
                "give it as float32, float64 or an integer of at most 32 bits"
            )
    return columns


def _header(gaussians: Gaussians, dtype: np.dtype) -> str:
    lines = ["ply", "format binary_little_endian 1.0"]
    for comment in gaussians.comments:
        # A comment may not bring in header lines of its own.
        for line in re.split(r"[\r\n]+", comment):
            if line.startswith(OBJ_INFO):
                lines.append(line)
            else:
                lines.append(f"comment {line}".rstrip())
    lines.append(f"element vertex {len(gaussians)}")
    lines += [f"property {PLY_NAMES[dtype[name].str[1:]]} {name}" for name in dtype.names or ()]
    return "\n".join([*lines, "end_header", ""])
