"""Scenes from and to .spz, Niantic's packed splats: versions 1 to 4 read, 4 written.

Up to version 3 a gzip stream of a 16-byte header and one block per attribute; version 4 has a plain header
of 32 bytes and a zstd frame per attribute. Source: nianticlabs/spz, README and load-spz.cc (MIT), read for
facts.

The format's frame is RUB (y up, z to the back); an extension record may name another one. Tools exist that
write RDF without saying so, so the frame that was assumed stands in the scene's comments.
"""

from __future__ import annotations

import io
import math
import os
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatview.scene.effects.appearance import antialiasing
from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write
from splatview.scene.formats.packing import (
    check_expansion,
    check_room,
    from_smallest_three,
    gunzipped,
    logits_of,
    opacity_levels,
    smallest_three,
    storable_in_z_order,
    too_short,
)
from splatview.scene.frames import OURS, reframed
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress

MAGIC = b"NGSP"
GZIP = b"\x1f\x8b"
NEWEST = 4

ANTIALIASED, HAS_EXTENSIONS, LOD_TREE = 1, 2, 0x80
"""Bits of the flags; the last is Spark's own, for a tree of levels of detail."""

DEFAULT_FRAME = "RUB"

NUMBERED_FRAMES = (
    "LDB",
    "RDB",
    "LUB",
    "RUB",
    "LDF",
    "RDF",
    "LUF",
    "RUF",
    "LFD",
    "RFD",
    "LFU",
    "RFU",
    "LBD",
    "RBD",
    "LBU",
    "RBU",
)
"""Frames that the extension FRAME names, from 1 on."""

FRAME, ORBIT = 0xADBE0003, 0xADBE0002
"""Types of extension records: the frame (uint32), and limits for orbiting cameras (three float32)."""

COLOUR_SCALE = 0.15
"""Coefficient of the constant band that one unit of colour stands for."""

MOST_FRACTION_BITS = 12
"""Bits behind the point of a position, as the reference writes: steps of a quarter of a millimetre."""

FINEST_FRACTION_BITS = 23
"""Bits behind the point beyond which readers may fail."""

LARGEST = 2**23 - 1
"""Largest whole number of 24 bits with a sign."""

SH_BITS = (5, 4, 4)
"""Bits kept of coefficients of band 1, 2 and 3, as the reference keeps: fewer different bytes compress
better."""

LEVEL = 12
"""Of zstd, as the reference takes."""


@dataclass(frozen=True, kw_only=True)
class Header:
    version: int
    count: int
    degree: int
    fraction_bits: int
    flags: int

    @property
    def sizes(self) -> dict[str, int]:
        """Bytes of each block, in the order of the file."""
        coefficients = (self.degree + 1) ** 2 - 1
        return {
            "positions": self.count * (6 if self.version == 1 else 9),
            "alphas": self.count,
            "colours": 3 * self.count,
            "scales": 3 * self.count,
            "rotations": self.count * (3 if self.version < 3 else 4),
            "sh": 3 * coefficients * self.count,
        }


def is_spz(start: bytes) -> bool:
    return start.startswith((MAGIC, GZIP))


