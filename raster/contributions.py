"""How much of the pictures each splat makes, and which splat is the front of each pixel.

A splat's weight in a pixel is alpha·T, the share of the pixel's colour that is its own. `weigh_tiles` walks
the tiles as `forward` does and notes for each pair the sum and the largest of its weights; `gather_weights`
adds them up splat by splat, so that nothing is shared between threads and sums do not depend on how many
there are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from splatview.raster.camera_models import make_optics
from splatview.raster.compiling import TASKS_PER_THREAD, available_threads, inline, kernel, run
from splatview.raster.edits import edit_arrays
from splatview.raster.forward import (
    BLOCKS,
    CHUNK,
    EARLY_STOP,
    G_A,
    G_B,
    G_C,
    G_LOG2_OPACITY,
    G_X,
    G_Y,
    PIXELS,
    STRIPS,
    TILE_PIXELS,
    block_in_image,
    gather,
    gathered_columns,
    make_retirement,
    on_disc,
    power_on_disc,
    retire,
    start_pixels,
    touched_blocks,
)
from splatview.raster.frame import Arrangement, StageClock, arrange, draw, tile_ranges
from splatview.raster.parameters import TILE, Parameters, make_view, parameters_of, used_degree
from splatview.raster.project import LOG2_OPACITY, RX, RY, X_REST, Y_REST, A, B, C, X, Y
from splatview.raster.simd import (
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    LANES,
    aligned,
    column_centres,
    exp2,
    fill,
    fma,
    greatest_lane,
    keep_if_at_least,
    keep_if_below,
    load,
    maximum,
    minimum,
    negate,
    row_centres,
    spread,
    store,
    sum_lanes,
)
from splatview.raster.sort import Workspace
from splatview.raster.surfels import make_discs, met_at
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.edits import SceneEdits

LEAST_COVERAGE = 0.5
"""A pixel that lets through more light than it stops has no front."""

NO_SPLAT = -1


@dataclass(frozen=True, eq=False, kw_only=True)
class Weights:
    """What each splat adds to the pictures of some cameras; 0 for splats that none of them sees."""

    total: np.ndarray
    """(N,) float64, the sum of its weights over all pixels of all cameras."""
    largest: np.ndarray
    """(N,) float64, its largest weight in any pixel, 0 to 1."""


def contributions(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    settings: RenderSettings | None = None,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
) -> np.ndarray:
    """(N,) float64: `Weights.total` of each splat in the pictures of `cameras`."""
    return weigh(gaussians, cameras, settings, edits=edits, threads=threads).total


def weigh(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    settings: RenderSettings | None = None,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
) -> Weights:
    """The weights of each splat in the pictures of `cameras`, taken one after another.

    Edits are seen as in `render`; what they hide weighs nothing. Light below `EARLY_STOP` is not followed.

    Raises:
        ValueError: the edits are not of this scene.
    """
    total, largest = np.zeros(len(gaussians)), np.zeros(len(gaussians))
    workspace = Workspace()
    for camera in cameras:
        _weigh(gaussians, camera, settings, edits, threads, workspace, total, largest)
    return Weights(total=total, largest=largest)


def front(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None = None,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
    least_coverage: float = LEAST_COVERAGE,
) -> np.ndarray:
    """(H, W) int32: at each pixel the splat with the largest weight there, the nearer of equals.

    -1 where the splats stop less than `least_coverage`, 0 to 1, of the light, and where there are none.

    Raises:
        ValueError: the edits are not of this scene, or least_coverage is not in [0, 1].
    """
    if not 0 <= least_coverage <= 1:
        raise ValueError(f"least_coverage must be in [0, 1], got {least_coverage}")
    total, largest = np.zeros(len(gaussians)), np.zeros(len(gaussians))
    return _weigh(gaussians, camera, settings, edits, threads, Workspace(), total, largest, least_coverage)


def _weigh(
    gaussians: Gaussians,
    camera: Camera,
    settings: RenderSettings | None,
    edits: SceneEdits | None,
    threads: int | None,
    workspace: Workspace,
    total: np.ndarray,
    largest: np.ndarray,
    least_coverage: float = LEAST_COVERAGE,
) -> np.ndarray:
    """Adds one camera's weights to total and largest (N,); returns `front`."""
    settings = settings or RenderSettings()
    splats, dtype = parameters_of(gaussians), np.dtype(np.float32)
    threads = threads or available_threads()
    view = make_view(camera, settings, dtype)
    arranged: Arrangement = arrange(
        splats,
        view,
        dtype,
        workspace,
        sh_degree=used_degree(splats, settings),
        threads=threads,
        optics=make_optics(camera),
        discs=make_discs(camera, settings.model),
        edits=edit_arrays(edits, len(splats.means)),
        clock=StageClock(),
    )
    bins, front_of = arranged.bins, np.empty((camera.height, camera.width), np.int32)
    retirement = make_retirement(EARLY_STOP, dtype)
    cursors = workspace.take("cursors_of_weights", bins.positions.shape, np.int64)
    cursors[:] = bins.positions
    for band in bins.bands:
        lists = bins.write(band, workspace)
        base = int(bins.offsets[band[0]])
        pairs = workspace.take("pair_weights", (len(lists), 2), dtype)
        run(
            weigh_tiles,
            tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD),
            (
                bins.offsets,
                base,
                lists,
                arranged.records,
                arranged.discs,
                view,
                retirement,
                least_coverage,
                pairs,
                front_of,
            ),
            threads,
        )
        run(
            gather_weights,
            [(*piece, row) for piece, row in zip(bins.pieces, cursors, strict=True)],
            (bins.order, bins.spans_of, bins.spans, *band, base, pairs, total, largest),
            threads,
        )
    return front_of


