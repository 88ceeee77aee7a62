"""Scenes from and to compressed .ply: 16 bytes per splat relative to the bounds of its chunk of 256 splats.

Chunks have 12 numbers, or 18 with bounds of colours; SH, where there are any, are an element of bytes.
Source: playcanvas/splat-transform, decompress-ply.ts and compressed-chunk.ts (MIT), read for facts.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from plyfile import PlyElement, PlyProperty

from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write
from splatview.scene.formats.packing import (
    LOGITS,
    SQRT_HALF,
    arrays_of,
    check_room,
    empty_arrays,
    rows_of,
    scene_of,
    storable_in_z_order,
)
from splatview.scene.formats.ply_body import PlyBody, Target
from splatview.scene.formats.ply_header import header_text, scalar_types
from splatview.scene.framing import in_sky
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress

CHUNK = 256

BOUNDS = tuple(f"{end}_{what}{axis}" for what in ("", "scale_") for end in ("min", "max") for axis in "xyz")
COLOUR_BOUNDS = tuple(f"{end}_{channel}" for end in ("min", "max") for channel in "rgb")
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")

LARGEST_LOG_SCALE = 20.0
"""Log-scales are kept within ± this: -inf would spoil the bounds of a chunk."""

SH_RANGE = 8.0
"""Width of the range of coefficients, about 0."""

RANGES = {"log_scales": (-LARGEST_LOG_SCALE, LARGEST_LOG_SCALE), "sh": (-SH_RANGE / 2, SH_RANGE / 2)}
"""What its numbers reach to."""


def read_compressed(body: PlyBody, vertex: PlyElement, progress: Progress, room: float) -> Gaussians:
    """The splats of a file whose vertices are packed. Raises InputError and Cancelled."""
    path, elements = body.path, body.header.elements
    chunk, sh_element = elements.get("chunk"), elements.get("sh")
    if chunk is None or not set(BOUNDS) <= set(scalar_types(chunk)):
        raise InputError(f"{path}: is packed, and the bounds of its chunks are missing; export it again")
    if any(scalar_types(vertex).get(name) != np.uint32 for name in PACKED):
        raise InputError(f"{path}: {', '.join(PACKED)} must all be there and uint; export the scene again")
    if chunk.count < -(-vertex.count // CHUNK):
        raise InputError(
            f"{path}: {vertex.count:,} splats need {-(-vertex.count // CHUNK):,} chunks, and there are "
            f"{chunk.count:,}: it is damaged; export it again"
        )
    body.check_size(list(elements.values())[-1])
    check_room(path, vertex.count, 3 if sh_element is not None else 0, room)
    coloured = set(COLOUR_BOUNDS) <= set(scalar_types(chunk))
    bounds = np.empty((chunk.count, 18 if coloured else 12), np.float32)
    names = BOUNDS + COLOUR_BOUNDS if coloured else BOUNDS
    rest_names = [f"f_rest_{i}" for i in range(len(sh_element.properties))] if sh_element is not None else []
    if sh_element is not None:
        types = scalar_types(sh_element)
        if len(rest_names) not in (0, 9, 24, 45) or any(types.get(name) != np.uint8 for name in rest_names):
            raise InputError(f"{path}: its element sh makes no whole bands of bytes; export the scene again")
        if sh_element.count != vertex.count:
            raise InputError(
                f"{path}: SH of {sh_element.count:,} splats, and there are {vertex.count:,}: it is damaged"
            )

    def no_rest(start: int, stop: int) -> np.ndarray:
        return np.empty((stop - start, 0), np.uint8)

    words, rest = no_rest, no_rest
    for element in elements.values():
        if element is chunk:
            body.read_rows(chunk, [Target(names=names, array=bounds)], progress.part(0.0, 0.0))
        elif element is vertex:
            words = body.row_reader(vertex, PACKED, np.uint32)
        elif sh_element is not None and element is sh_element and rest_names:
            rest = body.row_reader(sh_element, rest_names, np.uint8)
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.decoding import decode_compressed_ply

    arrays = empty_arrays(vertex.count, SH_COEFFICIENTS.index(len(rest_names) // 3 + 1))
    rows = rows_of(arrays)

    def decode(start: int, stop: int) -> None:
        # Read piece by piece: what has just been read is in the cache, and needs no memory of its own.
        piece = words(start, stop), rest(start, stop)
        decode_compressed_ply(start, stop, bounds, *piece, SHARES, (QUAT_LEVELS, LOGITS, SH_LEVELS), rows)

    over_splats(decode, vertex.count, progress=progress, step=CHUNK)
    return scene_of(arrays, body.header.comments)


SHARES = tuple(np.arange(2**bits) / (2**bits - 1) for bits in (11, 10, 8))
"""Whole numbers of so many bits as shares of the largest, float64."""

QUAT_LEVELS = (np.arange(1024) * np.float64(np.float32(2 / 1023)) - 1).astype(np.float32) * SQRT_HALF
"""Component of a quaternion for each number of 10 bits."""

SH_LEVELS = np.concatenate([[-128.0], np.arange(1, 255) - 127.5, [128.0]]).astype(np.float32) / np.float32(32)
"""SH coefficient of each byte: the middle of its step, but for the two ends."""


def sky_last(means: np.ndarray, order: np.ndarray) -> np.ndarray:
    """`order` (M,) of the splats at means (N, 3), with those of a sky behind the others: a chunk that holds
    both keeps places in steps of the sky's. Along the Z-curve alone many do: 33.5 and 34.1 dB for a landscape
    of 60,000 splats under 2,400 of sky. To leave the faintest splats for the one chunk that still does brings
    0.01 dB."""
    far = in_sky(means)[order]
    return np.concatenate([order[~far], order[far]]) if far.any() else order


def save_compressed(gaussians: Gaussians, path: Path, progress: Progress) -> None:
    """Writes chunks of 18 numbers, packed splats, and SH where there are any.

    Raises:
        InputError: the system refuses.
        Cancelled: nobody waits for it any more.
    """
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.encoding import encode_compressed_ply

    progress.check()
    order = sky_last(gaussians.means, storable_in_z_order(gaussians))
    n, per_channel = len(order), SH_COEFFICIENTS[gaussians.sh_degree] - 1
    chunks = -(-n // CHUNK)
    bounds, words = np.empty((chunks, 18), np.float32), np.empty((n, 4), np.uint32)
    rest = np.empty((n, 3 * per_channel), np.uint8)
    over_splats(
        encode_compressed_ply,
        n,
        *(order, arrays_of(gaussians), (LARGEST_LOG_SCALE, SH_RANGE), bounds, words, rest),
        progress=progress.part(0.3, 0.9),
        step=CHUNK,
    )
    elements = [
        PlyElement("chunk", [PlyProperty(name, "f4") for name in (*BOUNDS, *COLOUR_BOUNDS)], chunks),
        PlyElement("vertex", [PlyProperty(name, "u4") for name in PACKED], n),
    ]
    if per_channel:
        elements.append(
            PlyElement("sh", [PlyProperty(f"f_rest_{i}", "u1") for i in range(3 * per_channel)], n)
        )
    with atomic_write(path) as file:
        file.write(header_text(elements, gaussians.comments, path))
        for table in (bounds.astype("<f4", copy=False), words.astype("<u4", copy=False), rest):
            progress.check()
            file.write(table.data)
