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
import re
import struct
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from splatview.scene.edits import quat_product
from splatview.scene.effects.appearance import antialiasing
from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write
from splatview.scene.formats.packing import (
    LOGITS,
    SQRT_HALF,
    arrays_of,
    check_expansion,
    check_room,
    empty_arrays,
    gunzipped,
    in_slices,
    rows_of,
    scene_of,
    storable_in_z_order,
    too_short,
)
from splatview.scene.frames import NO_FLIPS, OURS, axis_flips, frame_matrix, turn_in_place
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

LEVEL = 5
"""Of zstd. The reference takes 12, which makes 9.5 MB of 500,000 splats of degree 2 (playbot_lod0) instead of
9.8, and takes four times as long."""

LONG_MATCHES = {"window_log": 24, "chain_log": 20, "hash_log": 19, "min_match": 7}
"""Settings for SH, whose rows return as a whole or not at all: long matches alone, but in all of 16 MiB. They
make 2.71 MB in 0.18 s, where level 5 makes 3.28 in 0.24, level 9 2.66 in 0.54, level 12 2.34 in 1.07."""

RANGES = {
    "log_scales": (-10.0, 255 / 16 - 10),
    "colours": (-0.5 / COLOUR_SCALE, 0.5 / COLOUR_SCALE),
    "sh": (-1.0, 0.9375),
}
"""What its numbers reach to; SH with the bits of SH_BITS."""

SAYS_ORBIT = re.compile(r"spz safe orbit: elevation (\S+) to (\S+), radius (\S+)")
SAYS_RECORD = re.compile(r"spz extension 0x([0-9a-f]{8}): ((?:[0-9a-f]{2})*)")
"""Comments that extension records of a file are kept as, and made of again."""

MOST_RECORDS = 1 << 14
"""Bytes of extension records that are kept: comments are text, which a .ply has a mebibyte of at most."""

AT_ONCE = 1 << 20
"""Bytes that are packed between two questions whether to go on."""


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
        header = _read_header(io.BytesIO(gunzipped(file, path, 16, progress).tobytes()), path)
        file.seek(0)
        _check_size(header, size, room, path)
        # Extension records are few: a mebibyte is more than any of them needs.
        content = gunzipped(file, path, 16 + sum(header.sizes.values()) + 2**20, progress)
        blocks, records = _plain_blocks(header, content[16:], path)
    elif struct.unpack_from("<I", start.ljust(8, b"\0"), 4)[0] < 4:
        header = _read_header(file, path)
        _check_size(header, size, room, path)
        content = np.empty(min(sum(header.sizes.values()) + 2**20, size), np.uint8)
        content = content[: file.readinto(content.data)]
        blocks, records = _plain_blocks(header, content, path)
    else:
        header, blocks, records = _read_streams(file, path, size, progress, room)
    progress.step(0.5)
    extensions = _extensions(records) if header.flags & HAS_EXTENSIONS else {}
    return _decoded(header, blocks, extensions, progress.part(0.5, 1.0))


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


def _plain_blocks(header: Header, content: np.ndarray, path: Path) -> tuple[dict[str, np.ndarray], bytes]:
    """Blocks by name, and what follows them. Raises InputError."""
    blocks, at = {}, 0
    for name, size in header.sizes.items():
        blocks[name] = content[at : at + size]
        at += size
        if len(blocks[name]) < size:
            raise too_short(path, f"the {name} of its {header.count:,} splats")
    return blocks, content[at:].tobytes()


def _read_streams(
    file: io.BufferedReader, path: Path, size: int, progress: Progress, room: float
) -> tuple[Header, dict[str, np.ndarray], bytes]:
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
    blocks, at, lock = dict.fromkeys(header.sizes, NOTHING), file.tell(), threading.Lock()

    def unpack(at: int, size: int, length: int, name: str) -> None:
        progress.check()
        packed = np.empty(size, np.uint8)
        with lock:
            file.seek(at)
            packed = packed[: file.readinto(packed.data)]
        blocks[name] = _unpacked(packed, length, name, path)

    tasks = []
    for i, (name, length) in enumerate(wanted.items()):
        if table[2 * i + 1] != length:
            raise InputError(
                f"{path}: {table[2 * i + 1]:,} bytes of {name}, and {length:,} belong there: damaged"
            )
        tasks.append((at, table[2 * i], length, name))
        at += table[2 * i]
    from splatview.scene.compiling import run, threads_for

    # The largest is the last.
    run(unpack, tasks[::-1], (), threads_for(size))
    return header, blocks, records


