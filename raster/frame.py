"""One picture from start to end: project, sort, bin, draw, each stage shared among threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise

import numba
import numpy as np

from splatview.raster.camera_models import PINHOLE, Optics, make_optics
from splatview.raster.compiling import SPLATS_PER_TASK, TASKS_PER_THREAD, cache_stamp, even_ranges, run
from splatview.raster.edits import EditArrays
from splatview.raster.forward import TILE_PIXELS, Retirement, draw_tiles, make_retirement
from splatview.raster.forward_per_pixel import draw_tiles_by_pixel
from splatview.raster.parameters import NonzeroBands, Parameters, View, nonzero_bands
from splatview.raster.project import RECORD, project
from splatview.raster.simd import LANES
from splatview.raster.sort import Workspace, key_scale, make_keys, radix_sort
from splatview.raster.surfels import DISC, DiscArrays, DiscModel, make_discs
from splatview.raster.tiles import count_pairs, count_rows, find_spans, place_lists, write_pairs
from splatview.scene import Camera, Gaussians, RenderSettings

TILE_COST = 16
"""What a tile costs besides its list, in units of pairs; for sharing tiles out evenly."""

MAX_LISTED_PAIRS = 1 << 27
"""Pairs whose lists are in memory at once, 4 bytes each; a picture with more is drawn band by band."""


Runs = list[tuple[int, int]]
"""(start, stop) each."""


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


@dataclass(frozen=True, eq=False, kw_only=True)
class Bins:
    """Lists of splats by tile; arrays live in a workspace. See `bins`."""

    order: np.ndarray
    """(V,) int32, visible splats front to back."""
    spans_of: np.ndarray
    """(N, 2) int32"""
    spans: np.ndarray
    """(S, 2) int32"""
    pieces: list[tuple[int, int]]
    """Runs of `order` that are binned together, and..."""
    positions: np.ndarray
    """(pieces, tiles) int64: ... where each begins to write in each tile's list."""
    offsets: np.ndarray
    """(tiles + 1,) int64, where the tiles' lists begin; the last is the number of pairs."""
    bands: list[tuple[int, int]]
    """Runs of tiles whose lists are in memory at once; nearly always there is one."""
    threads: int

    def write(self, band: tuple[int, int], workspace: Workspace) -> np.ndarray:
        """The lists of a band's tiles: (pairs,) int32, the first being place `offsets[band[0]]`."""
        first, end = band
        base = int(self.offsets[first])
        lists = workspace.take("lists", (int(self.offsets[end]) - base,), np.int32)
        cursors = workspace.take("cursors", self.positions.shape, np.int64)
        cursors[:] = self.positions
        run(
            write_pairs,
            [(*piece, row) for piece, row in zip(self.pieces, cursors, strict=True)],
            (self.order, self.spans_of, self.spans, first, end, base, lists),
            self.threads,
        )
        return lists


@dataclass(frozen=True, eq=False, kw_only=True)
class Arrangement:
    """Projected, sorted and binned; fields as in `Frame`."""

    records: np.ndarray
    depths: np.ndarray
    """(N,) float64, of the means of visible splats."""
    discs: DiscArrays | None
    pieces: Runs
    runs: Runs
    visible: np.ndarray
    bins: Bins


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame:
    """What drawing leaves behind. All but the image lives in the workspace until its next picture."""

    view: View
    optics: Optics
    background: np.ndarray
    """(3,) in the picture's dtype."""
    retirement: Retirement
    sh_degree: int
    threads: int
    edited: bool
    """Drawn with edits in force: not what `differentiate` can take."""
    by_pixel: bool
    """Drawn in per-pixel order: nor this."""
    image: np.ndarray
    """(H, W, 4), the caller's to keep."""
    transmittance: np.ndarray
    """(tiles·TILE_PIXELS,), the light that got through each pixel, and..."""
    n_contrib: np.ndarray
    """... how many splats of its tile's list it met: see `forward.draw_tiles`."""
    records: np.ndarray
    """(N, RECORD), see `project`; only rows of visible splats mean anything."""
    discs: DiscArrays | None
    """Where splats are flat: then `differentiate` cannot take it either."""
    pieces: Runs
    """(start, stop) of the splats that were projected together, and..."""
    runs: Runs
    """... (start, stop) in `visible` of what was found visible in each."""
    visible: np.ndarray
    """(N,) int32, see `runs`."""
    bins: Bins
    lists: np.ndarray
    """(pairs,) int32 of the last band."""
    pixel_splats: int
    """Alphas evaluated: of a splat, those of all pixels of the blocks that it reaches."""
    workspace: Workspace
    milliseconds: dict[str, float]
    """Wall-clock time by stage."""


