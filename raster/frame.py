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
from splatview.raster.forward import TILE_PIXELS, Termination, draw_tiles, make_termination
from splatview.raster.forward_per_pixel import draw_tiles_by_pixel
from splatview.raster.parameters import NonzeroBands, Parameters, View, nonzero_bands
from splatview.raster.project import RECORD, project
from splatview.raster.simd import BLOCK_LANES
from splatview.raster.sort import Workspace, sorted_by_depth
from splatview.raster.surfels import SURFEL, SurfelArrays, SurfelModel, make_surfels
from splatview.raster.tiles import SPARE, find_rows, find_spans, place_lists, sum_rows, write_pairs
from splatview.scene import Camera, Gaussians, RenderSettings

TILE_COST = 16
"""Cost of a tile besides its list, in pairs; for sharing tiles out evenly."""

MAX_LISTED_PAIRS = 1 << 27
"""Pairs whose lists are in memory at once, 4 bytes each; a picture with more is drawn band by band."""

Runs = list[tuple[int, int]]
"""(start, stop) each."""

Repaint = Callable[[np.ndarray, np.ndarray, np.ndarray, Runs], None]
"""Of records (N, RECORD), depths (N,), and visible (N,) in runs; see `Arrangement`."""


class StageClock:
    """Wall-clock milliseconds by stage, added up."""

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
    """Lists of splats by tile, see `tiles`. The arrays live in the workspace."""

    order: np.ndarray
    """(V,) int32, visible splats front to back."""
    runs: np.ndarray
    """(V, 2) int32, the spans of splats in that order, see `tiles.find_spans`."""
    spans: np.ndarray
    """(S, 2) int32, first and one past the last tile of each span."""
    pieces: Runs
    """Parts of `order` that are binned together."""
    positions: np.ndarray
    """(pieces, tiles) int64, where each piece begins to write in each tile's list."""
    offsets: np.ndarray
    """(tiles + 1,) int64, where the tiles' lists begin; the last is the number of pairs."""
    bands: Runs
    """Tiles whose lists are in memory at once; nearly always there is one band."""
    threads: int

    def write(self, band: tuple[int, int], workspace: Workspace) -> np.ndarray:
        """The lists of a band's tiles: (pairs,) int32, the first at place `offsets[band[0]]`."""
        first, end = band
        base = int(self.offsets[first])
        lists = workspace.take("lists", (int(self.offsets[end]) - base,), np.int32)
        cursors = workspace.take("cursors", self.positions.shape, np.int32)
        np.subtract(self.positions, base, out=cursors, casting="unsafe")  # those of other bands mean nothing
        run(
            write_pairs,
            [(*piece, row) for piece, row in zip(self.pieces, cursors, strict=True)],
            (self.order, self.runs, self.spans, first, end, lists),
            self.threads,
        )
        return lists


@dataclass(frozen=True, eq=False, kw_only=True)
class Arrangement:
    """A picture's splats, projected, sorted and binned. The arrays live in the workspace until its next
    picture."""

    records: np.ndarray
    """(N, RECORD), see `project`; only rows of visible splats mean anything."""
    depths: np.ndarray
    """(N,) float64, camera depths of the means of visible splats, world units."""
    surfels: SurfelArrays | None
    """Footprints of flat splats, where the image model has surfels."""
    pieces: Runs
    """Splats that were projected together."""
    runs: Runs
    """By piece, the part of `visible` that lists its visible splats."""
    visible: np.ndarray
    """(N,) int32, indices of visible splats; see `runs`."""
    brightest: float
    """The greatest colour of a visible splat."""
    bins: Bins