@inline
def weigh_chunk(
    gathered, count, rows, alive, log2_cut, log2_share, max_alpha, pixels, place, first_row, pairs, discs
):
    """Walks gathered splats: the sum and the largest weight of the j-th go to
    pairs[first_row + j]; in `pixels` the largest weight so far takes the place of red, and that of green its
    splat's place in the tile's list, the first gathered one being at `place`."""
    number = gathered.dtype.type
    scratch = aligned(LANES, pairs.dtype)
    for j in range(count):
        b, c = spread(gathered[G_B * CHUNK + j]), spread(gathered[G_C * CHUNK + j])
        log2_opacity = spread(gathered[G_LOG2_OPACITY * CHUNK + j])
        cut = maximum(log2_opacity + fill(b, log2_share), fill(b, log2_cut))
        cap, step = fill(b, max_alpha), fill(b, BLOCK_HEIGHT)
        y_centres = row_centres(b) - spread(gathered[G_Y * CHUNK + j])
        here = fill(b, place + j)
        total = greatest = fill(b, 0.0)
        for strip in range(STRIPS):
            first = max(np.int64(rows[2 * strip * CHUNK + j]), alive[2 * strip])
            last = min(np.int64(rows[(2 * strip + 1) * CHUNK + j]), alive[2 * strip + 1])
            x_mean = gathered[G_X * CHUNK + j] - number(strip * BLOCK_WIDTH)
            dx = column_centres(b) - spread(x_mean)
            adx = spread(gathered[G_A * CHUNK + j]) * dx
            if discs is not None:
                across = on_disc(gathered, j, discs, dx)
            dy = y_centres + fill(b, first * BLOCK_HEIGHT)
            for block in range(first, last + 1):
                if discs is None:
                    u, v = fma(b, dy, adx), c * dy
                    power = fma(negate(u), u, fma(negate(v), v, log2_opacity))
                else:
                    plane = across  # pyright: ignore[reportPossiblyUnboundVariable]
                    power = log2_opacity - power_on_disc(plane, gathered, j, discs, dy)
                dy = dy + step
                alpha = keep_if_at_least(minimum(exp2(power), cap), power, cut)
                base = (strip * BLOCKS + block) * 4 * LANES
                light, most = load(pixels, base), load(pixels, base + LANES)
                weight = alpha * light
                store(pixels, base, fma(negate(alpha), light, light))
                before = keep_if_at_least(load(pixels, base + 2 * LANES), most, weight)
                store(pixels, base + 2 * LANES, before + keep_if_below(here, most, weight))
                store(pixels, base + LANES, maximum(most, weight))
                total, greatest = total + weight, maximum(greatest, weight)
        store(scratch, 0, sum_lanes((total,)))
        pairs[first_row + j, 0], pairs[first_row + j, 1] = scratch[0], greatest_lane(greatest)


@kernel
def weigh_tiles(
    start, stop, offsets, base, lists, records, discs, view, retirement, least_coverage, pairs, front_of
):
    """Writes the sums and largest weights of the pairs of tiles [start, stop) to pairs (P, 2), whose first
    row is place `base`, and their parts of front_of (H, W) int32. The other arguments as in `forward`."""
    gathered = aligned(gathered_columns(discs) * CHUNK, records.dtype)
    rows = aligned(STRIPS * 2 * CHUNK, np.int32)
    pixels = aligned(PIXELS, records.dtype)
    transmittance, n_contrib = aligned(TILE_PIXELS, records.dtype), aligned(TILE_PIXELS, records.dtype)
    alive = np.empty(2 * STRIPS, np.int64)
    height, width = front_of.shape
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        transmittance[:] = 0
        n_contrib[:] = 0
        start_pixels(pixels, left, top, view)
        for strip in range(STRIPS):
            alive[2 * strip], alive[2 * strip + 1] = 0, BLOCKS - 1
        first, end = offsets[tile] - base, offsets[tile + 1] - base
        position, some = first, True
        while position < end and some:
            count = min(end - position, CHUNK)
            next_stop = min(position + 2 * CHUNK, end)
            count = gather(
                lists,
                position,
                count,
                position + count,
                next_stop,
                records,
                left,
                top,
                retirement.most_fall,
                gathered,
                discs,
            )
            touched_blocks(gathered, count, view.log2_cut, view.log2_share, rows)
            weigh_chunk(
                gathered,
                count,
                rows,
                alive,
                view.log2_cut,
                view.log2_share,
                view.max_alpha,
                pixels,
                position - first,
                position,
                pairs,
                discs,
            )
            position += count
            some = retire(pixels, 0, retirement.stop_below, position - first, transmittance, n_contrib, alive)
        pairs[position:end] = 0
        retire(pixels, 0, np.inf, position - first, transmittance, n_contrib, alive)
        for block in range(STRIPS * BLOCKS):
            x, y, columns, block_rows = block_in_image(block, left, top, width, height)
            for row in range(block_rows):
                for column in range(columns):
                    lane = row * BLOCK_WIDTH + column
                    at = block * 4 * LANES + lane
                    found = (
                        pixels[at + LANES] > 0 and 1 - transmittance[block * LANES + lane] >= least_coverage
                    )
                    # A float32 holds places below 2^24 exactly; none of any size is beyond the list.
                    place = min(first + np.int64(pixels[at + 2 * LANES]), end - 1)
                    front_of[y + row, x + column] = lists[place] if found else NO_SPLAT


