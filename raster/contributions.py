"""Each splat's contribution to pictures, the dominant splat of each pixel, and the work that a picture takes.

A splat's contribution to a pixel is alpha·T, its share of the pixel's colour. `contribution_tiles` walks
the tiles as `forward` does and notes the sum of each pair; `gather_contributions` adds the pairs up splat by
splat, so that nothing is shared between threads and sums do not depend on how many there are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from splatview.raster.blocks import MEMBERS, exp2_by, exp2_constants
from splatview.raster.camera_models import make_optics
from splatview.raster.compiling import TASKS_PER_THREAD, available_threads, inline, kernel, run
from splatview.raster.edits import edit_arrays
from splatview.raster.forward import (
    ALL_BLOCKS,
    BLOCKS,
    CENTRES,
    CHUNK,
    EARLY_STOP,
    EXPONENTS,
    G_CUT,
    ITEMS,
    PIXELS,
    STRIPS,
    TILE_PIXELS,
    block_in_image,
    exponent_at,
    gather,
    gathered_columns,
    list_items,
    make_termination,
    place_centres,
    start_pixels,
    terminate_pixels,
    touched_blocks,
)
from splatview.raster.frame import Arrangement, StageClock, arrange, draw, tile_ranges
from splatview.raster.parameters import TILE, Parameters, make_view, parameters_of, used_degree
from splatview.raster.project import LOG2_OPACITY, RX, RY, X_REST, Y_REST, A, B, C, X, Y
from splatview.raster.simd import (
    BLOCK_LANES,
    BLOCK_WIDTH,
    LANES,
    aligned,
    fill,
    fma,
    keep_if_at_least,
    keep_if_below,
    load_block,
    maximum,
    minimum,
    negate,
    spread_block,
    store,
    sum_lanes,
)
from splatview.raster.sort import Workspace
from splatview.raster.surfels import exponent_and_depth, make_surfels
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import SceneEdits

LEAST_COVERAGE = 0.5
"""Alpha of a pixel below which it has no dominant splat."""

NO_ID = -1
"""Entry of the dominant-splat id buffer where there is none."""


def contributions(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    settings: RenderSettings | None = None,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
) -> np.ndarray:
    """(N,) float64: the sum of each splat's contributions to all pixels of all `cameras`.

    Edits are applied as in `render`; hidden splats contribute nothing. Pixels are terminated at `EARLY_STOP`.

    Raises:
        ValueError: the edits are not of this scene.
    """
    total, workspace = np.zeros(len(gaussians)), Workspace()
    for camera in cameras:
        _add_contributions(gaussians, camera, settings, edits, threads, workspace, total)
    return total


def contributions_and_footprints(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    settings: RenderSettings | None = None,
    *,
    threads: int | None = None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """For each camera in turn each splat's sum of contributions to its picture, (N,) float64, and what it
    would be with nothing before the splat: the integral of its alpha, times the share of its box that is in
    the picture."""
    workspace, colourless = Workspace(), replace(settings or RenderSettings(), sh_degree=0)
    for camera in cameras:
        total, footprints = np.zeros(len(gaussians)), np.zeros(len(gaussians))
        _, arranged = _add_contributions(gaussians, camera, colourless, None, threads, workspace, total)
        visible = np.concatenate([arranged.visible[start:stop] for start, stop in arranged.runs])
        records = arranged.records[visible].astype(np.float64)
        inside = np.ones(len(visible))
        for at, extent, size in ((X, RX, camera.width), (Y, RY, camera.height)):
            middle, half = records[:, at], np.maximum(records[:, extent], 1e-9)
            shown = np.minimum(middle + half, size) - np.maximum(middle - half, 0)
            inside *= np.clip(shown / (2 * half), 0, 1)
        areas = np.pi / math.log(2) / (records[:, A] * records[:, C])
        footprints[visible] = 2 ** records[:, LOG2_OPACITY] * areas * inside
        yield total, footprints


def dominant_splats(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
    least_coverage: float = LEAST_COVERAGE,
) -> np.ndarray:
    """The dominant-splat id buffer, (H, W) int32: the splat with the largest contribution to each pixel, the
    nearer of equals; -1 where alpha is below `least_coverage`, 0 to 1, or there are no splats.

    Raises:
        ValueError: the edits are not of this scene, or least_coverage is not in [0, 1].
    """
    if not 0 <= least_coverage <= 1:
        raise ValueError(f"least_coverage must be in [0, 1], got {least_coverage}")
    total = np.zeros(len(gaussians))
    return _add_contributions(
        gaussians, camera, settings, edits, threads, Workspace(), total, least_coverage
    )[0]


def _add_contributions(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None,
    edits: SceneEdits | None,
    threads: int | None,
    workspace: Workspace,
    total: np.ndarray,
    least_coverage: float = LEAST_COVERAGE,
) -> tuple[np.ndarray, Arrangement]:
    """Adds one camera's contributions to total (N,); its dominant-splat id buffer, and what was drawn, whose
    arrays are the workspace's."""
    settings = settings or RenderSettings()
    splats, dtype = parameters_of(gaussians), np.dtype(np.float32)
    threads = threads or available_threads()
    view = make_view(camera, settings, dtype)
    arranged = arrange(
        splats,
        view,
        dtype,
        workspace,
        sh_degree=used_degree(splats, settings),
        threads=threads,
        optics=make_optics(camera),
        surfels=make_surfels(camera, settings.model),
        edits=edit_arrays(edits, len(splats.means)),
        clock=StageClock(),
    )
    bins, ids = arranged.bins, np.empty((camera.height, camera.width), np.int32)
    termination, splats_of = make_termination(EARLY_STOP, dtype), (arranged.records, arranged.surfels)
    cursors = workspace.take("pair_cursors", bins.positions.shape, np.int64)
    cursors[:] = bins.positions
    for band in bins.bands:
        lists = bins.write(band, workspace)
        base = int(bins.offsets[band[0]])
        pairs = workspace.take("pair_contributions", (len(lists),), dtype)
        run(
            contribution_tiles,
            tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD),
            (bins.offsets, base, lists, *splats_of, view, termination, least_coverage, pairs, ids),
            threads,
        )
        run(
            gather_contributions,
            [(*piece, row) for piece, row in zip(bins.pieces, cursors, strict=True)],
            (bins.order, bins.runs, bins.spans, *band, base, pairs, total),
            threads,
        )
    return ids, arranged