NOTHING = np.zeros(0, np.uint8)


def _unpacked(packed: np.ndarray, length: int, name: str, path: Path) -> np.ndarray:
    """The content of a zstd frame of exactly `length` bytes. Raises InputError."""
    import zstandard

    # A frame may lie about its size, or say none: never more is unpacked than belongs there.
    content, at = np.empty(length + 1, np.uint8), 0
    try:
        reader = zstandard.ZstdDecompressor(max_window_size=2**27).stream_reader(packed.data)
        # All at once: where all has room zstd makes no window of its own, which took half as long again.
        while at <= length and (count := reader.readinto(content[at:].data)):
            at += count
    except zstandard.ZstdError as error:
        raise InputError(f"{path}: its {name} are damaged ({error}); copy or export it again") from None
    if at != length:
        raise too_short(path, f"its {name} do")
    return content[:length]


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


def _decoded(
    header: Header, content: dict[str, np.ndarray], extensions: dict[int, bytes], progress: Progress
) -> Gaussians:
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
    others = {kind: payload for kind, payload in extensions.items() if kind not in (FRAME, ORBIT)}
    if sum(8 + len(payload) for payload in others.values()) <= MOST_RECORDS:
        comments += [f"spz extension {kind:#010x}: {payload.hex()}" for kind, payload in others.items()]
    else:
        comments.append(f"splatview: {len(others):,} extensions of the file are large, and were left out")
    return scene_of(_arrays(header, content, frame, progress), tuple(comments))


def _arrays(
    header: Header, content: dict[str, np.ndarray], frame: str, progress: Progress
) -> dict[str, np.ndarray]:
    """Arrays of `Gaussians` in our frame. Raises Cancelled."""
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.decoding import decode_spz

    n, halves, three_bytes = header.count, header.version == 1, header.version < 3
    blocks = [content[name].reshape(n, -1) if n else NO_ROWS for name in header.sizes]
    if not three_bytes:
        # In a plain file words of four bytes may begin anywhere.
        blocks[4] = np.require(blocks[4].view("<u4"), np.uint32, "A")
    arrays = empty_arrays(n, min(header.degree, 3))
    if halves and n:
        arrays["means"][:] = blocks[0].reshape(-1).view("<f2").reshape(n, 3)
    flips = axis_flips(frame)
    axes, turn, signs = flips or NO_FLIPS
    units = axes if halves else np.ldexp(axes, -header.fraction_bits)
    # The turn of axes that change their signs alone moves components, and changes signs of theirs.
    components = quat_product(np.broadcast_to(turn, (4, 4)), np.eye(4, dtype=np.float32)[[1, 2, 3, 0]])
    places = np.abs(components).argmax(axis=1)
    factors = np.repeat(signs[1 : arrays["sh"].shape[1]], 3) / np.float32(128)
    over_splats(
        decode_spz,
        n,
        (blocks[0], blocks[1].reshape(-1), *blocks[2:]),
        (not halves, three_bytes),
        (LOGITS, COLOUR_LEVELS, SCALE_LEVELS, XYZ_LEVELS if three_bytes else QUAT_LEVELS),
        (units, places, components[np.arange(4), places], factors),
        rows_of(arrays),
        progress=progress,
    )
    if flips is None:
        turn_in_place(arrays, frame_matrix(frame))
    return arrays


NO_ROWS = np.zeros((0, 4), np.uint8)

COLOUR_LEVELS = (np.arange(256, dtype=np.float32) / np.float32(255) - np.float32(0.5)) / np.float32(
    COLOUR_SCALE
)
SCALE_LEVELS = np.arange(256, dtype=np.float32) / np.float32(16) - 10
"""What each byte means; one of SH, less 128, is 128 times the coefficient."""

XYZ_LEVELS = np.arange(256, dtype=np.float32) / np.float32(127.5) - 1
"""Component of a quaternion for each byte, up to version 2."""

