"""Scenes from and to .splat: 32 bytes per splat and nothing else, in the layout of antimatter15's viewer.

Three float32 of the mean, three of the standard deviations (not their logarithms), red, green, blue and
opacity in bytes, and the quaternion wxyz in bytes. There is no header, so the suffix alone tells the format.
Decoders differ by half a step in how they read a quaternion's bytes ((b - 128) / 128 here, b / 127.5 - 1 in
splat-transform); its length does not count.
"""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np

from splatview.scene.errors import InputError
from splatview.scene.formats.io import atomic_write
from splatview.scene.formats.packing import SLICE, check_room, logits_of, opacity_levels, storable, unit_quats
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import Progress
from splatview.scene.sh import SH_C0, rgb_to_sh

ROW = np.dtype(
    [("mean", "<f4", 3), ("scale", "<f4", 3), ("rgb", "u1", 3), ("opacity", "u1"), ("quat", "u1", 4)]
)

RANGES = {"colours": (-0.5 / SH_C0, 0.5 / SH_C0)}
"""What its numbers reach to: from black to white."""


def read_splat(file: io.BufferedReader, path: Path, progress: Progress, room: float) -> Gaussians:
    """Splats of SH degree 0. Raises InputError and Cancelled."""
    size = os.fstat(file.fileno()).st_size
    if size % ROW.itemsize:
        raise InputError(
            f"{path}: {size:,} bytes are no whole number of splats (of {ROW.itemsize}): it is truncated, or "
            "no .splat file"
        )
    n = size // ROW.itemsize
    check_room(path, n, 0, room)
    means, log_scales = np.empty((n, 3), np.float32), np.empty((n, 3), np.float32)
    quats, sh, opacity_logits = (
        np.empty((n, 4), np.float32),
        np.empty((n, 1, 3), np.float32),
        np.empty(n, np.float32),
    )
    start = 0
    while rows_read := file.read(SLICE * ROW.itemsize):
        rows = np.frombuffer(rows_read, ROW, count=len(rows_read) // ROW.itemsize)
        stop = min(start + len(rows), n)
        rows = rows[: stop - start]
        means[start:stop] = rows["mean"]
        with np.errstate(divide="ignore", invalid="ignore"):
            log_scales[start:stop] = np.log(rows["scale"])
        sh[start:stop, 0] = rgb_to_sh(rows["rgb"] / np.float32(255))
        opacity_logits[start:stop] = logits_of(rows["opacity"] / 255)
        quats[start:stop] = (rows["quat"].astype(np.float32) - 128) / 128
        start = stop
        progress.step(start / n)
    if start < n:
        raise InputError(f"{path}: became shorter while it was read")
    return Gaussians(means=means, quats=quats, log_scales=log_scales, opacity_logits=opacity_logits, sh=sh)


def save_splat(gaussians: Gaussians, path: Path, progress: Progress) -> None:
    """Writes all splats that are storable, large and opaque ones first, as viewers that load gradually want
    them. Raises InputError and Cancelled."""
    kept = np.flatnonzero(storable(gaussians))
    with np.errstate(over="ignore"):
        size = gaussians.log_scales[kept].sum(axis=1) + np.minimum(gaussians.opacity_logits[kept], 0)
    order = kept[np.argsort(-size, kind="stable")]
    with atomic_write(path) as file:
        for start in range(0, len(order), SLICE):
            at = order[start : start + SLICE]
            rows = np.empty(len(at), ROW)
            rows["mean"] = gaussians.means[at]
            with np.errstate(over="ignore"):
                rows["scale"] = np.exp(gaussians.log_scales[at])
            rows["rgb"] = np.clip(np.rint((0.5 + SH_C0 * gaussians.sh[at, 0]) * 255), 0, 255)
            rows["opacity"] = opacity_levels(gaussians.opacity_logits[at])
            rows["quat"] = np.clip(np.rint(unit_quats(gaussians.quats[at]) * 128 + 128), 0, 255)
            file.write(rows.tobytes())
            progress.step(min(start + SLICE, len(order)) / len(order))