@inline
def contribution_chunk(
    items, firsts, gathered, count, centres, max_alpha, pixels, place, first_row, pairs, surfels, scratch
):
    """Walks gathered splats; the j-th one's sum of contributions goes to pairs[first_row + j]. In `pixels`
    the largest contribution so far takes the place of red, and its splat's place in the tile's list that of
    green; the first gathered splat is at `place`. items and firsts as `list_items` made them; scratch
    (LANES,) is room to work in."""
    constants = exp2_constants(centres, EXPONENTS)
    for j in range(count):
        cut = spread_block(gathered[G_CUT * CHUNK + j])
        cap, here, total = fill(cut, max_alpha), fill(cut, place + j), fill(cut, 0.0)
        for n in range(np.int64(firsts[j]), np.int64(firsts[j + 1])):
            block = np.int64(items[n]) & (STRIPS * BLOCKS - 1)
            power = exponent_at(gathered, centres, j, block, surfels)
            alpha = keep_if_at_least(minimum(exp2_by(constants, power), cap), power, cut)
            base = block * 4 * BLOCK_LANES
            transmittance, most = load_block(pixels, base), load_block(pixels, base + BLOCK_LANES)
            contribution = alpha * transmittance
            store(pixels, base, fma(negate(alpha), transmittance, transmittance))
            before = keep_if_at_least(load_block(pixels, base + 2 * BLOCK_LANES), most, contribution)
            store(pixels, base + 2 * BLOCK_LANES, before + keep_if_below(here, most, contribution))
            store(pixels, base + BLOCK_LANES, maximum(most, contribution))
            total = total + contribution
        store(scratch, 0, sum_lanes((total,)))
        pairs[first_row + j] = scratch[0]


