"""Scenes from .ksplat, the buckets of splats of GaussianSplats3D: levels 0 to 2 of compression.

A header of 4,096 bytes, one of 1,024 for each section, then the sections: sizes of buckets that are not full,
centres of buckets, rows of splats. Source: mkkellogg/GaussianSplats3D, SplatBuffer.js (MIT), read for facts.
"""

from __future__ import annotations

import io
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.packing import LOGITS, check_room, empty_arrays, scene_of, slices, too_short
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress
from splatview.scene.sh import rgb_to_sh

HEADER, SECTION = 4096, 1024

BUCKET_RANGE = 32767
"""Steps from the centre of a bucket to its sides, where a section names no other."""

SH_RANGE = 1.5
"""Largest coefficient in a byte, where the header names no other."""


@dataclass(frozen=True, kw_only=True)
class _Section:
    count: int
    room: int
    """Rows that the section has space for."""
    capacity: int
    """Splats of a full bucket."""
    buckets: int
    side: float
    """Of a bucket, world units."""
    bucket_bytes: int
    steps: int
    full: int
    """Buckets that are full; the others tell their sizes."""
    partial: int
    degree: int


def is_ksplat(start: bytes) -> bool:
    """Whether a file may be one: version 0.1 and later, which no text begins with."""
    return len(start) >= 8 and start[0] == 0 and 1 <= start[1] < 16 and start[2:4] == b"\0\0"