@kernel
def gather_weights(
    start, stop, positions, order, spans_of, spans, first_tile, end_tile, base, pairs, total, largest
):
    """Adds the weights of each splat of order[start:stop] in tiles [first_tile, end_tile) to total and
    largest (N,). The pairs are found as they were written: positions (tiles,) int64 is used up."""
    for k in range(start, stop):
        splat = order[k]
        for span in range(spans_of[splat, 0], spans_of[splat, 1]):
            for tile in range(max(spans[span, 0], first_tile), min(spans[span, 1], end_tile)):
                row = positions[tile] - base
                positions[tile] += 1
                total[splat] += pairs[row, 0]
                largest[splat] = max(largest[splat], pairs[row, 1])


# ---- How much work a picture is, pixel by pixel: splats that are evaluated where they can be seen.
#
# A count of the picture rather than of an implementation: a splat is counted in a pixel where its alpha is
# not cut off and light still comes through. What this rasteriser computes besides, in blocks of pixels that
# an ellipse only touches, is the frame's `pixel_splats`.


@dataclass(frozen=True, eq=False, kw_only=True)
class Counted:
    """What one picture asked for."""

    evaluations: np.ndarray
    """(H, W) int32, splats blended in each pixel."""
    pixel_splats: int
    """Alphas that the rasteriser computed, in whole blocks of pixels."""
    pairs: int
    """Of splats and tiles."""
    visible: int
    """Splats that were projected and sorted."""
    sh_degree: int
    """Highest band summed."""


def count_work(
    splats: Parameters,
    camera: Camera,
    settings: RenderSettings,
    workspace: Workspace,
    *,
    edits: SceneEdits | None = None,
    threads: int | None = None,
) -> Counted:
    """Draws a picture in float32 and counts."""
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
        discs=make_discs(camera, settings.model),
        edits=edit_arrays(edits, len(splats.means)),
        threads=threads,
    )
    bins, counts = frame.bins, np.zeros((camera.height, camera.width), np.int32)
    for band in bins.bands:
        lists = bins.write(band, workspace)
        run(
            count_tiles,
            tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD),
            (
                bins.offsets,
                int(bins.offsets[band[0]]),
                lists,
                frame.records,
                frame.discs,
                view,
                early_stop,
                counts,
            ),
            threads,
        )
    return Counted(
        evaluations=counts,
        pixel_splats=frame.pixel_splats,
        pairs=int(bins.offsets[-1]),
        visible=len(bins.order),
        sh_degree=degree,
    )


@kernel
def count_tiles(start, stop, offsets, base, lists, records, discs, view, early_stop, counts):
    """Adds to counts (H, W) int32 the splats blended in each pixel of tiles [start, stop), as
    `forward.draw_tiles` has them: arguments as there."""
    light = np.empty((TILE, TILE), np.float64)
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        bottom, right = min(top + TILE, view.height), min(left + TILE, view.width)
        light[:] = 1.0
        going = (bottom - top) * (right - left)
        for place in range(offsets[tile] - base, offsets[tile + 1] - base):
            if going == 0:
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
                    through = light[row - top, column - left]
                    if not through > early_stop:
                        continue
                    dx = column + 0.5 - x
                    if discs is None:
                        u = record[A] * dx + record[B] * dy
                        power = record[LOG2_OPACITY] - u * u - v * v
                    else:
                        power = record[LOG2_OPACITY] - met_at(discs, lists[place], dx, dy, 0.0)[0]
                    if power >= max(view.log2_cut, record[LOG2_OPACITY] + view.log2_share):
                        counts[row, column] += 1
                        through *= 1 - min(2.0**power, view.max_alpha)
                        light[row - top, column - left] = through
                        if not through > early_stop:
                            going -= 1
