"""Depth order: one stable radix sort of 32-bit keys (Knuth, TAOCP 3, 5.2.5), least digit first.

A key is the depth's float64 bits, counted from the nearest visible depth and shifted until the farthest
fits into 32 bits. Bits of positive floats are in the order of the floats, so the keys are too; and as
they spend no bits on depths that do not occur, they tell apart depths that agree in float32.
"""

from __future__ import annotations

import math

import numpy as np

from splatview.raster.compiling import SPLATS_PER_TASK, TASKS_PER_THREAD, even_ranges, inline, kernel, run
from splatview.raster.edits import EditArrays, moved, palette_row
from splatview.raster.parameters import Parameters, View
from splatview.scene import Camera, RenderSettings
from splatview.scene.order_reuse import ResortPolicy

# ---- An order by depth that serves more frames than the one it was made for.
#
# It is one of all splats, seen or not, so that those that come into view have their place: a frame takes from
# it the splats that it sees.


class KeptOrder:
    """Of the scene drawn last; part of a workspace."""

    def __init__(self) -> None:
        self.resort_policy = ResortPolicy()
        self._of: tuple[object, ...] = ()
        self._order = np.empty(0, np.int32)
        self._centre, self._radius = np.zeros(3), 0.0

    def begin(
        self,
        splats: Parameters,
        camera: Camera,
        settings: RenderSettings,
        view: View,
        workspace: Workspace,
        *,
        edits: EditArrays | None,
        key_bits: int,
        threads: int,
    ) -> None:
        """Makes the order anew where that is due for the frame that comes."""
        scene = (splats.means, None if edits is None else edits.marks)
        if len(self._of) != len(scene) or any(a is not b for a, b in zip(scene, self._of, strict=True)):
            self._of = scene
            self._centre, self._radius = box_of(splats.means)
            self.resort_policy.forget()
        key = (settings.model.near, key_bits, None if edits is None else edits.palette.tobytes())
        if self.resort_policy.due(camera, settings, key=key, centre=self._centre, radius=self._radius):
            self._order = depth_order(
                splats, view, workspace, edits=edits, key_bits=key_bits, threads=threads
            )

    def seen(
        self, visible: np.ndarray, runs: list[tuple[int, int]], workspace: Workspace, threads: int
    ) -> np.ndarray:
        """The splats of `visible` (N,) in `runs` of it, front to back as they are kept: (V,) int32."""
        count = len(self._order)
        shown = workspace.take("shown", (count,), np.bool_)
        shown[:] = False
        run(_show, runs, (visible, shown), threads)
        pieces = even_ranges(count, threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
        found = run(_count_shown, pieces, (self._order, shown), threads)
        ends = np.cumsum(found).tolist()
        order = workspace.take("order", (ends[-1] if ends else 0,), np.int32)
        tasks = [(*piece, end - number) for piece, end, number in zip(pieces, ends, found, strict=True)]
        run(_take_shown, tasks, (self._order, shown, order), threads)
        return order


def in_kept_order(
    splats: Parameters,
    camera: Camera,
    settings: RenderSettings,
    view: View,
    workspace: Workspace,
    edits: EditArrays | None,
    key_bits: int,
    threads: int,
    visible: np.ndarray,
    runs: list[tuple[int, int]],
) -> np.ndarray:
    """The splats of `visible` (N,) in `runs` of it, (V,) int32, in the workspace's order, made anew first
    where that is due."""
    if workspace.kept_order is None:
        workspace.kept_order = KeptOrder()
    kept = workspace.kept_order
    kept.begin(splats, camera, settings, view, workspace, edits=edits, key_bits=key_bits, threads=threads)
    return kept.seen(visible, runs, workspace, threads)


def depth_order(
    splats: Parameters,
    view: View,
    workspace: Workspace,
    *,
    edits: EditArrays | None,
    key_bits: int,
    threads: int,
) -> np.ndarray:
    """All splats front to back, those behind the near plane first and such without a depth anywhere: (N,)
    int32, not the workspace's."""
    count = len(splats.means)
    if not count:
        return np.empty(0, np.int32)
    depths = workspace.take("all_depths", (count,), np.float64)
    pieces = even_ranges(count, threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
    farthest = max(run(depths_of, pieces, (splats.means, view, edits, depths), threads))
    keys = workspace.take("all_keys", (count,), np.uint32)
    order = np.empty(count, np.int32)
    base, shift, bits = key_scale(view.near, max(farthest, view.near), key_bits)
    everything = np.arange(count, dtype=np.int32)
    tasks = [(start, stop, start) for start, stop in pieces]
    run(make_keys, tasks, (everything, depths.view(np.int64), base, shift, keys, order), threads)
    return radix_sort(keys, order, bits, threads, workspace)[1].copy()


def box_of(means: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and half diagonal of the box of the finite among means (N, 3)."""
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    if not len(finite):
        return np.zeros(3), 0.0
    low, high = finite.min(axis=0), finite.max(axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


@kernel
def depths_of(start, stop, means, view, edits, depths):
    """Writes depths[start:stop] (float64) of all splats, at least the near plane's; returns the greatest."""
    greatest = view.near
    r = view.rotation
    for splat in range(start, stop):
        x, y, z = np.float64(means[splat, 0]), np.float64(means[splat, 1]), np.float64(means[splat, 2])
        if edits is not None:
            entry = palette_row(edits, splat)
            if entry < edits.palette.shape[0]:
                x, y, z = moved(edits.palette[entry], x, y, z)
        x, y, z = x - view.eye[0], y - view.eye[1], z - view.eye[2]
        depth = r[2, 0] * x + r[2, 1] * y + r[2, 2] * z
        # Neither NaN nor infinity is ever drawn.
        depth = depth if view.near <= depth < 1e300 else view.near
        depths[splat] = depth
        greatest = max(greatest, depth)
    return greatest


@kernel
def _show(start, stop, visible, shown):
    for place in range(start, stop):
        shown[visible[place]] = True


@kernel
def _count_shown(start, stop, order, shown):
    found = 0
    for place in range(start, stop):
        found += shown[order[place]]
    return found


@kernel
def _take_shown(start, stop, first, order, shown, taken):
    for place in range(start, stop):
        if shown[order[place]]:
            taken[first] = order[place]
            first += 1


# ---- Buffers that are used again from picture to picture: fresh memory costs a page fault every 4 KiB.


GROWTH = 1.25
"""A buffer that has become too small is replaced by one so much larger than asked for."""


class Workspace:
    """Named buffers that only grow. Belongs to one picture at a time; not for two threads at once."""

    def __init__(self) -> None:
        self._buffers: dict[str, np.ndarray] = {}
        self.kept_order: KeptOrder | None = None
        """Of the picture before, where `RenderSettings.resort_frames` lets it serve more than one."""

    def take(self, name: str, shape: tuple[int, ...], dtype: np.dtype | type) -> np.ndarray:
        """An array with any contents, aligned to a cache line; the one taken before by this name is lost."""
        dtype = np.dtype(dtype)
        size = math.prod(shape) * dtype.itemsize
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < size:
            capacity = size if buffer is None else int(size * GROWTH)
            self._buffers.pop(name, None)
            del buffer
            whole = np.empty(capacity + 64, np.uint8)
            start = -whole.ctypes.data % 64
            buffer = self._buffers[name] = whole[start : start + capacity]
        return buffer[:size].view(dtype).reshape(shape)

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(buffer.nbytes for buffer in self._buffers.values())


DIGIT_BITS = 11
"""At most so many bits a pass: 2048 write positions stay in the first-level caches."""

PARALLEL_FROM = 1 << 15
"""Below so many keys one thread is faster than sharing the work."""


@inline
def _ordered_bits(bits):
    """Bits of a float64 as an int64 that sorts like the float, negative ones included."""
    return bits ^ ((bits >> 63) & 0x7FFFFFFFFFFFFFFF)


def key_scale(least: float, greatest: float, most_bits: int = 32) -> tuple[int, int, int]:
    """(base, shift, bits) for depths in [least, greatest]: key = (ordered bits - base) >> shift < 2^bits,
    bits being at most `most_bits`."""
    low, high = (int(np.float64(depth).view(np.int64)) for depth in (least, greatest))
    low, high = (value ^ ((value >> 63) & 0x7FFFFFFFFFFFFFFF) for value in (low, high))
    span = (high - low).bit_length()
    shift = max(span - most_bits, 0)
    return low, shift, span - shift


@kernel
def make_keys(start, stop, source, visible, depth_bits, base, shift, keys, order):
    """Gathers visible[source:source + stop - start] to order[start:stop] (int32) with their keys (uint32).

    depth_bits (N,) int64: the depths' bits.
    """
    for k in range(start, stop):
        splat = visible[source + k - start]
        order[k] = splat
        keys[k] = np.uint32((_ordered_bits(depth_bits[splat]) - base) >> shift)


@kernel
def _count(start, stop, histogram, keys, shift, mask):
    histogram[:] = 0
    for k in range(start, stop):
        histogram[(keys[k] >> shift) & mask] += 1


@kernel
def _positions(histograms):
    """Turns counts (pieces, digits) int64 into where each piece writes its first key of each digit."""
    total = 0
    for digit in range(histograms.shape[1]):
        for piece in range(histograms.shape[0]):
            count = histograms[piece, digit]
            histograms[piece, digit] = total
            total += count


@kernel
def _scatter(start, stop, positions, keys, values, shift, mask, keys_out, values_out):
    for k in range(start, stop):
        digit = (keys[k] >> shift) & mask
        to = positions[digit]
        positions[digit] = to + 1
        keys_out[to] = keys[k]
        values_out[to] = values[k]


def radix_sort(
    keys: np.ndarray, values: np.ndarray, bits: int, threads: int, workspace: Workspace
) -> tuple[np.ndarray, np.ndarray]:
    """Sorts keys (V,) uint32 below 2^bits ascending, values (V,) int32 along; equal keys keep their order.

    Returns the sorted pair: the arrays given or buffers of the workspace; the others' contents are lost.
    """
    count = len(keys)
    if count < 2 or bits < 1:
        return keys, values
    pieces = even_ranges(count, threads if count >= PARALLEL_FROM else 1)
    passes = -(-bits // DIGIT_BITS)
    width = -(-bits // passes)
    mask = np.uint32((1 << width) - 1)
    positions = np.empty((len(pieces), 1 << width), np.int64)
    keys_out = workspace.take("keys_out", keys.shape, keys.dtype)
    values_out = workspace.take("values_out", values.shape, values.dtype)
    for number in range(passes):
        shift = np.uint32(number * width)
        tasks = [(*piece, row) for piece, row in zip(pieces, positions, strict=True)]
        run(_count, tasks, (keys, shift, mask), threads)
        _positions(positions)
        run(_scatter, tasks, (keys, values, shift, mask, keys_out, values_out), threads)
        keys, keys_out, values, values_out = keys_out, keys, values_out, values
    return keys, values
