"""Gradients of a loss by everything that made a picture."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from splatview.raster.backward import SUMS, differentiate_tiles, gather_pairs
from splatview.raster.compiling import TASKS_PER_THREAD, run
from splatview.raster.frame import Frame, StageClock, bands_of, tile_ranges
from splatview.raster.parameters import NO_SHARE, Parameters, describe
from splatview.raster.project_backward import POSE_BLOCK, project_backward
from splatview.raster.sort import empty_at_line

BRIGHT = 1e18
"""Colours that the backward pass multiplies in float32. Where a splat is brighter, the gradient of the loss
is made smaller by a power of two for that pass, so that no product is infinite."""

MAX_SUMMED_PAIRS = 5 << 20
"""Pairs whose sums are in memory at once, 64 bytes each in float32: a third of a GiB, which leaves room for
the compiler beside 5 million splats in 4 GiB."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Gradients:
    """dL/d(...), in the dtypes of the parameters; 0 for splats that were not visible."""

    parameters: Parameters
    means2d: np.ndarray | None
    """(N, 2), gradient by the mean in the image, px. This and the two below are None unless asked for."""
    abs_means2d: np.ndarray | None
    """(N, 2), px: sums over pixels of the absolute gradient by the mean in the image (Ye et al. 2024,
    AbsGS)."""
    background: np.ndarray
    """(3,)"""
    pose: np.ndarray | None
    """(6,) float64, gradient by a small motion of the camera, (shift, turn) in camera axes: a point at t in
    camera axes moves to t + shift + turn x t, so world_to_camera becomes exp([turn,
    shift])·world_to_camera."""
    milliseconds: dict[str, float]
    """Wall-clock time by stage."""


def differentiate(
    splats: Parameters,
    frame: Frame,
    d_image: np.ndarray,
    *,
    by_view: bool = True,
    reuse: Gradients | None = None,
) -> Gradients:
    """Gradients from `d_image` (H, W, 4), dL/d(image) in the picture's dtype, alpha included.

    `splats` must be what the frame was drawn from, and its workspace not used since. `by_view`: whether those
    by means in the image and by the camera's pose are wanted: a step without takes 0.93 of the time on 20,000
    splats, 0.96 on 100,000 (kernels_by_view.json, where frames, which are the same, take 1.02). `reuse` gives
    the arrays of earlier gradients to be overwritten, if they fit: fresh memory costs time where scenes are
    large.

    Raises:
        ValueError: d_image has the wrong shape or dtype, the image model's max_alpha is not below 1,
            or the picture was drawn with edits in force or with a sigma cut.
    """
    dtype = frame.image.dtype
    if not isinstance(d_image, np.ndarray) or d_image.shape != frame.image.shape or d_image.dtype != dtype:
        raise ValueError(f"d_image must be {dtype} {frame.image.shape}, got {describe(d_image)}")
    if not frame.view.max_alpha < 1:
        raise ValueError("gradients need an image model with max_alpha below 1")
    if frame.edited:
        raise ValueError("a picture drawn with edits in force has no gradients: bake the edits first")
    if frame.surfels is not None:
        raise ValueError("a picture of discs has no gradients: draw it with ellipsoids")
    if frame.by_pixel:
        raise ValueError("a picture in per-pixel order has no gradients: draw it in the 32-bit order")
    if frame.view.log2_share != NO_SHARE:
        raise ValueError("a picture drawn with a sigma cut has no gradients: set sigma_cut to None")
    excess = 2.0 ** math.ceil(math.log2(max(frame.brightest / BRIGHT, 1.0)))
    d_image = np.ascontiguousarray(d_image if excess == 1 else d_image / dtype.type(excess))
    clock = StageClock()
    splat_sums, background = _splat_sums(frame, d_image, by_view, clock)
    with clock.stage("project_backward"):
        gradients, means2d, abs_means2d, pose = _parameters(splats, frame, splat_sums, excess, by_view, reuse)
    return Gradients(
        parameters=gradients,
        means2d=means2d,
        abs_means2d=abs_means2d,
        background=(background * excess).astype(dtype),
        pose=pose,
        milliseconds=clock.milliseconds,
    )


def _splat_sums(
    frame: Frame, d_image: np.ndarray, by_view: bool, clock: StageClock
) -> tuple[np.ndarray, np.ndarray]:
    """(N, SUMS), see `backward`, rows of visible splats only; and the gradient by the background (3,)."""
    bins, workspace, threads = frame.bins, frame.workspace, frame.threads
    dtype = frame.image.dtype
    tiles = len(bins.offsets) - 1
    splat_sums = workspace.take("splat_sums", (len(frame.records) * SUMS,), dtype)
    walked = workspace.take("walked", (tiles,), np.int64)
    d_background = np.empty((tiles, 3))
    cursors = workspace.take("cursors", bins.positions.shape, np.int64)
    bands = bands_of(bins.offsets, MAX_SUMMED_PAIRS)
    for number, band in enumerate(bands):
        lists = frame.lists
        if bands != bins.bands:
            with clock.stage("bin"):
                lists = bins.write(band, workspace)
        base, end = int(bins.offsets[band[0]]), int(bins.offsets[band[1]])
        sums = workspace.take("pair_sums", ((end - base) * SUMS,), dtype)
        with clock.stage("backward"):
            picture = (frame.records, frame.view, frame.background, frame.transmittance, frame.n_contrib)
            run(
                differentiate_tiles,
                tile_ranges(bins.offsets, band, threads * TASKS_PER_THREAD),
                (bins.offsets, base, lists, *picture, d_image, sums, walked, d_background, by_view or None),
                threads,
            )
        with clock.stage("gather"):
            cursors[:] = bins.positions
            splats = (bins.order, bins.runs, bins.spans)
            run(
                gather_pairs,
                [(*piece, row) for piece, row in zip(bins.pieces, cursors, strict=True)],
                (*splats, *band, bins.offsets, base, walked, sums, splat_sums, number > 0),
                threads,
            )
    return splat_sums.reshape(-1, SUMS), d_background.sum(axis=0)


def _parameters(
    splats: Parameters,
    frame: Frame,
    splat_sums: np.ndarray,
    excess: float,
    by_view: bool,
    reuse: Gradients | None,
) -> tuple[Parameters, np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    count = len(splats.means)
    fits = reuse is not None and all(
        old.shape == array.shape and old.dtype == array.dtype
        for old, array in zip(reuse.parameters, splats, strict=True)
    )
    if reuse is not None and fits:
        gradients, means2d, abs_means2d = reuse.parameters, reuse.means2d, reuse.abs_means2d
    else:
        gradients, means2d, abs_means2d = (
            Parameters(*(empty_at_line(array.shape, array.dtype) for array in splats)),
            None,
            None,
        )
    pose_sums = None
    if by_view:
        if means2d is None or abs_means2d is None:
            means2d, abs_means2d = (np.empty((count, 2), splats.quats.dtype) for _ in range(2))
        pose_sums = np.zeros((-(-count // POSE_BLOCK), 6))
    else:
        means2d = abs_means2d = None
    drawn = (frame.visible, *splats, frame.sh_degree, frame.view, frame.optics)
    run(
        project_backward,
        [(*piece, *found) for piece, found in zip(frame.pieces, frame.runs, strict=True)],
        (*drawn, splat_sums, excess, *gradients, means2d, abs_means2d, pose_sums),
        frame.threads,
    )
    return gradients, means2d, abs_means2d, None if pose_sums is None else pose_sums.sum(axis=0)
