"""Numbers in few bits, as several formats keep them: the one place that rounds them.

Everything is rounded to the nearest step, so that an error is at most half of one. Encoders take values as
`Gaussians` has them; what no file of few bits can hold (NaN, infinity) is for `storable` to leave out.
"""

from __future__ import annotations

import io
import json
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from splatview.scene.errors import InputError, bytes_in_words
from splatview.scene.formats.io import physical_memory
from splatview.scene.gaussians import ARRAYS, SH_COEFFICIENTS, Gaussians
from splatview.scene.progress import Progress
from splatview.scene.projection import sigmoid

SQRT_HALF = np.float32(np.sqrt(0.5))

SLICE = 1 << 17
"""Splats at a time: what is computed of them stays in the second-level cache, and cancelling takes effect
soon."""

LEAST_OPACITY = 1e-6
"""Opacities of 0 and 1 have no finite logit: they are read as this, and as 1 less this."""

MOST_EXPANSION = 4
"""Most that packed splats grow by when they are unpacked, above ALWAYS_ALLOWED: their low bits are noise, so
real ones grow to two or three times, and to five where all SH are zeros."""

ALWAYS_ALLOWED = 1 << 28
"""Bytes that any file may grow by besides: 22 million splats of SH that are all zeros are read so. It is what
a file that was made to fill the memory costs at most, with the scene that is made of it, which is 2.8 (degree
0) to 3.7 times (degree 3) as large. Nothing is made on a header's word: first all bytes are unpacked."""


def storable(gaussians: Gaussians) -> np.ndarray:
    """(N,) bool: splats whose every value is finite as float32 and whose quaternion has a length. No renderer
    draws the others, but for log-scales of -inf."""
    return _storable(gaussians)[0]