def draw(
    splats: Parameters,
    view: View,
    background: np.ndarray,
    workspace: Workspace,
    *,
    sh_degree: int,
    early_stop: float,
    threads: int,
    optics: Optics = PINHOLE,
    discs: DiscModel | None = None,
    edits: EditArrays | None = None,
    nonzero: NonzeroBands | None = None,
    key_bits: int = 32,
    order_of: Callable[[np.ndarray, Runs], np.ndarray] | None = None,
    slopes_of: Callable[[np.ndarray], np.ndarray] | None = None,
) -> Frame:
    """Draws in the dtype of `background` (3,), float32 or float64. Arguments are taken to be valid.

    `order_of` puts what is found visible (N,), in runs, in order, where no new order is to be made.
    `nonzero`: the bands that are, where that is known. `slopes_of` makes `per_pixel.depth_slopes` of visible
    splats, for a picture in per-pixel order.
    """
    clock = StageClock()
    dtype = background.dtype
    arranged = arrange(
        splats,
        view,
        dtype,
        workspace,
        sh_degree=sh_degree,
        threads=threads,
        optics=optics,
        discs=discs,
        edits=edits,
        nonzero=nonzero,
        clock=clock,
        key_bits=key_bits,
        order_of=order_of,
    )
    bins, image = arranged.bins, np.empty((view.height, view.width, 4), dtype)
    retirement = make_retirement(early_stop, dtype)
    slopes = None
    if slopes_of is not None:
        with clock.stage("slopes"):
            # Discs are met at depths of their own.
            slopes = slopes_of(bins.order) if arranged.discs is None else np.empty((0, 2))
    pixels = view.tiles_x * view.tiles_y * TILE_PIXELS if slopes is None else 0
    transmittance = workspace.take("lights", (pixels,), dtype)
    n_contrib = workspace.take("n_contrib", (pixels,), dtype)
    lists = np.empty(0, np.int32)
    evaluated = 0
    for band in bins.bands:
        with clock.stage("bin"):
            lists = bins.write(band, workspace)
        with clock.stage("forward"):
            shared = (bins.offsets, int(bins.offsets[band[0]]), lists, arranged.records, arranged.discs, view)
            ranges = tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD)
            if slopes is None:
                more = (background, retirement, image, transmittance, n_contrib)
                evaluated += LANES * sum(run(draw_tiles, ranges, (*shared, *more), threads))
            else:
                more = (arranged.depths, slopes, background, retirement.stop_below, image)
                evaluated += sum(run(draw_tiles_by_pixel, ranges, (*shared, *more), threads))
    return Frame(
        view=view,
        optics=optics,
        background=background,
        retirement=retirement,
        sh_degree=sh_degree,
        threads=threads,
        edited=edits is not None,
        by_pixel=slopes is not None,
        image=image,
        transmittance=transmittance,
        n_contrib=n_contrib,
        records=arranged.records,
        discs=arranged.discs,
        pieces=arranged.pieces,
        runs=arranged.runs,
        visible=arranged.visible,
        bins=bins,
        lists=lists,
        pixel_splats=evaluated,
        workspace=workspace,
        milliseconds=clock.milliseconds,
    )


