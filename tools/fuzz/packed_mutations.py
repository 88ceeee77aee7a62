"""Damage inside of packed scenes: containers are opened, damaged where it matters, and closed again.

Flipped bits of a gzip, zstd, zip or WebP end at its checksum: what lies behind is reached this way only.
"""

from __future__ import annotations

import gzip
import io
import random
import struct
import zipfile
import zlib
from collections.abc import Callable

import zstandard
from mutations import INTEGERS, damaged_json, mutated
from PIL import Image


def _odd(rng: random.Random, value: int, bits: int) -> int:
    """A number of so many bits in the place of `value`."""
    near = value + rng.choice((-256, -2, -1, 1, 2, 255))
    return rng.choice((near, rng.choice(INTEGERS), value * 2, value // 2)) % (1 << bits)


def _bent(rng: random.Random, data: bytes) -> bytes:
    return mutated(rng, [data], ())


def spz(rng: random.Random, data: bytes) -> bytes:
    """A file of any version whose header, records or blocks are damaged, in whole containers."""
    version, count, degree, bits, flags, blocks, records = _spz_parts(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        kind = rng.randrange(8)
        if kind == 0:
            version = _odd(rng, version, 32) if rng.random() < 0.3 else rng.choice((1, 2, 3, 4))
        elif kind == 1:
            count = _odd(rng, count, 32)
        elif kind == 2:
            degree = rng.choice((0, 1, 2, 3, 4, 5, 255))
        elif kind == 3:
            bits = rng.choice((0, 1, 8, 23, 24, 31, 255))
        elif kind == 4:
            flags ^= 1 << rng.randrange(8)
        elif kind == 5 and blocks:
            at = rng.randrange(len(blocks))
            blocks[at] = _bent(rng, blocks[at])
        elif kind == 6:
            numbers = (
                rng.choice((0xADBE0003, 0xADBE0002, 7)),
                rng.choice((0, 4, 12, 2**31)),
                _odd(rng, 3, 32),
            )
            records += struct.pack("<III", *numbers)
            flags |= 2
        else:
            blocks = rng.choice((blocks[:-1], [*blocks, b"x" * 9], blocks[::-1], [b"".join(blocks)]))
    head = struct.pack("<4sIIBBB", b"NGSP", version, count, degree, bits, flags & 255)
    if version != 4 or rng.random() < 0.1:
        plain = head + b"\0" + b"".join(blocks) + records
        return plain if rng.random() < 0.2 else gzip.compress(plain, 1, mtime=0)
    frames = [_zstd(rng, block) for block in blocks]
    table = b"".join(
        struct.pack("<QQ", len(frame), _odd(rng, len(block), 64) if rng.random() < 0.05 else len(block))
        for frame, block in zip(frames, blocks, strict=True)
    )
    streams = len(frames) if rng.random() < 0.95 else _odd(rng, len(frames), 8)
    at = 32 + len(records) if rng.random() < 0.95 else _odd(rng, 32, 32)
    return head + struct.pack("<BI12x", streams & 255, at) + records + table + b"".join(frames)


def _zstd(rng: random.Random, block: bytes) -> bytes:
    """A frame that says its size, or does not, or lies, or unpacks to far more."""
    if rng.random() < 0.02:
        block = bytes(1 << 22)
    frame = zstandard.ZstdCompressor(level=1, write_content_size=rng.random() < 0.7).compress(block)
    return _bent(rng, frame) if rng.random() < 0.1 else frame


def _spz_parts(data: bytes) -> tuple[int, int, int, int, int, list[bytes], bytes]:
    """Version, count, degree, fraction bits, flags, blocks and records of a whole file."""
    if data[:4] == b"NGSP" and data[4] == 4:
        _, version, count, degree, bits, flags, streams, at = struct.unpack_from("<4sIIBBBBI", data)
        sizes = struct.unpack_from(f"<{2 * streams}Q", data, at)[::2]
        start, blocks = at + 16 * streams, []
        for size in sizes:
            blocks.append(zstandard.ZstdDecompressor().decompress(data[start : start + size], 1 << 20))
            start += size
        return version, count, degree, bits, flags, blocks, data[32:at]
    plain = zlib.decompress(data, 31) if data[:2] == b"\x1f\x8b" else data
    _, version, count, degree, bits, flags = struct.unpack_from("<4sIIBBB", plain)
    return version, count, degree, bits, flags, [plain[16:]], b""


def sog(rng: random.Random, data: bytes) -> bytes:
    """A zip whose entries are damaged, renamed, lost, doubled or exchanged."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    names = list(files)
    for _ in range(rng.choice((1, 1, 2))):
        name, other = rng.choice(names), rng.choice(names)
        kind = rng.randrange(9)
        if kind <= 3 and "meta.json" in files:
            files["meta.json"] = damaged_json(rng, files["meta.json"])
        elif kind == 4 and name.endswith(".webp"):
            files[name] = picture(rng)
        elif kind == 5:
            files[name] = files[other]
        elif kind == 6:
            files[rng.choice(("../x", "/etc/x", "a/b", "", "x" * 300, name.upper()))] = files.pop(name)
            names = list(files)
        elif kind == 7:
            files[name] = _bent(rng, files[name])
        elif len(files) > 1:
            del files[name]
            names = list(files)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", rng.choice((0, 0, 8, 12, 14))) as archive:
        for name, content in files.items():
            archive.writestr(zipfile.ZipInfo(name or "_"), content, compress_type=rng.choice((0, 0, 8)))
    return out.getvalue() if rng.random() < 0.8 else _bent(rng, out.getvalue())


def picture(rng: random.Random) -> bytes:
    """A WebP of another size or kind, at times one that says to be huge."""
    size = rng.choice((1, 4, 8, 16, 64)), rng.choice((1, 4, 8, 16, 64))
    out = io.BytesIO()
    mode = rng.choice(("RGB", "RGBA"))
    shown = Image.frombytes(mode, size, rng.randbytes(len(mode) * size[0] * size[1]))
    if rng.random() < 0.2:
        shown.save(out, "WEBP", save_all=True, append_images=[shown, shown], lossless=True)
    else:
        shown.save(out, rng.choice(("WEBP", "WEBP", "WEBP", "PNG")), lossless=rng.random() < 0.8)
    data = bytearray(out.getvalue())
    at = data.find(b"VP8L")
    if at > 0 and rng.random() < 0.3:
        struct.pack_into(
            "<I", data, at + 9, rng.choice((0x0FFFFFFF, 0x3FFF, 0x0FFFC000, rng.getrandbits(28)))
        )
    return bytes(data)


def glb(rng: random.Random, data: bytes) -> bytes:
    """A description that is damaged within, or numbers that are, in whole chunks."""
    (length,) = struct.unpack_from("<I", data, 12)
    text, binary = data[20 : 20 + length], data[28 + length :]
    if rng.random() < 0.7:
        text = damaged_json(rng, text)
    else:
        binary = _bent(rng, binary)
    text += b" " * (-len(text) % 4)
    total = 28 + len(text) + len(binary)
    if rng.random() < 0.05:
        total = _odd(rng, total, 32)
    head = struct.pack("<4s4I", b"glTF", 2, total, len(text), 0x4E4F534A)
    return head + text + struct.pack("<2I", len(binary), 0x004E4942) + binary


def ksplat(rng: random.Random, data: bytes) -> bytes:
    """Counts, sizes and levels of the headers."""
    buffer = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        at, form = rng.choice(
            (
                *((offset, "<I") for offset in (4, 8, 12, 16)),
                *((20, "<H"), (36, "<f"), (40, "<f")),
                *((4096 + offset, "<I") for offset in (0, 4, 8, 12, 24, 28, 32, 36)),
                *((4096 + 16, "<f"), (4096 + 20, "<H"), (4096 + 40, "<H")),
            )
        )
        if form == "<f":
            struct.pack_into(form, buffer, at, rng.choice((0.0, -1.5, 1e30, float("nan"), float("inf"))))
        else:
            (value,) = struct.unpack_from(form, buffer, at)
            struct.pack_into(form, buffer, at, _odd(rng, value, 8 * struct.calcsize(form)))
    return bytes(buffer) if rng.random() < 0.8 else _bent(rng, bytes(buffer))


INSIDE: dict[str, Callable[[random.Random, bytes], bytes]] = {
    "scene_spz": spz,
    "scene_sog": sog,
    "scene_glb": glb,
    "scene_ksplat": ksplat,
    "scene_gltf": damaged_json,
}
"""Damage by name of the loader; its seeds are whole files."""
