"""How much work a picture is, pixel by pixel: splats that are evaluated where they can be seen.

A count of the picture rather than of an implementation: a splat is counted in a pixel where its alpha is
not cut off and light still comes through. What this rasteriser computes besides, in blocks of pixels that
an ellipse only touches, is the frame's `pixel_splats`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Camera, RenderSettings
from ..scene.edits import SceneEdits
from .compiling import kernel
from .discs import make_discs, met_at
from .edited import edit_arrays
from .forward import EARLY_STOP
from .frame import draw, tile_ranges
from .optics import make_optics
from .parameters import Parameters, used_degree
from .pool import TASKS_PER_THREAD, available_threads, run
from .project import LOG2_OPACITY, RX, RY, X_REST, Y_REST, A, B, C, X, Y
from .view import TILE, make_view
from .workspace import Workspace


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
