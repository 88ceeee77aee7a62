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
    SLICE,
    SQRT_HALF,
    check_room,
    empty_arrays,
    opacity_levels,
    smallest_three,
    storable_in_z_order,
)
from splatview.scene.formats.ply_body import PlyBody, Target
from splatview.scene.formats.ply_header import header_text, scalar_types
from splatview.scene.gaussians import SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress
from splatview.scene.sh import SH_C0

CHUNK = 256

BOUNDS = tuple(f"{end}_{what}{axis}" for what in ("", "scale_") for end in ("min", "max") for axis in "xyz")
COLOUR_BOUNDS = tuple(f"{end}_{channel}" for end in ("min", "max") for channel in "rgb")
PACKED = ("packed_position", "packed_rotation", "packed_scale", "packed_color")

BITS = ((21, 11), (11, 10), (0, 11))
"""(shift, bits) of x, y and z of positions and of scales."""

LARGEST_LOG_SCALE = 20.0
"""Log-scales are kept within ± this: -inf would spoil the bounds of a chunk."""

SH_RANGE = 8.0
"""Width of the range of coefficients, about 0."""


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
    words = np.empty((vertex.count, 4), np.uint32)
    names = list(BOUNDS + COLOUR_BOUNDS if coloured else BOUNDS)
    wanted = {"chunk": Target(names=names, array=bounds), "vertex": Target(names=PACKED, array=words)}
    rest = np.empty((vertex.count, 0), np.uint8)
    if sh_element is not None:
        rest_names = [f"f_rest_{i}" for i in range(len(sh_element.properties))]
        types = scalar_types(sh_element)
        if len(rest_names) not in (0, 9, 24, 45) or any(types.get(name) != np.uint8 for name in rest_names):
            raise InputError(f"{path}: its element sh makes no whole bands of bytes; export the scene again")
        if sh_element.count != vertex.count:
            raise InputError(
                f"{path}: SH of {sh_element.count:,} splats, and there are {vertex.count:,}: it is damaged"
            )
        rest = np.empty((vertex.count, len(rest_names)), np.uint8)
        if rest_names:
            wanted["sh"] = Target(names=rest_names, array=rest)
    read = [element for name, element in elements.items() if name in wanted]
    for i, element in enumerate(read):
        piece = progress.part(0.5 * i / len(read), 0.5 * (i + 1) / len(read))
        body.read_rows(element, [wanted[element.name]], piece)
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.decoding import decode_compressed_ply

    arrays = empty_arrays(vertex.count, SH_COEFFICIENTS.index(rest.shape[1] // 3 + 1))
    tables = (QUAT_LEVELS, LOGITS, SH_LEVELS)
    over_splats(
        decode_compressed_ply,
        vertex.count,
        *(bounds, words, rest, SHARES, tables, tuple(arrays.values())),
        progress=progress.part(0.5, 1.0),
    )
    return Gaussians(**arrays, comments=body.header.comments)


SHARES = tuple(np.arange(2**bits) / (2**bits - 1) for bits in (11, 10))
"""Whole numbers of so many bits as shares of the largest."""

QUAT_LEVELS = (np.arange(1024) * np.float64(np.float32(2 / 1023)) - 1).astype(np.float32) * SQRT_HALF
"""Component of a quaternion for each number of 10 bits."""

SH_LEVELS = ((np.arange(256) + 0.5) / 256 - 0.5).astype(np.float32) * np.float32(SH_RANGE)
"""Coefficient of each byte: the middle of its step, but for the two ends."""
SH_LEVELS[[0, 255]] = -SH_RANGE / 2, SH_RANGE / 2


def save_compressed(gaussians: Gaussians, path: Path, progress: Progress) -> None:
    """Writes chunks of 18 numbers, packed splats, and SH where there are any.

    Raises:
        InputError: the system refuses.
        Cancelled: nobody waits for it any more.
    """
    order = storable_in_z_order(gaussians)
    n, per_channel = len(order), SH_COEFFICIENTS[gaussians.sh_degree] - 1
    chunks = -(-n // CHUNK)
    bounds, words = np.empty((chunks, 18), "<f4"), np.empty((n, 4), "<u4")
    rest = np.empty((n, 3 * per_channel), np.uint8)
    step = SLICE // CHUNK * CHUNK
    for start in range(0, n, step):
        at = order[start : start + step]
        part, out = slice(start, start + len(at)), slice(start // CHUNK, -(-(start + len(at)) // CHUNK))
        scales = np.clip(gaussians.log_scales[at], -LARGEST_LOG_SCALE, LARGEST_LOG_SCALE)
        for first, values in ((0, gaussians.means[at].astype(np.float32)), (6, scales)):
            share = _within_chunks(values, bounds[out], first)
            words[part, first // 3] = sum(
                np.rint(share[:, axis] * (2**bits - 1)).astype(np.uint32) << np.uint32(shift)
                for axis, (shift, bits) in enumerate(BITS)
            )
        rgb = (0.5 + SH_C0 * gaussians.sh[at, 0]).astype(np.float32)
        colour = np.rint(_within_chunks(rgb, bounds[out], 12) * 255).astype(np.uint32)
        opacity = opacity_levels(gaussians.opacity_logits[at]).astype(np.uint32)
        words[part, 3] = colour[:, 0] << 24 | colour[:, 1] << 16 | colour[:, 2] << 8 | opacity
        largest, three = smallest_three(gaussians.quats[at])
        three = np.rint((three + 1) * (1023 / 2)).astype(np.uint32)
        words[part, 1] = largest.astype(np.uint32) << 30 | three[:, 0] << 20 | three[:, 1] << 10 | three[:, 2]
        if per_channel:
            levels = np.floor((gaussians.sh[at, 1:] / np.float32(SH_RANGE) + np.float32(0.5)) * 256)
            rest[part] = np.clip(levels, 0, 255).transpose(0, 2, 1).reshape(len(at), -1)
        progress.step((start + len(at)) / n)
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
        for table in (bounds, words, rest):
            file.write(table.data)


def _within_chunks(values: np.ndarray, bounds: np.ndarray, first: int) -> np.ndarray:
    """Shares (N, 3) of the way from the lowest to the highest value of each chunk; those two go to `bounds`,
    from column `first` on."""
    starts = np.arange(0, len(values), CHUNK)
    low, high = np.minimum.reduceat(values, starts), np.maximum.reduceat(values, starts)
    bounds[:, first : first + 3], bounds[:, first + 3 : first + 6] = low, high
    each = np.arange(len(values)) // CHUNK
    width = np.where(high > low, high - low, np.float32(1))
    return (values - low[each]) / width[each]