@kernel(allocates=True)
def contribution_tiles(
    start, stop, offsets, base, lists, records, surfels, view, termination, least_coverage, pairs, ids
):
    """Writes the sums of the pairs of tiles [start, stop) to pairs (P,), the first of which is place `base`,
    and their parts of the dominant-splat ids (H, W) int32. The other arguments as in `forward`."""
    gathered = aligned(gathered_columns(surfels) * CHUNK, records.dtype)
    touched, items = aligned(CHUNK, np.uint32), aligned(ITEMS, np.int32)
    firsts, members = np.empty(CHUNK + 1, np.uint32), MEMBERS.reshape(-1)
    pixels, centres = aligned(PIXELS, records.dtype), aligned(CENTRES, records.dtype)
    place_centres(centres)
    transmittance, n_contrib = aligned(TILE_PIXELS, records.dtype), aligned(TILE_PIXELS, records.dtype)
    scratch = aligned(LANES, pairs.dtype)
    flat_records, starts = records.reshape(-1), np.empty(LANES, np.int64)
    height, width = ids.shape
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        transmittance[:] = 0
        n_contrib[:] = 0
        start_pixels(pixels, left, top, view)
        first, end = offsets[tile] - base, offsets[tile + 1] - base
        position, alive = first, ALL_BLOCKS
        while position < end and alive:
            count = min(end - position, CHUNK)
            stop_at = min(position + 2 * CHUNK, end)
            count = gather(
                lists,
                position,
                count,
                position + count,
                stop_at,
                flat_records,
                left,
                top,
                termination.max_log2_drop,
                gathered,
                surfels,
                starts,
            )
            touched_blocks(gathered, count, view.log2_cut, view.log2_share, touched)
            list_items(touched, 0, count, alive, members, items, firsts)
            contribution_chunk(
                items,
                firsts,
                gathered,
                count,
                centres,
                view.max_alpha,
                pixels,
                position - first,
                position,
                pairs,
                surfels,
                scratch,
            )
            position += count
            alive = terminate_pixels(
                pixels, 0, termination.stop_below, position - first, transmittance, n_contrib, alive
            )
        pairs[position:end] = 0
        terminate_pixels(pixels, 0, np.inf, position - first, transmittance, n_contrib, alive)
        for block in range(STRIPS * BLOCKS):
            x, y, columns, block_rows = block_in_image(block, left, top, width, height)
            for row in range(block_rows):
                for column in range(columns):
                    lane = row * BLOCK_WIDTH + column
                    at = block * 4 * BLOCK_LANES + lane
                    found = (
                        pixels[at + BLOCK_LANES] > 0
                        and 1 - transmittance[block * BLOCK_LANES + lane] >= least_coverage
                    )
                    # A float32 holds places below 2^24 exactly; none of any size is beyond the list.
                    place = min(first + np.int64(pixels[at + 2 * BLOCK_LANES]), end - 1)
                    ids[y + row, x + column] = lists[place] if found else NO_ID


@kernel
def gather_contributions(
    start, stop, positions, order, runs, spans, first_tile, end_tile, base, pairs, total
):
    """Adds the pairs of each splat of order[start:stop] in tiles [first_tile, end_tile) to total (N,). The
    pairs are found as they were written: positions (tiles,) int64 is used up."""
    for k in range(start, stop):
        splat = order[k]
        for row in range(runs[k, 0], runs[k, 0] + runs[k, 1]):
            for tile in range(max(spans[row, 0], first_tile), min(spans[row, 1], end_tile)):
                total[splat] += pairs[positions[tile] - base]
                positions[tile] += 1


