"""An order by depth that serves more frames than the one it was made for.

It is one of all splats, seen or not, so that those that come into view have their place: a frame takes from
it the splats that it sees.
"""

from __future__ import annotations

import numpy as np

from ..scene import Camera, RenderSettings
from ..scene.resorting import Resorting
from .compiling import kernel
from .edited import EditArrays, moved, palette_row
from .parameters import Parameters
from .pool import SPLATS_PER_TASK, TASKS_PER_THREAD, even_ranges, run
from .sort import key_scale, make_keys, radix_sort
from .view import View
from .workspace import Workspace


class KeptOrder:
    """Of the scene drawn last; part of a workspace."""

    def __init__(self) -> None:
        self.resorting = Resorting()
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
            self.resorting.forget()
        key = (settings.model.near, key_bits, None if edits is None else edits.palette.tobytes())
        if self.resorting.due(camera, settings, key=key, centre=self._centre, radius=self._radius):
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
