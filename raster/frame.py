"""One picture from start to end: project, sort, bin, draw, each stage shared among threads."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .bins import count_pairs, place_lists, write_pairs
from .forward import draw_tiles
from .parameters import Parameters
from .pool import TASKS_PER_THREAD, even_ranges, run
from .project import RECORD, project
from .sort import key_scale, make_keys, radix_sort
from .view import View
from .workspace import Workspace

SPLATS_PER_TASK = 1024
"""At least so many splats a task of a stage: fewer cost less than handing them out."""

TILE_COST = 16
"""What a tile costs besides its list, in units of pairs; for sharing tiles out evenly."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """What drawing leaves behind; arrays live in the workspace and are valid until its next picture."""

    view: View
    background: np.ndarray
    """(3,) in the picture's dtype."""
    early_stop: float
    sh_degree: int
    image: np.ndarray
    """(H, W, 4), not in the workspace: the caller's to keep."""
    records: np.ndarray
    """(N, RECORD) see `project`; only rows of visible splats mean anything."""
    order: np.ndarray
    """(V,) int32, visible splats front to back."""
    offsets: np.ndarray
    """(tiles + 1,) int64, where the tiles' lists begin."""
    lists: np.ndarray
    """(pairs,) int32, splats by tile, front to back."""
    pieces: list[tuple[int, int]]
    """Runs of `order` that were binned together, and..."""
    positions: np.ndarray
    """(pieces, tiles) int64: ... where each began to write in each tile's list."""
    milliseconds: dict[str, float]
    """Wall-clock time by stage."""


class StageClock:
    """Adds up wall-clock milliseconds by stage."""

    def __init__(self) -> None:
        self.milliseconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        begun = time.perf_counter()
        yield
        elapsed = (time.perf_counter() - begun) * 1000
        self.milliseconds[name] = self.milliseconds.get(name, 0.0) + elapsed


def draw(
    splats: Parameters,
    view: View,
    background: np.ndarray,
    workspace: Workspace,
    *,
    sh_degree: int,
    early_stop: float,
    threads: int,
    keep_positions: bool = False,
) -> Frame:
    """Draws in the dtype of `background` (3,), float32 or float64. Arguments are taken to be valid."""
    clock = StageClock()
    with clock.stage("project"):
        records, runs, least, greatest, depths = _project(
            splats, view, background.dtype, workspace, sh_degree, threads
        )
    with clock.stage("sort"):
        order = _sort(runs, least, greatest, depths, workspace, threads)
    with clock.stage("bin"):
        tiles = view.tiles_x * view.tiles_y
        pieces = even_ranges(len(order), threads * TASKS_PER_THREAD, at_least=SPLATS_PER_TASK)
        positions = workspace.take("positions", (len(pieces), tiles), np.int64)
        offsets = workspace.take("offsets", (tiles + 1,), np.int64)
        run(
            count_pairs,
            [(*piece, order, records, view, row) for piece, row in zip(pieces, positions, strict=True)],
            threads,
        )
        pairs = place_lists(positions, offsets)
        lists = workspace.take("lists", (pairs,), np.int32)
        cursors = workspace.take("cursors", positions.shape, np.int64) if keep_positions else positions
        if keep_positions:
            cursors[:] = positions
        run(
            write_pairs,
            [(*piece, order, records, view, row, lists) for piece, row in zip(pieces, cursors, strict=True)],
            threads,
        )
    with clock.stage("forward"):
        image = np.empty((view.height, view.width, 4), background.dtype)
        stop_below = background.dtype.type(early_stop)
        run(
            draw_tiles,
            [
                (*tile_range, offsets, lists, records, view, background, stop_below, image)
                for tile_range in tile_ranges(offsets, threads * TASKS_PER_THREAD)
            ],
            threads,
        )
    return Frame(
        view=view,
        background=background,
        early_stop=early_stop,
        sh_degree=sh_degree,
        image=image,
        records=records,
        order=order,
        offsets=offsets,
        lists=lists,
        pieces=pieces,
        positions=positions,
        milliseconds=clock.milliseconds,
    )


def _project(splats, view, dtype, workspace, sh_degree, threads):
    count = len(splats.means)
    records = workspace.take("records", (count, RECORD), dtype)
    depths = workspace.take("depths", (count,), np.float64)
    visible = workspace.take("visible", (count,), np.int32)
    ranges = even_ranges(count, threads * TASKS_PER_THREAD, at_least=SPLATS_PER_TASK)
    bounds = np.empty((len(ranges), 2))
    counts = run(
        project,
        [
            (*piece, *splats, sh_degree, view, records, depths, visible, row)
            for piece, row in zip(ranges, bounds, strict=True)
        ],
        threads,
    )
    runs = [(visible, start, found) for (start, _), found in zip(ranges, counts, strict=True)]
    return records, runs, bounds[:, 0].min(), bounds[:, 1].max(), depths


def _sort(runs, least, greatest, depths, workspace, threads):
    count = sum(found for _, _, found in runs)
    keys = workspace.take("keys", (count,), np.uint32)
    order = workspace.take("order", (count,), np.int32)
    if count == 0:
        return order
    base, shift, bits = key_scale(least, greatest)
    tasks, at = [], 0
    for visible, source, found in runs:
        tasks.append((at, at + found, visible, source, depths.view(np.int64), base, shift, keys, order))
        at += found
    run(make_keys, tasks, threads)
    return radix_sort(keys, order, bits, threads, workspace)[1]


def tile_ranges(offsets: np.ndarray, pieces: int) -> list[tuple[int, int]]:
    """Runs of tiles of about equal cost."""
    tiles = len(offsets) - 1
    cost = offsets + np.arange(tiles + 1) * TILE_COST
    edges = np.searchsorted(cost, np.linspace(0, cost[-1], max(1, min(pieces, tiles)) + 1))
    edges[0], edges[-1] = 0, tiles
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]
