"""Palettes of SH: the groups of `palette.vectors` against mini-batch k-means over all, at equal numbers of
entries.

    python tools/bench/bench_palette.py SCENE ... [--entries 1024 4096 16384] [-o JSON]

Mini-batch k-means (Sculley 2010) takes some rows at a time and moves each centroid towards those that are
nearest to it, the less the more it has seen; its distances are a compiled kernel's, on all cores. Measured as
it is, and within each group in place of Lloyd's iteration. dB of the six views of `convert`, of the scene
whose SH are the palette's and whose other numbers are exact.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from harness import load_scenes, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.conversion import sample_views
from splatview.renderers.rate_distortion import Judge
from splatview.scene import Gaussians
from splatview.scene.compiling import available_threads, compiled_into, even_ranges, run
from splatview.scene.demo import demo_scene
from splatview.scene.formats import palette
from splatview.scene.formats.sog_write import importance

BATCH = 4096
"""Rows of a step."""

PASSES = 3
"""Over all rows."""

Way = Callable[[palette.Rows, np.ndarray, int], tuple[np.ndarray, np.ndarray]]


def _nearest(start, stop, rows, columns, half_squares, labels, scores):
    """Index of the centroid nearest to each row; `columns` (D, C): of the centroids, so that LLVM makes
    vectors over them. `scores`: room (rows, C)."""
    for i in range(start, stop):
        score = scores[i]
        for c in range(columns.shape[1]):
            score[c] = -half_squares[c]
        for d in range(columns.shape[0]):
            number = rows[i, d]
            for c in range(columns.shape[1]):
                score[c] += number * columns[d, c]
        best = 0
        for c in range(columns.shape[1]):
            if score[c] > score[best]:
                best = c
        labels[i] = best


nearest_kernel = compiled_into(None, _nearest, fastmath={"contract"})


def nearest(rows: np.ndarray, centroids: np.ndarray) -> np.ndarray:
    """(N,) indices of the nearest centroids."""
    labels = np.empty(len(rows), np.int32)
    columns = np.ascontiguousarray(centroids.T)
    half_squares = 0.5 * np.einsum("cd,cd->c", centroids, centroids)
    scores = np.empty((min(BATCH, len(rows)), len(centroids)), np.float32)
    for start in range(0, len(rows), BATCH):
        part, own = rows[start : start + BATCH], labels[start : start + BATCH]
        arguments = (part, columns, half_squares, own, scores)
        run(nearest_kernel, even_ranges(len(part), 16), arguments, available_threads())
    return labels


def mini_batch(rows: np.ndarray, weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """At most `count` centroids, from random rows, the likelier the heavier."""
    if len(rows) <= count:
        return rows
    probabilities = weights / weights.sum()
    count = min(count, int(np.count_nonzero(probabilities)))
    centroids = rows[rng.choice(len(rows), count, replace=False, p=probabilities)]
    mass = np.zeros(count)
    for _ in range(PASSES):
        order = rng.permutation(len(rows))
        for start in range(0, len(order), BATCH):
            at = order[start : start + BATCH]
            part, held = np.ascontiguousarray(rows[at]), weights[at]
            labels = nearest(part, centroids)
            new = np.bincount(labels, held, count)
            sums = np.stack([np.bincount(labels, held * column, count) for column in part.T], axis=1)
            mass += new
            moved = np.flatnonzero(new)
            steps = (sums[moved] - new[moved, None] * centroids[moved]) / mass[moved, None]
            centroids[moved] += steps.astype(np.float32)
    return centroids


def all_at_once(rows: palette.Rows, weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    everything = rows[slice(None)]
    centroids = mini_batch(everything, weights + 1e-12 * weights.max(), count, np.random.default_rng(0))
    return centroids, nearest(everything, centroids)


def in_groups(rows: palette.Rows, weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    lloyd, palette._clustered = palette._clustered, mini_batch
    try:
        return palette.vectors(rows, weights, count)
    finally:
        palette._clustered = lloyd


WAYS: dict[str, Way] = {
    "groups, Lloyd": palette.vectors,
    "groups, mini-batch": in_groups,
    "mini-batch over all": all_at_once,
}


def measured(scene: Gaussians, judge: Judge, way: Way, count: int) -> dict[str, Any]:
    """Seconds, dB, and the weighted mean squared error of a coefficient."""
    order = np.arange(len(scene))
    rows, weights = palette.Rows(scene.sh[:, 1:], order), importance(scene, order)
    begun = time.perf_counter()
    centroids, labels = way(rows, weights, count)
    seconds = time.perf_counter() - begun
    found = centroids[labels].reshape(len(scene), -1, 3)
    squares = np.square(found.astype(np.float64) - scene.sh[:, 1:]).mean(axis=(1, 2))
    error, _ = judge.error(replace(scene, sh=np.concatenate([scene.sh[:, :1], found], axis=1)))
    psnr = -10 * math.log10(error) if error else None
    return {"seconds": seconds, "psnr": psnr, "error": float(np.average(squares, weights=weights))}


def main() -> None:
    parser = make_parser(__doc__, "palette.json", scenes=True)
    parser.add_argument("--entries", type=int, nargs="+", default=[1024, 4096, 16384])
    options = parser.parse_args()
    results, rows = [], []
    for name, scene in load_scenes(options.scenes, lambda: {"the demo": demo_scene()}).items():
        if scene.sh_degree == 0:
            parser.error(f"{name} has no SH above the constant band")
        judge = Judge(scene, sample_views(scene))
        for way in WAYS.values():  # kernels are compiled
            measured(scene.take(np.arange(min(len(scene), 3000))), judge.of_first(0), way, 16)
        for count in options.entries:
            if count >= len(scene):
                continue
            found = {label: measured(scene, judge, way, count) for label, way in WAYS.items()}
            for label, one in found.items():
                results.append({"scene": name, "entries": count, "way": label, **one})
                print(results[-1], flush=True)
            cells = [f"{one['psnr'] or math.inf:.2f} dB, {one['seconds']:.2f} s" for one in found.values()]
            rows.append([name, f"{count:,}", *cells])
            table = {"columns": ["scene", "entries", *WAYS], "rows": rows, "note": "One run each."}
            write_results(options.output, {"results": results, "table": table})


if __name__ == "__main__":
    main()
