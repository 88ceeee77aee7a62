"""Depth order: one stable radix sort of 32-bit keys (Knuth, TAOCP 3, 5.2.5), least digit first.

A key is the depth's float64 bits, counted from the nearest visible depth and shifted until the farthest
fits into 32 bits. Bits of positive floats are in the order of the floats, so the keys are too; and as
they spend no bits on depths that do not occur, they tell apart depths that agree in float32.
"""

from __future__ import annotations

import math
import sys
from typing import NamedTuple

import numpy as np

from splatview.raster.compiling import SPLATS_PER_TASK, TASKS_PER_THREAD, even_ranges, inline, kernel, run
from splatview.raster.edits import EditArrays, moved, palette_row
from splatview.raster.parameters import Parameters, View
from splatview.raster.simd import CACHE_LINE
from splatview.scene import Camera, RenderSettings
from splatview.scene.order_reuse import ResortPolicy

GROWTH = 1.25
"""Size of a buffer that replaces one too small, relative to the size asked for."""


def _unshared() -> int:
    arrays = [np.empty(1)]
    return max(sys.getrefcount(arrays[i]) for i in range(1))


UNSHARED = _unshared()
"""What `sys.getrefcount` says of an array that only a list refers to."""


def empty_at_line(shape: tuple[int, ...], dtype: np.dtype | type) -> np.ndarray:
    """An array with any contents that begins at a cache line."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    whole = np.empty(size + CACHE_LINE, np.uint8)
    start = -whole.ctypes.data % CACHE_LINE
    return whole[start : start + size].view(dtype).reshape(shape)


class Workspace:
    """Named buffers that only grow, as fresh memory costs a page fault every 4 KiB. For one picture at a
    time; not for two threads at once."""

    def __init__(self) -> None:
        self._buffers: dict[str, np.ndarray] = {}
        self._lent: list[np.ndarray] = []

    def lend(self, shape: tuple[int, ...], dtype: np.dtype | type) -> np.ndarray:
        """An array with any contents, the caller's to keep: its memory is lent anew once nothing refers to it
        or to a view of it any more. Fresh memory for a picture of 1280x720 took 8 % of its time."""
        for place in reversed(range(len(self._lent))):
            if sys.getrefcount(self._lent[place]) <= UNSHARED:
                array = self._lent.pop(place)
                if array.shape == shape and array.dtype == dtype:
                    break
        else:
            array = np.empty(shape, dtype)
        self._lent = [*self._lent[-1:], array]
        return array

    def take(self, name: str, shape: tuple[int, ...], dtype: np.dtype | type) -> np.ndarray:
        """An array with any contents, aligned to a cache line; the one taken before by this name is lost."""
        dtype = np.dtype(dtype)
        size = math.prod(shape) * dtype.itemsize
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < size:
            capacity = size if buffer is None else int(size * GROWTH)
            self._buffers.pop(name, None)
            del buffer
            buffer = self._buffers[name] = empty_at_line((capacity,), np.uint8)
        return buffer[:size].view(dtype).reshape(shape)

    @property
    def nbytes(self) -> int:
        """Bytes held, besides those lent."""
        return sum(buffer.nbytes for buffer in self._buffers.values())


class DepthKeys(NamedTuple):
    """Mapping of depths to keys: (ordered bits - base) >> shift, below 2^bits."""

    base: int
    shift: int
    bits: int

    @classmethod
    def spanning(cls, least: float, greatest: float, most_bits: int = 32) -> DepthKeys:
        """Keys of at most `most_bits` bits for depths in [least, greatest]."""
        low, high = (int(np.float64(depth).view(np.int64)) for depth in (least, greatest))
        low, high = (value ^ ((value >> 63) & 0x7FFFFFFFFFFFFFFF) for value in (low, high))
        span = (high - low).bit_length()
        shift = max(span - most_bits, 0)
        return cls(low, shift, span - shift)


@inline
def _ordered_bits(bits):
    """Bits of a float64 as an int64 that sorts like the float, negative ones included."""
    return bits ^ ((bits >> 63) & 0x7FFFFFFFFFFFFFFF)


@kernel
def make_keys(start, stop, source, visible, depth_bits, base, shift, keyed):
    """Writes visible[source:source + stop - start] with their keys to keyed[start:stop], see `radix_sort`.

    depth_bits (N,) int64: the depths' bits.
    """
    for k in range(start, stop):
        splat = visible[source + k - start]
        key = (_ordered_bits(depth_bits[splat]) - base) >> shift
        keyed[k] = (np.uint64(key) << np.uint64(KEY_FROM)) | np.uint64(splat)


KEY_FROM = 32
"""Bits of a keyed value below its key."""

DIGIT_BITS = 11
"""Most bits per pass: 2048 write positions stay in the first-level caches."""

PARALLEL_FROM = 1 << 18
"""Number of keys below which one thread is faster than several: another has to be woken twice for each pass,
which takes as long as 20,000 keys. On two threads 50,000 keys took 1.8 times as long as on one, 100,000 1.7
times, 200,000 0.9 to 1.3 times, 500,000 0.67 times."""


@kernel
def _count(start, stop, histogram, keyed, shift, mask):
    histogram[:] = 0
    for k in range(start, stop):
        histogram[(keyed[k] >> shift) & mask] += 1


@kernel
def _positions(histograms):
    """Turns counts (pieces, digits) int64 into the first write position of each piece and digit."""
    total = 0
    for digit in range(histograms.shape[1]):
        for piece in range(histograms.shape[0]):
            count = histograms[piece, digit]
            histograms[piece, digit] = total
            total += count


@kernel
def _scatter(start, stop, positions, keyed, shift, mask, out):
    for k in range(start, stop):
        digit = (keyed[k] >> shift) & mask
        to = positions[digit]
        positions[digit] = to + 1
        out[to] = keyed[k]


@kernel
def _scatter_values(start, stop, positions, keyed, shift, mask, values):
    for k in range(start, stop):
        digit = (keyed[k] >> shift) & mask
        to = positions[digit]
        positions[digit] = to + 1
        values[to] = np.int32(keyed[k])


def keyed_values(keys: np.ndarray, values: np.ndarray) -> np.ndarray:
    """What `radix_sort` takes, (V,) uint64: keys (V,) uint32 above values (V,) int32 of at least 0."""
    return (keys.astype(np.uint64) << np.uint64(KEY_FROM)) | values.astype(np.uint64)


def radix_sort(keyed: np.ndarray, bits: int, threads: int, workspace: Workspace) -> np.ndarray:
    """Values (V,) int32 by their keys below 2^bits, ascending; equal keys keep their order. A buffer of the
    workspace. keyed as `keyed_values` makes it; its contents are lost.

    A key and its value are one number: of two arrays twice as many places are written to in turn, and the
    sort of 500,000 splats took 1.6 times as long.
    """
    count = len(keyed)
    values = workspace.take("order", (count,), np.int32)
    if count < 2 or bits < 1:
        values[:] = keyed & np.uint64((1 << KEY_FROM) - 1)
        return values
    pieces = even_ranges(count, threads if count >= PARALLEL_FROM else 1)
    passes = -(-bits // DIGIT_BITS)
    width = -(-bits // passes)
    mask = np.uint64((1 << width) - 1)
    positions = np.empty((len(pieces), 1 << width), np.int64)
    out = workspace.take("keyed_out", keyed.shape, keyed.dtype)
    for number in range(passes):
        shift = np.uint64(KEY_FROM + number * width)
        tasks = [(*piece, row) for piece, row in zip(pieces, positions, strict=True)]
        run(_count, tasks, (keyed, shift, mask), threads)
        _positions(positions)
        if number + 1 < passes:
            run(_scatter, tasks, (keyed, shift, mask, out), threads)
            keyed, out = out, keyed
        else:
            run(_scatter_values, tasks, (keyed, shift, mask, values), threads)
    return values


def sorted_by_depth(
    visible: np.ndarray,
    runs: list[tuple[int, int]],
    depths: np.ndarray,
    bounds: tuple[float, float],
    key_bits: int,
    workspace: Workspace,
    threads: int,
) -> np.ndarray:
    """The splats in `runs` (start, stop) of `visible` (N,) int32 front to back by depths (N,) float64, which
    are within `bounds`: (V,) int32, a buffer of the workspace."""
    ends = np.cumsum([stop - start for start, stop in runs]).tolist()
    count = ends[-1] if ends else 0
    keyed = workspace.take("keyed", (count,), np.uint64)
    if not count:
        return workspace.take("order", (0,), np.int32)
    base, shift, bits = DepthKeys.spanning(*bounds, key_bits)
    tasks = [(end - (stop - start), end, start) for (start, stop), end in zip(runs, ends, strict=True)]
    run(make_keys, tasks, (visible, depths.view(np.int64), base, shift, keyed), threads)
    return radix_sort(keyed, bits, threads, workspace)


class ReusableOrder:
    """Depth order of all splats of a scene, visible or not, which serves as many frames as the settings'
    `resort_frames` and `resort_degrees` allow; a frame takes its visible splats from it."""

    def __init__(self) -> None:
        self.resort_policy = ResortPolicy()
        self._scene: tuple[object, ...] = ()
        self._order = np.empty(0, np.int32)
        self._centre, self._radius = np.zeros(3), 0.0

    def visible_order(
        self,
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
        """The splats in `runs` (start, stop) of `visible` (N,) int32, front to back: (V,) int32. All splats
        are sorted first where that is due."""
        scene = (splats.means, None if edits is None else edits.marks)
        if len(self._scene) != len(scene) or any(a is not b for a, b in zip(scene, self._scene, strict=True)):
            self._scene = scene
            self._centre, self._radius = bounding_sphere(splats.means)
            self.resort_policy.forget()
        key = (settings.model.near, key_bits, None if edits is None else edits.palette.tobytes())
        if self.resort_policy.due(camera, settings, key=key, centre=self._centre, radius=self._radius):
            self._order = _scene_order(splats.means, view, workspace, edits, key_bits, threads)
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


def _scene_order(
    means: np.ndarray, view: View, workspace: Workspace, edits: EditArrays | None, key_bits: int, threads: int
) -> np.ndarray:
    """All splats front to back, those behind the near plane first and those without a depth anywhere: (N,)
    int32, not the workspace's."""
    count = len(means)
    depths = workspace.take("all_depths", (count,), np.float64)
    pieces = even_ranges(count, threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
    farthest = max(run(_depths, pieces, (means, view, edits, depths), threads))
    every = np.arange(count, dtype=np.int32)
    bounds = view.near, max(farthest, view.near)
    return sorted_by_depth(every, pieces, depths, bounds, key_bits, workspace, threads).copy()


def bounding_sphere(means: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and half diagonal of the box of the finite among means (N, 3)."""
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    if not len(finite):
        return np.zeros(3), 0.0
    low, high = finite.min(axis=0), finite.max(axis=0)
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2


@kernel
def _depths(start, stop, means, view, edits, depths):
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