QUAT_LEVELS = np.concatenate([size := np.arange(512, dtype=np.float32) / 511, -size]) * SQRT_HALF
"""The same for each number of 10 bits, the highest of which is the sign."""


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
    progress.check()
    order = storable_in_z_order(gaussians)
    largest = max((float(np.abs(gaussians.means[part]).max()) for part in in_slices(order)), default=0.0)
    most = MOST_FRACTION_BITS if position_bits is None else FINEST_FRACTION_BITS
    bits = most if largest == 0 else min(most, math.floor(math.log2(LARGEST / largest)))
    if bits < 0:
        raise InputError(
            f"{path}: a splat is {largest:g} from the origin, and .spz holds positions to {LARGEST:,}: move "
            "the scene to the origin first, or take another format"
        )
    if position_bits is not None:
        bits = max(bits - (24 - position_bits), 0)
    header = Header(
        version=NEWEST,
        count=len(order),
        degree=gaussians.sh_degree,
        fraction_bits=bits,
        flags=HAS_EXTENSIONS | (ANTIALIASED if antialiasing(gaussians.comments)[0] else 0),
    )
    progress.step(0.1)
    encoded = _encoded(gaussians, order, header, sh_bits, progress.part(0.1, 0.2))
    blocks = {name: block for name, block in encoded.items() if block.size}
    records = struct.pack("<III", FRAME, 4, NUMBERED_FRAMES.index(DEFAULT_FRAME) + 1)
    records += b"".join(map(_record, gaussians.comments))
    from splatview.scene.compiling import run, threads_for

    # The largest is the last.
    tasks = list(blocks.items())[::-1]
    size = sum(header.sizes.values())
    streams = run(_frame, tasks, (progress,), threads_for(size))[::-1]
    progress.step(0.9)
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
        for block, stream in zip(blocks.values(), streams, strict=True):
            file.write(struct.pack("<QQ", len(stream), block.nbytes))
        for stream in streams:
            file.write(stream)


def _encoded(
    gaussians: Gaussians, order: np.ndarray, header: Header, sh_bits: tuple[int, ...], progress: Progress
) -> dict[str, np.ndarray]:
    """Blocks by name, in the order of the file. Raises Cancelled."""
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.encoding import encode_spz

    n = len(order)
    shapes = {name: (n, size // max(n, 1)) for name, size in header.sizes.items()}
    blocks: dict[str, np.ndarray] = {name: np.empty(shape, np.uint8) for name, shape in shapes.items()}
    blocks["alphas"], blocks["rotations"] = np.empty(n, np.uint8), np.empty(n, np.uint32)
    flips = axis_flips(OURS, DEFAULT_FRAME)
    assert flips is not None
    axes, turn, signs = flips
    frame = (np.ldexp(axes.astype(np.float64), header.fraction_bits), turn, signs)
    steps = np.ones(SH_COEFFICIENTS[-1], np.int64)
    for band, bits in enumerate(sh_bits, 1):
        steps[SH_COEFFICIENTS[band - 1] : SH_COEFFICIENTS[band]] = 1 << (8 - bits)
    over_splats(
        encode_spz,
        n,
        *(order, arrays_of(gaussians), frame, steps, tuple(blocks.values())),
        progress=progress,
    )
    blocks["rotations"] = blocks["rotations"].astype("<u4", copy=False)
    return blocks


def is_record(comment: str) -> bool:
    """Whether a comment is written to a .spz as an extension record, which it was read from."""
    return _record(comment) != b""


def _record(comment: str) -> bytes:
    """The extension record that became a comment; nothing of other comments."""
    if other := SAYS_RECORD.fullmatch(comment):
        kind, payload = int(other[1], 16), bytes.fromhex(other[2])
        return struct.pack("<II", kind, len(payload)) + payload if kind != FRAME else b""
    orbit = SAYS_ORBIT.fullmatch(comment)
    try:
        return struct.pack("<II3f", ORBIT, 12, *map(float, orbit.groups())) if orbit else b""
    except (ValueError, OverflowError):  # somebody else's comment
        return b""


def _frame(name: str, block: np.ndarray, progress: Progress) -> bytes:
    """A block as a zstd frame. Raises Cancelled."""
    import zstandard

    settings = LONG_MATCHES | {"strategy": zstandard.STRATEGY_DFAST} if name == "sh" else {}
    parameters = zstandard.ZstdCompressionParameters.from_level(LEVEL, source_size=block.nbytes, **settings)
    packer = zstandard.ZstdCompressor(compression_params=parameters).compressobj(size=block.nbytes)
    content, parts = block.data.cast("B"), []
    for start in range(0, block.nbytes, AT_ONCE):
        progress.check()
        parts.append(packer.compress(content[start : start + AT_ONCE]))
    return b"".join([*parts, packer.flush()])
