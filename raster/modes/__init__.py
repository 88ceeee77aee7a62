"""Visual modes other than the splats themselves, as OpenGL's shaders draw them, by kernels of their own.

What comes before pixels is the picture's own; the scene's edits are in force in every mode.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from splatview.raster import draw_frame
from splatview.raster.camera_models import make_optics
from splatview.raster.compiling import TASKS_PER_THREAD, available_threads, even_ranges, run
from splatview.raster.edits import edit_arrays
from splatview.raster.frame import Runs, StageClock, arrange, tile_ranges
from splatview.raster.modes.bodies import (
    BODY,
    draw_ellipsoids,
    draw_points,
    outline_ellipsoids,
    outline_points,
)
from splatview.raster.modes.painted import count_tiles, map_counts, map_depths, paint_depths, paint_normals
from splatview.raster.parameters import NonzeroBands, Parameters, make_view, used_degree
from splatview.raster.simd import BLOCK_LANES
from splatview.raster.sort import ReusableOrder, Workspace
from splatview.raster.surfels import make_surfels
from splatview.scene import Camera, RenderSettings
from splatview.scene.background import composite_over
from splatview.scene.edits import SceneEdits
from splatview.shaders.colour_maps import MOST_OVERDRAW, coefficients

BY_BLENDING = ("depth", "normals")
BY_SHAPE = ("points", "ellipsoids", "overdraw")
MODES = (*BY_BLENDING, *BY_SHAPE)


@dataclass(frozen=True, eq=False, kw_only=True)
class ModePicture:
    """A drawn picture."""

    image: np.ndarray
    """(H, W, 4), the caller's to keep."""
    runs: Runs
    """Parts of the splats that were visible, as `frame.Arrangement`."""
    pixel_splats: int
    """Splats met at pixels, whether they cover them or not."""
    milliseconds: dict[str, float]
    """Wall-clock time by stage."""


def draw_mode(
    mode: str,
    splats: Parameters,
    camera: Camera,
    settings: RenderSettings,
    workspace: Workspace,
    *,
    depth_range: tuple[float, float] = (0.0, 1.0),
    depth_order: ReusableOrder | None = None,
    edits: SceneEdits | None = None,
    nonzero: NonzeroBands | None = None,
    threads: int | None = None,
) -> ModePicture:
    """The picture in one of MODES, float32. `depth_range`: depths of the colours' ends in the mode "depth",
    world units. The other arguments as in `raster.draw_frame`.

    Raises:
        ValueError: an argument cannot be used; the message names it.
    """
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, got {mode}")
    threads = threads or available_threads()
    if mode in BY_SHAPE:
        return _draw_shapes(mode, splats, camera, settings, workspace, edits, nonzero, threads)
    view, parallel = make_view(camera, settings, np.dtype(np.float32)), camera.orthographic
    edited = edit_arrays(edits, len(splats.means))

    def repaint(records: np.ndarray, depths: np.ndarray, visible: np.ndarray, runs: Runs) -> None:
        if mode == "depth":
            run(paint_depths, runs, (visible, depths, records), threads)
            return
        flat = settings.model.footprint == "disc"
        shapes = splats.means, splats.quats, splats.log_scales
        run(paint_normals, runs, (visible, *shapes, view, parallel, flat, edited, records), threads)

    frame = draw_frame(
        splats,
        camera,
        settings,
        workspace,
        depth_order=depth_order,
        edits=edits,
        nonzero=nonzero,
        background=np.zeros(3) if mode == "depth" else None,
        repaint=repaint,
        threads=threads,
    )
    if mode == "depth":
        rows = even_ranges(camera.height, threads * TASKS_PER_THREAD)
        run(map_depths, rows, (*depth_range, coefficients("viridis"), frame.image), threads)
        composite_over(frame.image, settings.background, camera)
    return ModePicture(
        image=frame.image, runs=frame.runs, pixel_splats=frame.pixel_splats, milliseconds=frame.milliseconds
    )


def _draw_shapes(
    mode: str,
    splats: Parameters,
    camera: Camera,
    settings: RenderSettings,
    workspace: Workspace,
    edits: SceneEdits | None,
    nonzero: NonzeroBands | None,
    threads: int,
) -> ModePicture:
    clock, dtype, parallel = StageClock(), np.dtype(np.float32), camera.orthographic
    view, edited = make_view(camera, settings, dtype), edit_arrays(edits, len(splats.means))
    bodies = workspace.take("bodies", (len(splats.means) if mode == "ellipsoids" else 0, BODY), dtype)

    def outline(records: np.ndarray, depths: np.ndarray, visible: np.ndarray, runs: Runs) -> None:
        if mode == "points":
            run(outline_points, runs, (visible, view, records), threads)
        elif mode == "ellipsoids":
            shapes = splats.means, splats.quats, splats.log_scales, splats.opacity_logits
            more = view, parallel, edited, records, bodies
            run(outline_ellipsoids, runs, (visible, *shapes, *more), threads)

    def any_order(visible: np.ndarray, runs: Runs) -> np.ndarray:
        return np.concatenate([visible[start:stop] for start, stop in runs])

    # Bodies need no order for their depths, yet those behind others are soon found to be.
    order_of: Callable[..., np.ndarray] | None = any_order if mode == "overdraw" else None
    arranged = arrange(
        splats,
        view,
        dtype,
        workspace,
        sh_degree=used_degree(splats, settings),
        threads=threads,
        optics=make_optics(camera),
        surfels=make_surfels(camera, settings.model),
        edits=edited,
        nonzero=nonzero,
        clock=clock,
        order_of=order_of,
        repaint=outline,
    )
    image = np.empty((view.height, view.width, 4), dtype)
    counts = workspace.take("overdraw", image.shape[:2] if mode == "overdraw" else (0, 0), dtype)
    plain = isinstance(settings.background, tuple)
    background = np.array(settings.background if plain else (0.0, 0.0, 0.0))
    bins, evaluated = arranged.bins, 0
    for band in bins.bands:
        with clock.stage("bin"):
            lists = bins.write(band, workspace)
        with clock.stage("forward"):
            shared = bins.offsets, int(bins.offsets[band[0]]), lists, arranged.records
            ranges = tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD)
            if mode == "overdraw":
                evaluated += BLOCK_LANES * sum(
                    run(count_tiles, ranges, (*shared, arranged.surfels, view, counts), threads)
                )
            elif mode == "points":
                evaluated += sum(run(draw_points, ranges, (*shared, view, background, image), threads))
            else:
                more = bodies, view, parallel, background, image
                evaluated += sum(run(draw_ellipsoids, ranges, (*shared, *more), threads))
    if mode == "overdraw":
        rows = even_ranges(view.height, threads * TASKS_PER_THREAD)
        run(map_counts, rows, (counts, MOST_OVERDRAW, coefficients("inferno"), image), threads)
    elif not plain:
        composite_over(image, settings.background, camera)
    return ModePicture(
        image=image, runs=arranged.runs, pixel_splats=evaluated, milliseconds=clock.milliseconds
    )