@dataclass(frozen=True, eq=False, kw_only=True)
class Counted:
    """Work that a picture takes: a count of the picture rather than of an implementation, `pixel_splats`
    apart."""

    evaluations: np.ndarray
    """(H, W) int32, splats blended in each pixel: alpha is not cut off, and the pixel not terminated."""
    pixel_splats: int
    """Alphas that this rasteriser evaluates, in whole blocks of pixels that an ellipse touches."""
    pairs: int
    """Splat-tile pairs."""
    visible: int
    """Splats projected and sorted."""
    sh_degree: int
    """Highest SH band evaluated."""


def count_work(
    splats: Parameters,
    camera: Camera,
    settings: RenderSettings,
    workspace: Workspace,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
) -> Counted:
    """The work of a picture in float32."""
    early_stop = EARLY_STOP if settings.early_stop is None else settings.early_stop
    degree, threads = used_degree(splats, settings), threads or available_threads()
    view = make_view(camera, settings, np.dtype(np.float32))
    frame = draw(
        splats,
        view,
        np.zeros(3, np.float32),
        workspace,
        sh_degree=degree,
        early_stop=early_stop,
        optics=make_optics(camera),
        surfels=make_surfels(camera, settings.model),
        edits=edit_arrays(edits, len(splats.means)),
        threads=threads,
    )
    bins, counts = frame.bins, np.zeros((camera.height, camera.width), np.int32)
    for band in bins.bands:
        lists, base = bins.write(band, workspace), int(bins.offsets[band[0]])
        run(
            count_tiles,
            tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD),
            (bins.offsets, base, lists, frame.records, frame.surfels, view, early_stop, counts),
            threads,
        )
    return Counted(
        evaluations=counts,
        pixel_splats=frame.pixel_splats,
        pairs=int(bins.offsets[-1]),
        visible=len(bins.order),
        sh_degree=degree,
    )


@kernel(allocates=True)
def count_tiles(start, stop, offsets, base, lists, records, surfels, view, early_stop, counts):
    """Adds to counts (H, W) int32 the splats blended in each pixel of tiles [start, stop), as
    `forward.draw_tiles` has them: arguments as there."""
    transmittance = np.empty((TILE, TILE), np.float64)
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        bottom, right = min(top + TILE, view.height), min(left + TILE, view.width)
        transmittance[:] = 1.0
        alive = (bottom - top) * (right - left)
        for place in range(offsets[tile] - base, offsets[tile + 1] - base):
            if alive == 0:
                break
            record = records[lists[place]]
            x = np.float64(record[X]) + np.float64(record[X_REST])
            y = np.float64(record[Y]) + np.float64(record[Y_REST])
            # Compared before they become whole numbers, which the largest extents would not fit.
            first_row = np.int64(max(np.float64(top), np.floor(y - record[RY] - 0.5)))
            last_row = np.int64(min(bottom - 1.0, np.ceil(y + record[RY])))
            first_column = np.int64(max(np.float64(left), np.floor(x - record[RX] - 0.5)))
            last_column = np.int64(min(right - 1.0, np.ceil(x + record[RX])))
            for row in range(first_row, last_row + 1):
                dy = row + 0.5 - y
                v = record[C] * dy
                for column in range(first_column, last_column + 1):
                    T = transmittance[row - top, column - left]
                    if not early_stop < T:
                        continue
                    dx = column + 0.5 - x
                    if surfels is None:
                        u = record[A] * dx + record[B] * dy
                        power = record[LOG2_OPACITY] - u * u - v * v
                    else:
                        power = (
                            record[LOG2_OPACITY] - exponent_and_depth(surfels, lists[place], dx, dy, 0.0)[0]
                        )
                    if power >= max(view.log2_cut, record[LOG2_OPACITY] + view.log2_share):
                        counts[row, column] += 1
                        T *= 1 - min(2.0**power, view.max_alpha)
                        transmittance[row - top, column - left] = T
                        if not early_stop < T:
                            alive -= 1