def read_spz(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats in our frame; comments name the frame of the file. Raises InputError and Cancelled."""
    size = os.fstat(file.fileno()).st_size
    start = file.read(8)
    file.seek(0)
    if start.startswith(GZIP):
        packed = io.BytesIO(gunzipped(file, path, 16, progress))
        header = _read_header(packed, path)
        file.seek(0)
        _check_size(header, size, room, path)
        # Extension records are few: a mebibyte is more than any of them needs.
        content = gunzipped(file, path, 16 + sum(header.sizes.values()) + 2**20, progress)
        blocks, records = _plain_blocks(header, content[16:], path)
    elif struct.unpack_from("<I", start.ljust(8, b"\0"), 4)[0] < 4:
        header = _read_header(file, path)
        _check_size(header, size, room, path)
        blocks, records = _plain_blocks(header, file.read(), path)
    else:
        header, blocks, records = _read_streams(file, path, size, progress, room)
    progress.step(0.5)
    return _decoded(header, blocks, _extensions(records) if header.flags & HAS_EXTENSIONS else {})


def _read_header(file: io.BufferedReader | io.BytesIO, path: Path) -> Header:
    data = file.read(16)
    if len(data) < 16 or data[:4] != MAGIC:
        raise InputError(f"{path}: is no .spz file: its content does not begin with NGSP; name another file")
    _, version, count, degree, fraction_bits, flags, _ = struct.unpack("<4sIIBBBB", data)
    if not 1 <= version <= NEWEST:
        raise InputError(f"{path}: is version {version} of .spz; versions 1 to {NEWEST} are read")
    if not degree <= 4:
        raise InputError(f"{path}: its SH degree is {degree}; there are 0 to 4: the file is damaged")
    if not fraction_bits < 24:
        raise InputError(f"{path}: positions of {fraction_bits} bits behind the point: the file is damaged")
    if flags & LOD_TREE:
        raise InputError(
            f"{path}: holds Spark's tree of levels of detail, not plain splats; export it without"
        )
    return Header(version=version, count=count, degree=degree, fraction_bits=fraction_bits, flags=flags)


def _check_size(header: Header, size: int, room: float, path: Path) -> None:
    check_expansion(path, sum(header.sizes.values()), size)
    check_room(path, header.count, min(header.degree, 3), room)


def _plain_blocks(header: Header, content: bytes, path: Path) -> tuple[dict[str, bytes], bytes]:
    """Blocks by name, and what follows them. Raises InputError."""
    blocks, at = {}, 0
    for name, size in header.sizes.items():
        blocks[name] = content[at : at + size]
        at += size
        if len(blocks[name]) < size:
            raise too_short(path, f"the {name} of its {header.count:,} splats")
    return blocks, content[at:]


def _read_streams(
    file: io.BufferedReader, path: Path, size: int, progress: Progress, room: float
) -> tuple[Header, dict[str, bytes], bytes]:
    """Header, blocks and extension records of version 4. Raises InputError and Cancelled."""
    header = _read_header(file, path)
    rest = file.read(16)
    if len(rest) < 16:
        raise too_short(path, "its header does")
    # The plain header's last byte counts the streams here; the table of their sizes follows the records.
    file.seek(15)
    streams, table_at = file.read(1)[0], struct.unpack_from("<I", rest)[0]
    wanted = {name: bytes_ for name, bytes_ in header.sizes.items() if bytes_}
    if streams != len(wanted):
        raise InputError(
            f"{path}: has {streams} streams, and {len(wanted)} belong to {header.count:,} splats of SH "
            f"degree {header.degree}: it is damaged; export it again"
        )
    if not 32 <= table_at <= size - 16 * streams:
        raise InputError(f"{path}: its table of streams is said to be outside of the file: it is damaged")
    _check_size(header, size, room, path)
    file.seek(32)
    records = file.read(table_at - 32)
    table = struct.unpack(f"<{2 * streams}Q", file.read(16 * streams))
    if sum(table[::2]) != size - table_at - 16 * streams:
        raise too_short(path, "its streams do")
    blocks = dict.fromkeys(header.sizes, b"")
    for i, (name, length) in enumerate(wanted.items()):
        if table[2 * i + 1] != length:
            raise InputError(
                f"{path}: {table[2 * i + 1]:,} bytes of {name}, and {length:,} belong there: damaged"
            )
        blocks[name] = _unpacked(file.read(table[2 * i]), length, name, path)
        progress.step(0.5 * (i + 1) / streams)
    return header, blocks, records


def _unpacked(packed: bytes, length: int, name: str, path: Path) -> bytes:
    """A zstd frame of exactly `length` bytes. Raises InputError."""
    import zstandard

    try:
        # A frame may lie about its size, or say none: never more is unpacked than belongs there.
        reader = zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(packed)
        content = reader.read(length + 1)
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: its {name} are damaged ({error}); copy or export it again") from None
    if len(content) != length:
        raise too_short(path, f"its {name} do")
    return content


def _extensions(records: bytes) -> dict[int, bytes]:
    """Payloads of the extension records by type; a damaged end is left out."""
    found, at = {}, 0
    while at + 8 <= len(records):
        kind, length = struct.unpack_from("<II", records, at)
        if at + 8 + length > len(records):
            break
        found[kind] = records[at + 8 : at + 8 + length]
        at += 8 + length
    return found


def _decoded(header: Header, content: dict[str, bytes], extensions: dict[int, bytes]) -> Gaussians:
    n, degree = header.count, min(header.degree, 3)
    blocks = {name: np.frombuffer(block, np.uint8) for name, block in content.items()}
    coefficients = (header.degree + 1) ** 2 - 1
    sh = np.empty((n, SH_COEFFICIENTS[degree], 3), np.float32)
    sh[:, 0] = (blocks["colours"].reshape(n, 3) / np.float32(255) - np.float32(0.5)) / np.float32(
        COLOUR_SCALE
    )
    rest = blocks["sh"].reshape(n, coefficients, 3)[:, : SH_COEFFICIENTS[degree] - 1]
    np.divide(rest.astype(np.float32) - 128, 128, out=sh[:, 1:])
    comments, frame = [], DEFAULT_FRAME
    number = int.from_bytes(extensions.get(FRAME, b"")[:4], "little")
    if 1 <= number <= len(NUMBERED_FRAMES):
        frame = NUMBERED_FRAMES[number - 1]
        comments.append(f"splatview: the file says that its frame is {frame}")
    else:
        comments.append(
            f"splatview: the file's frame was taken to be {frame}, the format's own; a scene on its head is "
            "turned over by Edit > Turn over, or splatview convert --turn over"
        )
    if header.degree > 3:
        comments.append("splatview: the file's SH band 4 was left out")
    if header.flags & ANTIALIASED:
        comments.append("antialiased 1")
    if len(extensions.get(ORBIT, b"")) == 12:
        low, high, radius = struct.unpack("<3f", extensions[ORBIT])
        comments.append(f"spz safe orbit: elevation {low:.9g} to {high:.9g}, radius {radius:.9g}")
    for kind, payload in extensions.items():
        if kind not in (FRAME, ORBIT):
            comments.append(f"spz extension {kind:#010x}: {payload.hex()}")
    gaussians = Gaussians(
        means=_positions(header, blocks["positions"]),
        quats=_rotations(header, blocks["rotations"]),
        log_scales=blocks["scales"].reshape(n, 3) / np.float32(16) - 10,
        opacity_logits=logits_of(blocks["alphas"] / 255),
        sh=sh,
        comments=tuple(comments),
    )
    return reframed(gaussians, frame)


def _positions(header: Header, block: np.ndarray) -> np.ndarray:
    if header.version == 1:
        return block.view("<f2").astype(np.float32).reshape(-1, 3)
    # Three bytes into the upper three of four: shifting back down brings the sign along.
    wide = np.zeros((len(block) // 3, 4), np.uint8)
    wide[:, 1:] = block.reshape(-1, 3)
    whole = (wide.view("<i4")[:, 0] >> 8).astype(np.float32)
    return np.ldexp(whole, -header.fraction_bits).reshape(-1, 3)


def _rotations(header: Header, block: np.ndarray) -> np.ndarray:
    """(N, 4) wxyz."""
    if header.version < 3:
        xyz = block.reshape(-1, 3) / np.float32(127.5) - 1
        w = np.sqrt(np.maximum(1 - np.einsum("ni,ni->n", xyz, xyz), 0))
        return np.column_stack([w, xyz]).astype(np.float32)
    packed = block.view("<u4")
    rest = np.empty((len(packed), 3), np.float32)
    for place in range(3):  # the last component in the lowest bits
        bits = packed >> np.uint32(10 * (2 - place))
        size = (bits & 511).astype(np.float32) / 511
        rest[:, place] = np.where(bits & 512, -size, size)
    return from_smallest_three((packed >> 30).astype(np.int64), rest)[:, [3, 0, 1, 2]]


def save_spz(
    gaussians: Gaussians,
    path: Path,
    progress: Progress,
    *,
    sh_bits: tuple[int, ...] = SH_BITS,
    position_bits: int | None = None,
) -> None:
    """Writes version 4 in the frame RUB. `sh_bits`: bits kept of each band's coefficients, 1 to 8;
    `position_bits`: bits of the largest coordinate, 2 to 24, or as many as there are in steps of
    2**-MOST_FRACTION_BITS.

    Raises:
        InputError: a position is too far out for 24 bits, or the system refuses.
        Cancelled: nobody waits for it any more.
    """
    gaussians = gaussians.take(storable_in_z_order(gaussians))
    largest = float(np.abs(gaussians.means).max(initial=0.0))
    most = MOST_FRACTION_BITS if position_bits is None else FINEST_FRACTION_BITS
    bits = most if largest == 0 else min(most, math.floor(math.log2(LARGEST / largest)))
    if bits < 0:
        raise InputError(
            f"{path}: a splat is {largest:g} from the origin, and .spz holds positions to {LARGEST:,}: move "
            "the scene to the origin first, or take another format"
        )
    if position_bits is not None:
        bits = max(bits - (24 - position_bits), 0)
    gaussians = reframed(gaussians, OURS, DEFAULT_FRAME)
    header = Header(
        version=NEWEST,
        count=len(gaussians),
        degree=gaussians.sh_degree,
        fraction_bits=bits,
        flags=HAS_EXTENSIONS | (ANTIALIASED if antialiasing(gaussians.comments)[0] else 0),
    )
    progress.step(0.1)
    blocks = [block for block in _encoded(gaussians, header, sh_bits) if len(block)]
    records = struct.pack("<III", FRAME, 4, NUMBERED_FRAMES.index(DEFAULT_FRAME) + 1)
    import zstandard

    compressor = zstandard.ZstdCompressor(level=LEVEL, threads=-1)
    streams = []
    for block in blocks:
        streams.append(compressor.compress(block))
        progress.step(0.1 + 0.8 * len(streams) / len(blocks))
    with atomic_write(path) as file:
        file.write(
            struct.pack(
                "<4sIIBBBB",
                MAGIC,
                header.version,
                header.count,
                header.degree,
                bits,
                header.flags,
                len(streams),
            )
        )
        file.write(struct.pack("<I12x", 32 + len(records)) + records)
        for block, stream in zip(blocks, streams, strict=True):
            file.write(struct.pack("<QQ", len(stream), len(block)))
        for stream in streams:
            file.write(stream)


def _encoded(gaussians: Gaussians, header: Header, sh_bits: tuple[int, ...]) -> list[bytes]:
    """Blocks in the order of the file."""
    whole = np.rint(np.ldexp(gaussians.means.astype(np.float64), header.fraction_bits)).astype("<i4")
    positions = whole.reshape(-1, 1).view(np.uint8)[:, :3].tobytes()
    alphas = opacity_levels(gaussians.opacity_logits).astype(np.uint8).tobytes()
    colours = _bytes((gaussians.sh[:, 0] * np.float32(COLOUR_SCALE) + np.float32(0.5)) * 255)
    scales = _bytes((gaussians.log_scales + 10) * 16)
    largest, rest = smallest_three(gaussians.quats[:, [1, 2, 3, 0]])
    packed = largest.astype("<u4") << 30
    for place in range(3):
        size = np.rint(np.abs(rest[:, place]) * 511).astype("<u4")
        packed |= (size | ((rest[:, place] < 0).astype("<u4") << 9)) << (10 * (2 - place))
    bands = []
    for band, bits in zip(range(1, header.degree + 1), sh_bits, strict=False):
        step = 1 << (8 - bits)
        levels = gaussians.sh[:, SH_COEFFICIENTS[band - 1] : SH_COEFFICIENTS[band]] * np.float32(128)
        # Whole steps from 128 on: 0 stays 0, which most coefficients nearly are.
        bands.append(np.clip(np.rint(levels / step) * step + 128, 128 % step, 256 - step))
    sh = np.concatenate(bands, axis=1).astype(np.uint8).tobytes() if bands else b""
    return [positions, alphas, colours, scales, packed.tobytes(), sh]


def _bytes(values: np.ndarray) -> bytes:
    return np.clip(np.rint(values), 0, 255).astype(np.uint8).tobytes()