@dataclass(frozen=True, eq=False, kw_only=True)
class Frame(Arrangement):
    """A drawn picture and all that `differentiate` needs of it."""

    view: View
    optics: Optics
    background: np.ndarray
    """(3,) in the picture's dtype."""
    termination: Termination
    sh_degree: int
    threads: int
    edited: bool
    """Whether edits were in force: such a picture cannot be differentiated."""
    by_pixel: bool
    """Whether the depth order was per pixel: such a picture cannot be differentiated either."""
    image: np.ndarray
    """(H, W, 4), the caller's to keep."""
    transmittance: np.ndarray
    """(tiles·TILE_PIXELS,), final transmittance of each pixel, in the order of `forward.draw_tiles`."""
    n_contrib: np.ndarray
    """(tiles·TILE_PIXELS,), last contributor of each pixel: splats of its tile's list up to its end."""
    lists: np.ndarray
    """(pairs,) int32 of the last band."""
    pixel_splats: int
    """Alphas evaluated: for each splat, all pixels of the blocks that its footprint touches."""
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
    surfels: SurfelModel | None = None,
    edits: EditArrays | None = None,
    nonzero: NonzeroBands | None = None,
    key_bits: int = 32,
    order_of: Callable[[np.ndarray, Runs], np.ndarray] | None = None,
    slopes_of: Callable[[np.ndarray], np.ndarray] | None = None,
    repaint: Repaint | None = None,
) -> Frame:
    """Draws in the dtype of `background` (3,), float32 or float64. Arguments are taken to be valid.

    See `arrange` for `nonzero`, `order_of` and `repaint`. `slopes_of` makes `forward_per_pixel.depth_slopes`
    of visible splats, for a picture in per-pixel order.
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
        surfels=surfels,
        edits=edits,
        nonzero=nonzero,
        clock=clock,
        key_bits=key_bits,
        order_of=order_of,
        repaint=repaint,
    )
    bins, image = arranged.bins, workspace.lend((view.height, view.width, 4), dtype)
    termination = make_termination(early_stop, dtype)
    slopes = None
    if slopes_of is not None:
        with clock.stage("slopes"):
            # The plane of a surfel has depths of its own.
            slopes = slopes_of(bins.order) if arranged.surfels is None else np.empty((0, 2))
    pixels = view.tiles_x * view.tiles_y * TILE_PIXELS if slopes is None else 0
    transmittance = workspace.take("transmittance", (pixels,), dtype)
    n_contrib = workspace.take("n_contrib", (pixels,), dtype)
    lists = np.empty(0, np.int32)
    evaluated = 0
    for band in bins.bands:
        with clock.stage("bin"):
            lists = bins.write(band, workspace)
        with clock.stage("forward"):
            base = int(bins.offsets[band[0]])
            shared = (bins.offsets, base, lists, arranged.records, arranged.surfels, view)
            ranges = tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD)
            if slopes is None:
                more = (background, termination, image, transmittance, n_contrib)
                evaluated += BLOCK_LANES * sum(run(draw_tiles, ranges, (*shared, *more), threads))
            else:
                more = (arranged.depths, slopes, background, termination.stop_below, image)
                evaluated += sum(run(draw_tiles_by_pixel, ranges, (*shared, *more), threads))
    return Frame(
        **vars(arranged),
        view=view,
        optics=optics,
        background=background,
        termination=termination,
        sh_degree=sh_degree,
        threads=threads,
        edited=edits is not None,
        by_pixel=slopes is not None,
        image=image,
        transmittance=transmittance,
        n_contrib=n_contrib,
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
    surfels: SurfelModel | None,
    edits: EditArrays | None,
    clock: StageClock,
    nonzero: NonzeroBands | None = None,
    key_bits: int = 32,
    order_of: Callable[[np.ndarray, Runs], np.ndarray] | None = None,
    repaint: Repaint | None = None,
) -> Arrangement:
    """All that comes before pixels: project, sort, bin.

    `nonzero`: the SH bands that are not zero, where that is known. `order_of` gives visible splats (N,), in
    runs, in depth order; None: they are sorted by keys of `key_bits` bits. `repaint` changes the records of
    visible splats before they are sorted and binned; such a picture cannot be differentiated.
    """
    with clock.stage("project"):
        count = len(splats.means)
        pieces = even_ranges(count, threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
        records = workspace.take("records", (count, RECORD), dtype)
        depths = workspace.take("depths", (count,), np.float64)
        visible = workspace.take("visible", (count,), np.int32)
        rows_of = workspace.take("rows_of", (count,), np.uint16)
        bounds = np.empty((len(pieces), 3))
        footprints = own_degrees = None
        if surfels is not None:
            footprints = SurfelArrays(workspace.take("surfels", (count, SURFEL), dtype), *surfels)
        if nonzero is not None:
            sh_degree, own_degrees = min(sh_degree, nonzero.in_use), nonzero.own_degrees
        found = run(
            project,
            [(*piece, row) for piece, row in zip(pieces, bounds, strict=True)],
            (
                *splats,
                sh_degree,
                view,
                optics,
                records,
                depths,
                visible,
                edits,
                footprints,
                own_degrees,
                rows_of,
            ),
            threads,
        )
        if min(found) < 0:
            raise ValueError("edits.marks names an adjustment that is not in edits.palette")
        runs = [(start, start + number) for (start, _), number in zip(pieces, found, strict=True)]
        if repaint is not None:
            repaint(records, depths, visible, runs)
            run(find_rows, runs, (visible, records, view, rows_of), threads)
    with clock.stage("sort"):
        if order_of is None:
            span = float(bounds[:, 0].min()), float(bounds[:, 1].max())
            order = sorted_by_depth(visible, runs, depths, span, key_bits, workspace, threads)
        else:
            order = order_of(visible, runs)
    with clock.stage("bin"):
        bins = _bin(order, rows_of, records, view, workspace, threads)
    return Arrangement(
        records=records,
        depths=depths,
        surfels=footprints,
        pieces=pieces,
        runs=runs,
        visible=visible,
        brightest=float(bounds[:, 2].max(initial=0.0)),
        bins=bins,
    )


def _bin(
    order: np.ndarray,
    rows_of: np.ndarray,
    records: np.ndarray,
    view: View,
    workspace: Workspace,
    threads: int,
) -> Bins:
    pieces = even_ranges(len(order), threads * TASKS_PER_THREAD, step=SPLATS_PER_TASK)
    rows = [count + SPARE for count in run(sum_rows, pieces, (order, rows_of), threads)]
    ends = np.cumsum(rows).tolist()
    spans = workspace.take("spans", (ends[-1] if ends else 0, 2), np.int32)
    tiles, runs = view.tiles_x * view.tiles_y, workspace.take("runs", (len(order), 2), np.int32)
    positions = workspace.take("positions", (len(pieces), tiles), np.int64)
    offsets = workspace.take("offsets", (tiles + 1,), np.int64)
    run(
        find_spans,
        [
            (*piece, end - count, row)
            for piece, end, count, row in zip(pieces, ends, rows, positions, strict=True)
        ],
        (order, records, view, spans, runs),
        threads,
    )
    place_lists(positions, offsets)
    return Bins(
        order=order,
        runs=runs,
        spans=spans,
        pieces=pieces,
        positions=positions,
        offsets=offsets,
        bands=bands_of(offsets, MAX_LISTED_PAIRS),
        threads=threads,
    )


def bands_of(offsets: np.ndarray, most_pairs: int) -> Runs:
    """Runs of tiles with at most `most_pairs` pairs together, or of one tile."""
    bands, first, tiles = [], 0, len(offsets) - 1
    while first < tiles:
        end = int(np.searchsorted(offsets, offsets[first] + most_pairs, side="right")) - 1
        end = min(max(end, first + 1), tiles)
        bands.append((first, end))
        first = end
    return bands


def tile_ranges(offsets: np.ndarray, band: tuple[int, int], pieces: int) -> Runs:
    """Runs of a band's tiles of about equal cost."""
    first, end = band
    cost = offsets[first : end + 1] - offsets[first] + np.arange(end - first + 1) * TILE_COST
    edges = np.searchsorted(cost, np.linspace(0, cost[-1], max(1, min(pieces, end - first)) + 1)) + first
    edges[0], edges[-1] = first, end
    return [(int(a), int(b)) for a, b in pairwise(edges) if b > a]


def specialisation_key(
    gaussians: Gaussians, camera: Camera, settings: RenderSettings, *, edited: bool = False
) -> str:
    """Name of the kernel variants that a picture takes, one for each combination of argument types and
    version of this program. `edited`: edits are in force."""
    parts = (
        cache_stamp(),
        gaussians.means.dtype.name,
        str(numba.typeof(make_optics(camera))),
        make_surfels(camera, settings.model) is not None,
        edited,
        nonzero_bands(gaussians).own_degrees is not None,
        settings.order == "per-pixel",
    )
    return "cpu " + " ".join(str(part) for part in parts)