def _storable(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Also the bounds (3,) of the means of those, low and high, float64."""
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.encoding import find_storable

    kept = np.zeros(len(gaussians), bool)
    found = over_splats(find_storable, len(gaussians), arrays_of(gaussians), kept)
    bounds = np.array([[np.inf] * 3 + [-np.inf] * 3, *found])
    return kept, bounds[:, :3].min(axis=0), bounds[:, 3:].max(axis=0)


def arrays_of(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    """The arrays of a scene, each in one piece: views of others would be compiled for once more."""
    return tuple(np.ascontiguousarray(getattr(gaussians, name)) for name in ARRAYS)


def unit_quats(quats: np.ndarray) -> np.ndarray:
    """(N, 4) of length 1, float32; zeros stay zeros."""
    # By the largest component first: squares of 1e-30 vanish, those of 1e30 overflow.
    largest = np.abs(quats).max(axis=1, keepdims=True, initial=0.0)
    scaled = quats / np.where(largest > 0, largest, 1)
    length = np.sqrt(np.einsum("ni,ni->n", scaled, scaled))[:, None]
    return (scaled / np.where(length > 0, length, 1)).astype(np.float32)


REST = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])
"""Columns that are left when one of four is taken out."""


def smallest_three(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 4) quaternions, in any order of components -> the index (N,) of the largest component and the other
    three (N, 3) in order, in [-1, 1] of their range ±sqrt(½), the largest made positive."""
    unit = unit_quats(quats)
    largest = np.abs(unit).argmax(axis=1)
    rows = np.arange(len(unit))
    sign = np.where(unit[rows, largest] < 0, np.float32(-1), np.float32(1))
    rest = unit[rows[:, None], REST[largest]] * (sign / SQRT_HALF)[:, None]
    return largest, np.clip(rest, -1, 1)


def opacity_levels(logits: np.ndarray, levels: int = 255) -> np.ndarray:
    """(N,) logits -> opacities as whole numbers, 0 to `levels`."""
    return np.rint(sigmoid(logits.astype(np.float64)) * levels)


def logits_of(opacities: np.ndarray) -> np.ndarray:
    """(N,) opacities in [0, 1] -> logits float32, finite for 0 and 1 as well."""
    inside = np.clip(opacities.astype(np.float64), LEAST_OPACITY, 1 - LEAST_OPACITY)
    return (np.log(inside) - np.log1p(-inside)).astype(np.float32)


LOGITS = logits_of(np.arange(256) / 255)
"""Logit of an opacity in a byte."""


def empty_arrays(count: int, degree: int) -> dict[str, np.ndarray]:
    """Arrays of `Gaussians` for so many splats, float32, to be filled.

    Tried in vain: that they begin and end with pages of 2 MiB, which numpy has in between; one piece of
    memory for all; clearing it while a thread has nothing to unpack. Each took 1 to 4 % off the time of
    reading 500,000 splats, less than its spread.
    """
    shapes = {"means": (3,), "quats": (4,), "log_scales": (3,), "opacity_logits": ()}
    shapes |= {"sh": (SH_COEFFICIENTS[degree], 3)}
    return {name: np.empty((count, *shape), np.float32) for name, shape in shapes.items()}


def rows_of(arrays: dict[str, np.ndarray]) -> tuple[np.ndarray, ...]:
    """`empty_arrays` as kernels fill them: SH as rows (N, 3 x coefficients)."""
    shape = len(arrays["sh"]), 3 * arrays["sh"].shape[1]
    return (*(arrays[name] for name in ARRAYS[:-1]), arrays["sh"].reshape(shape))


def scene_of(arrays: dict[str, np.ndarray], comments: tuple[str, ...] = ()) -> Gaussians:
    """The scene of `empty_arrays` that were filled."""
    means, quats, log_scales, opacity_logits, sh = (arrays[name] for name in ARRAYS)
    return Gaussians(
        means=means,
        quats=quats,
        log_scales=log_scales,
        opacity_logits=opacity_logits,
        sh=sh,
        comments=comments,
    )


def slices(count: int) -> Iterator[slice]:
    """[0, count) in pieces, of which something is computed without a copy of the scene."""
    return (slice(start, min(start + SLICE, count)) for start in range(0, count, SLICE))


def in_slices(indices: np.ndarray) -> Iterator[np.ndarray]:
    """`indices` in such pieces."""
    return (indices[part] for part in slices(len(indices)))


def storable_in_z_order(gaussians: Gaussians) -> np.ndarray:
    """(M,) indices of the splats that are storable, as `in_z_order` has them."""
    good, low, high = _storable(gaussians)
    return in_z_order(gaussians.means, np.flatnonzero(good), low, high)


def in_z_order(means: np.ndarray, indices: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(M,) `indices` of means (N, 3) between `low` and `high`, sorted in place along a Z-curve of 2^21 steps
    a side: neighbours in space stand near each other in the file, which codecs of pictures and of streams
    profit from."""
    from splatview.scene.formats.kernels.compiling import over_splats
    from splatview.scene.formats.kernels.encoding import morton_keys, sort_by_keys

    scale = (2**21 - 1) / np.where(high > low, high - low, 1)
    keys = np.empty(len(indices), np.uint64)
    over_splats(morton_keys, len(indices), np.ascontiguousarray(means), indices, low, scale, keys)
    sort_by_keys(keys, indices, np.empty_like(keys), np.empty_like(indices))
    return indices


def check_expansion(path: Path, promised: int, held: int) -> None:
    """Raises InputError where `held` bytes of a file say that they are `promised` bytes of splats, which no
    codec makes so small: a damaged count, or a file made to fill the memory."""
    if promised > MOST_EXPANSION * held + ALWAYS_ALLOWED:
        raise InputError(
            f"{path}: {held:,} bytes that promise {promised:,} bytes of splats: it is damaged, or made to "
            "fill the memory; export it again"
        )


def gunzipped(file: io.BufferedReader, path: Path, most: int, progress: Progress) -> np.ndarray:
    """The content of a gzip file as bytes, of which at most `most` are unpacked: more is none of its splats.
    Raises InputError where it is damaged, and Cancelled."""
    inflate, at = zlib.decompressobj(wbits=31), 0
    content = np.empty(most, np.uint8)  # pages that are not written to are not taken
    try:
        while at < most and not inflate.eof and (packed := inflate.unconsumed_tail or file.read(1 << 18)):
            progress.check()
            part = inflate.decompress(packed, min(most - at, 1 << 20))
            content[at : at + len(part)] = np.frombuffer(part, np.uint8)
            at += len(part)
    except zlib.error as error:
        raise InputError(f"{path}: is damaged ({error}); copy or export it again") from None
    return content[:at]


MOST_JSON_VALUES = 1 << 20
"""Values of a description: lists of nothing take 20 times their text as Python's objects. One of a scene has
some hundred, the tree of a streamed one 20 for each of its parts."""


def parsed_json(text: bytes, path: Path, what: str) -> Any:
    """The content of the description `what`. Raises InputError."""
    if text.count(b",") + text.count(b"[") + text.count(b"{") > MOST_JSON_VALUES:
        raise InputError(f"{path}: {what} lists more than any scene needs: it is damaged")
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: {what} is no JSON ({error}); export it again") from None


def check_room(path: Path, count: int, degree: int, room: float) -> None:
    """Raises InputError where so many splats of an SH degree do not fit into `room` bytes, or into memory. To
    be called before memory is taken."""
    needed, free = count * 4 * (11 + 3 * SH_COEFFICIENTS[degree]), min(room, physical_memory())
    if not needed <= free:
        raise InputError(
            f"{path}: {count:,} splats need {bytes_in_words(needed)} of memory, and there are "
            f"{bytes_in_words(free)} for them; thin the scene out elsewhere first"
        )


def too_short(path: Path, wanted: str) -> InputError:
    """What to say of a file that ends before `wanted`."""
    return InputError(f"{path}: ends before {wanted}: it is truncated or damaged; copy or export it again")