def read_ksplat(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats of all sections. Raises InputError and Cancelled."""
    size = os.fstat(file.fileno()).st_size
    header = file.read(HEADER)
    if len(header) < HEADER:
        raise too_short(path, "its header does")
    sections, total, level = *struct.unpack_from("<I", header, 4), *struct.unpack_from("<IH", header, 16)
    low, high = struct.unpack_from("<2f", header, 36)
    if not (abs(low) < 1e6 and abs(high) < 1e6):
        raise InputError(f"{path}: SH from {low:g} to {high:g}: the file is damaged")
    sh_range = (low or -SH_RANGE, high or SH_RANGE)
    if level > 2:
        raise InputError(f"{path}: is of compression level {level}; 0, 1 and 2 are read")
    if sections > (size - HEADER) // SECTION:
        raise too_short(path, f"the headers of its {sections:,} sections")
    headers = [_section(file.read(SECTION), path) for _ in range(sections)]
    count, degree = sum(one.count for one in headers), max((one.degree for one in headers), default=0)
    if not count or count < total:
        raise InputError(f"{path}: promises {total:,} splats, and its sections hold {count:,}: it is damaged")
    # What is not there is found out before memory is taken.
    if count * _row(level, 0).itemsize > size:
        raise too_short(path, f"its {count:,} splats")
    check_room(path, count, degree, room)
    arrays, start = empty_arrays(count, degree), 0
    for section in headers:
        if section.count:
            part = {name: values[start : start + section.count] for name, values in arrays.items()}
            piece = progress.part(start / count, (start + section.count) / count)
            _read_section(file, section, part, level, sh_range, size, path, piece)
        start += section.count
    return scene_of(arrays)


def _section(header: bytes, path: Path) -> _Section:
    count, room, capacity, buckets, side, bucket_bytes, steps, full, partial, degree = struct.unpack_from(
        "<4IfH2xI4x2IH", header
    )
    if degree > 3 or count > room or not abs(side) < 1e30:
        raise InputError(f"{path}: the header of a section makes no sense; the file is damaged")
    return _Section(
        count=count,
        room=room,
        capacity=capacity,
        buckets=buckets,
        side=side,
        bucket_bytes=bucket_bytes,
        steps=steps or BUCKET_RANGE,
        full=full,
        partial=partial,
        degree=degree,
    )


def _row(level: int, degree: int) -> np.dtype:
    number = "<f4" if level == 0 else "<f2"
    rest = ("<f4", "<f2", "u1")[level]
    return np.dtype(
        [
            ("mean", "<f4" if level == 0 else "<u2", 3),
            ("scale", number, 3),
            ("quat", number, 4),
            ("rgba", "u1", 4),
            ("sh", rest, (SH_COEFFICIENTS[degree] - 1) * 3),
        ]
    )


def _read_section(
    file: io.BufferedReader,
    section: _Section,
    arrays: dict[str, np.ndarray],
    level: int,
    sh_range: tuple[float, float],
    size: int,
    path: Path,
    progress: Progress,
) -> None:
    """Fills the section's part of the scene's arrays. Raises InputError and Cancelled."""
    row = _row(level, section.degree)
    before = 4 * section.partial + section.bucket_bytes * section.buckets
    # Space that is not filled is there all the same, but for the end of the file.
    if before + row.itemsize * section.count > size - file.tell():
        raise too_short(path, f"{section.count:,} splats of a section")
    partial = np.frombuffer(file.read(4 * section.partial), "<u4")
    centres = np.frombuffer(file.read(section.bucket_bytes * section.buckets), np.uint8)
    bucket = points = None
    if level:
        bucket = _buckets_of(section, partial, section.count, path)
        if section.bucket_bytes < 12:
            raise InputError(f"{path}: its buckets have no centres; the file is damaged")
        points = centres.reshape(section.buckets, -1)[:, :12].copy().view("<f4")
    for at in slices(section.count):
        rows = np.frombuffer(file.read(row.itemsize * (at.stop - at.start)), row)
        if len(rows) < at.stop - at.start:
            raise InputError(f"{path}: became shorter while it was read")
        if bucket is None or points is None:
            arrays["means"][at] = rows["mean"]
        else:
            step = np.float32(section.side / 2 / section.steps)
            offsets = (rows["mean"].astype(np.float32) - section.steps) * step
            arrays["means"][at] = offsets + points[bucket[at]]
        _put_sh(rows, arrays["sh"][at], level, section.degree, sh_range)
        with np.errstate(divide="ignore", invalid="ignore"):
            arrays["log_scales"][at] = np.log(rows["scale"].astype(np.float32))
        arrays["quats"][at] = rows["quat"]
        arrays["opacity_logits"][at] = LOGITS[rows["rgba"][:, 3]]
        progress.step(at.stop / section.count)
    file.seek(row.itemsize * (section.room - section.count), io.SEEK_CUR)


def _put_sh(rows: np.ndarray, sh: np.ndarray, level: int, degree: int, sh_range: tuple[float, float]) -> None:
    sh[:, 0] = rgb_to_sh(rows["rgba"][:, :3] / np.float32(255))
    rest = rows["sh"].astype(np.float32)
    if level == 2:
        rest = sh_range[0] + rest / 255 * (sh_range[1] - sh_range[0])
    # Band by band, and within it channel by channel.
    for band in range(1, degree + 1):
        first, stop = SH_COEFFICIENTS[band - 1], SH_COEFFICIENTS[band]
        own = rest[:, 3 * (first - 1) : 3 * (stop - 1)].reshape(len(rows), 3, stop - first)
        sh[:, first:stop] = own.transpose(0, 2, 1)
    sh[:, SH_COEFFICIENTS[degree] :] = 0


def _buckets_of(section: _Section, partial: np.ndarray, n: int, path: Path) -> np.ndarray:
    """(N,) index of each splat's bucket: full ones first."""
    in_full = min(section.full * section.capacity, n)
    numbers = np.arange(in_full) // max(section.capacity, 1)
    # A damaged size may be anything: none counts for more than there are splats.
    sizes = np.minimum(partial, n).astype(np.int64)
    ends = np.cumsum(sizes)
    rest = section.full + np.searchsorted(ends, np.arange(n - in_full), side="right")
    bucket = np.concatenate([numbers, rest])
    if len(bucket) and bucket.max() >= section.buckets:
        raise InputError(
            f"{path}: a splat is in none of the {section.buckets:,} buckets: the file is damaged"
        )
    return bucket