def arrange(
    splats: Parameters,
    view: View,
    dtype: np.dtype,
    workspace: Workspace,
    *,
    sh_degree: int,
    threads: int,
    optics: Optics,
    discs: DiscModel | None,
    edits: EditArrays | None,
    clock: StageClock,
    nonzero: NonzeroBands | None = None,
    key_bits: int = 32,
    order_of: Callable[[np.ndarray, Runs], np.ndarray] | None = None,
) -> Arrangement:
    """All that comes before pixels: project, sort, bin."""
    with clock.stage("project"):
        pieces = even_ranges(len(splats.means), threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
        rows = None
        if discs is not None:
            rows = DiscArrays(workspace.take("discs", (len(splats.means), DISC), dtype), *discs)
        records, depths, visible, runs, bounds = _project(
            splats, pieces, view, optics, rows, dtype, workspace, sh_degree, threads, edits, nonzero
        )
    with clock.stage("sort"):
        if order_of is None:
            order = _sort(runs, bounds, visible, depths, workspace, threads, key_bits)
        else:
            order = order_of(visible, runs)
    with clock.stage("bin"):
        bins = _bin(order, runs, visible, records, view, workspace, threads)
    return Arrangement(
        records=records, depths=depths, discs=rows, pieces=pieces, runs=runs, visible=visible, bins=bins
    )


def _project(
    splats: Parameters,
    pieces: Runs,
    view: View,
    optics: Optics,
    discs: DiscArrays | None,
    dtype: np.dtype,
    workspace: Workspace,
    sh_degree: int,
    threads: int,
    edits: EditArrays | None,
    nonzero: NonzeroBands | None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, Runs, tuple[float, float]]:
    count = len(splats.means)
    records = workspace.take("records", (count, RECORD), dtype)
    depths = workspace.take("depths", (count,), np.float64)
    visible = workspace.take("visible", (count,), np.int32)
    bounds = np.empty((len(pieces), 2))
    own_degrees = None
    if nonzero is not None:
        sh_degree, own_degrees = min(sh_degree, nonzero.in_use), nonzero.own_degrees
    found = run(
        project,
        [(*piece, row) for piece, row in zip(pieces, bounds, strict=True)],
        (*splats, sh_degree, view, optics, records, depths, visible, edits, discs, own_degrees),
        threads,
    )
    if min(found) < 0:
        raise ValueError("edits.marks names an adjustment that is not in edits.palette")
    runs = [(start, start + number) for (start, _), number in zip(pieces, found, strict=True)]
    return records, depths, visible, runs, (float(bounds[:, 0].min()), float(bounds[:, 1].max()))


def _sort(
    runs: Runs,
    bounds: tuple[float, float],
    visible: np.ndarray,
    depths: np.ndarray,
    workspace: Workspace,
    threads: int,
    key_bits: int,
) -> np.ndarray:
    count = sum(stop - start for start, stop in runs)
    keys = workspace.take("keys", (count,), np.uint32)
    order = workspace.take("order", (count,), np.int32)
    if count == 0:
        return order
    base, shift, bits = key_scale(*bounds, key_bits)
    ends = np.cumsum([stop - start for start, stop in runs]).tolist()
    tasks = [(end - (stop - start), end, start) for (start, stop), end in zip(runs, ends, strict=True)]
    run(make_keys, tasks, (visible, depths.view(np.int64), base, shift, keys, order), threads)
    return radix_sort(keys, order, bits, threads, workspace)[1]


def _bin(
    order: np.ndarray,
    runs: Runs,
    visible: np.ndarray,
    records: np.ndarray,
    view: View,
    workspace: Workspace,
    threads: int,
) -> Bins:
    rows = run(count_rows, runs, (visible, records, view.tiles_y), threads)
    ends = np.cumsum(rows).tolist()
    spans = workspace.take("spans", (ends[-1], 2), np.int32)
    spans_of = workspace.take("spans_of", (len(records), 2), np.int32)
    run(
        find_spans,
        [(*piece, end - count) for piece, end, count in zip(runs, ends, rows, strict=True)],
        (visible, records, view, spans, spans_of),
        threads,
    )
    tiles = view.tiles_x * view.tiles_y
    pieces = even_ranges(len(order), threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
    positions = workspace.take("positions", (len(pieces), tiles), np.int64)
    offsets = workspace.take("offsets", (tiles + 1,), np.int64)
    run(
        count_pairs,
        [(*piece, row) for piece, row in zip(pieces, positions, strict=True)],
        (order, spans_of, spans),
        threads,
    )
    place_lists(positions, offsets)
    return Bins(
        order=order,
        spans_of=spans_of,
        spans=spans,
        pieces=pieces,
        positions=positions,
        offsets=offsets,
        bands=bands_of(offsets, MAX_LISTED_PAIRS),
        threads=threads,
    )


def bands_of(offsets: np.ndarray, most_pairs: int) -> list[tuple[int, int]]:
    """Runs of tiles that together have at most so many pairs, or are one tile."""
    bands, first, tiles = [], 0, len(offsets) - 1
    while first < tiles:
        end = int(np.searchsorted(offsets, offsets[first] + most_pairs, side="right")) - 1
        end = min(max(end, first + 1), tiles)
        bands.append((first, end))
        first = end
    return bands


def tile_ranges(offsets: np.ndarray, band: tuple[int, int], pieces: int) -> list[tuple[int, int]]:
    """Runs of a band's tiles of about equal cost."""
    first, end = band
    cost = offsets[first : end + 1] - offsets[first] + np.arange(end - first + 1) * TILE_COST
    edges = np.searchsorted(cost, np.linspace(0, cost[-1], max(1, min(pieces, end - first)) + 1)) + first
    edges[0], edges[-1] = first, end
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]


# ---- Which machine code a picture needs: kernels are compiled by the kinds of their arguments.


def kind_of(gaussians: Gaussians, camera: Camera, settings: RenderSettings, *, edited: bool = False) -> str:
    """Pictures of one kind take the same machine code; different for other versions of this program.

    `edited`: edits are in force.
    """
    own_degrees = nonzero_bands(gaussians).own_degrees is not None
    parts = (
        cache_stamp(),
        gaussians.means.dtype.name,
        str(numba.typeof(make_optics(camera))),
        make_discs(camera, settings.model) is not None,
        edited,
        own_degrees,
        settings.order == "per-pixel",
    )
    return "cpu " + " ".join(str(part) for part in parts)
