"""Palettes of SH: mini-batch k-means as `palette.vectors` has it, against Lloyd's iteration, distances of a
compiled kernel, and all in one group, at equal numbers of entries.

    python tools/bench/bench_palette.py SCENE ... [--entries 1024 4096 16384] [-o JSON]

Lloyd's iteration is in groups of more and fewer splats, as suits it. dB of the six views of `convert`, of the
scene whose SH are the palette's and whose other numbers are exact.
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

ROUNDS = 12
"""Of Lloyd's iteration."""

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


def compiled_nearest(rows: np.ndarray | palette.Rows, centroids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `palette.nearest`, whose squared distances are only made by the calls that use them: of all rows."""
    if isinstance(rows, palette.Rows):
        return blas_nearest(rows, centroids)
    labels = np.empty(len(rows), np.int32)
    columns = np.ascontiguousarray(centroids.T)
    half_squares = 0.5 * np.einsum("cd,cd->c", centroids, centroids)
    scores = np.empty((len(rows), len(centroids)), np.float32)
    arguments = (rows, columns, half_squares, labels, scores)
    run(nearest_kernel, even_ranges(len(rows), 16), arguments, available_threads())
    return labels, np.zeros(0, np.float32)


def lloyd(rows: palette.Rows, weights: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """As `palette._clustered`, all rows in each round."""
    held = rows[slice(None)]
    if len(held) <= count:
        return held
    probabilities = weights / weights.sum()
    count = min(count, int(np.count_nonzero(probabilities)))
    centroids = held[rng.choice(len(held), count, replace=False, p=probabilities)]
    for _ in range(ROUNDS):
        labels, errors = palette.nearest(held, centroids)
        mass = np.bincount(labels, weights, count)
        sums = np.stack([np.bincount(labels, weights * column, count) for column in held.T], axis=1)
        empty = np.flatnonzero(mass == 0)
        centroids = (sums / np.where(mass > 0, mass, 1)[:, None]).astype(np.float32)
        centroids[empty] = held[np.argsort(-weights * errors)[: len(empty)]]
    return centroids


blas_nearest = palette.nearest


def changed(**changes: Callable[[int], Any]) -> Way:
    """`palette.vectors` with some of its module replaced by what is told for a number of entries."""

    def way(rows: palette.Rows, weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        before = {name: getattr(palette, name) for name in changes}
        try:
            for name, change in changes.items():
                setattr(palette, name, change(count))
            return palette.vectors(rows, weights, count)
        finally:
            for name, value in before.items():
                setattr(palette, name, value)

    return way


WAYS: dict[str, Way] = {
    "mini-batch": palette.vectors,
    "Lloyd": changed(_clustered=lambda count: lloyd, GROUP=lambda count: int(2 * math.sqrt(count))),
    "compiled distances": changed(nearest=lambda count: compiled_nearest),
    "one group": changed(GROUP=lambda count: count),
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
