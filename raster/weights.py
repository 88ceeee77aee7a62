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

from ..scene import Camera, Gaussians, RenderSettings
from ..scene.edits import SceneEdits
from .compiling import inline, kernel
from .discs import make_discs
from .edited import edit_arrays
from .exp import exp2
from .forward import (
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
from .frame import Arrangement, StageClock, arrange, tile_ranges
from .optics import make_optics
from .parameters import parameters_of, used_degree
from .pool import TASKS_PER_THREAD, available_threads, run
from .simd import (
    BLOCK_HEIGHT,
    BLOCK_WIDTH,
    LANES,
    aligned,
    column_centres,
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
from .view import TILE, make_view
from .workspace import Workspace

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
    lights, met_of = aligned(TILE_PIXELS, records.dtype), aligned(TILE_PIXELS, records.dtype)
    alive = np.empty(2 * STRIPS, np.int64)
    height, width = front_of.shape
    for tile in range(start, stop):
        top, left = tile // view.tiles_x * TILE, tile % view.tiles_x * TILE
        lights[:] = 0
        met_of[:] = 0
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
            some = retire(pixels, 0, retirement.stop_below, position - first, lights, met_of, alive)
        pairs[position:end] = 0
        retire(pixels, 0, np.inf, position - first, lights, met_of, alive)
        for block in range(STRIPS * BLOCKS):
            x, y, columns, block_rows = block_in_image(block, left, top, width, height)
            for row in range(block_rows):
                for column in range(columns):
                    lane = row * BLOCK_WIDTH + column
                    at = block * 4 * LANES + lane
                    found = pixels[at + LANES] > 0 and 1 - lights[block * LANES + lane] >= least_coverage
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
