"""Writes assets/benchmarks/raster.json and raster.png from bench_kernels.py.

python tools/bench/bench_raster.py [--full] [--threads N] [-o JSON]
"""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from bench_kernels import FLOPS_PER_PIXEL_SPLAT, QUICK, STAGES, measure_all, summary
from harness import make_parser

from splatview.measure.machine import write_results
from splatview.raster import available_threads

COLUMNS = {
    "project": ("project",),
    "sort": ("sort",),
    "bin": ("bin",),
    "forward": ("forward",),
    "backward": ("backward", "gather", "project_backward"),
}
"""Columns of the table and the stages that each adds up."""


def table(results: list[dict[str, Any]]) -> dict[str, Any]:
    rows = []
    for result in results:
        if (result["splats"], *result["size"]) not in QUICK:
            continue
        times = [f"{sum(result['ms'][stage] for stage in stages):.1f}" for stages in COLUMNS.values()]
        width, height = result["size"]
        rate = [f"{result['gpixel_splats_per_s']:.1f}", f"{result['share_of_peak']:.0%}"]
        rows.append([f"{result['splats']:,}", f"{width}x{height}", *times, f"{result['pairs']:,}", *rate])
    threads = results[0]["threads"]
    peak = max(result["peak_gflops"] for result in results)
    return {
        "columns": ["splats", "size", *COLUMNS, "pairs", "10⁹ pixel-splats/s a thread", "of its FMA peak"],
        "rows": rows,
        "note": f"Median ms by stage on {threads} threads. A pixel-splat is one evaluation of alpha and its "
        f"blending, {FLOPS_PER_PIXEL_SPLAT} floating-point operations, over the time of the whole forward "
        f"stage; the float32 FMA peak of a thread, measured in the same run, is {peak:.0f} GFLOP/s.",
    }


def plot(results: list[dict[str, Any]], path: Path) -> None:
    """Time by stage over the number of splats at the size measured most, and the share of the peak."""
    sizes = [tuple(result["size"]) for result in results]
    common = max(sizes, key=lambda size: (sizes.count(size), size))
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.5), constrained_layout=True)
    at_size = [result for result in results if tuple(result["size"]) == common]
    shown = at_size if len(at_size) > 1 else results
    for stage in STAGES:
        left.plot([r["splats"] for r in shown], [r["ms"][stage] for r in shown], "o-", label=stage)
    left.set(xscale="log", yscale="log", xlabel="splats", ylabel="ms")
    left.set_title(f"Stages at {common[0]}x{common[1]}" if len(at_size) > 1 else "Stages, size growing too")
    left.grid(alpha=0.3)
    left.legend(fontsize=8)
    for size in sorted(set(sizes)):
        line = [result for result in results if tuple(result["size"]) == size]
        counts, shares = [r["splats"] for r in line], [100 * r["share_of_peak"] for r in line]
        right.plot(counts, shares, "o-", label=f"{size[0]}x{size[1]}")
    right.axhline(30, color="grey", linestyle="--", linewidth=1)
    right.set(xscale="log", xlabel="splats", ylabel="% of float32 FMA peak", ylim=(0, None))
    right.set_title("Forward: arithmetic of the inner loop over the whole stage's time")
    right.grid(alpha=0.3)
    right.legend(fontsize=8)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = make_parser(__doc__, "raster.json")
    parser.add_argument("--full", action="store_true", help="all counts at all sizes: some minutes")
    parser.add_argument("--threads", type=int, default=available_threads())
    options = parser.parse_args()
    results = []
    for result in measure_all(full=options.full, threads=options.threads):
        print(summary(result), flush=True)
        results.append(result)
    versions = {name: version(name) for name in ("numba", "llvmlite", "numpy")}
    write_results(options.output, {"versions": versions, "results": results, "table": table(results)})
    plot(results, options.output.with_suffix(".png"))


if __name__ == "__main__":
    main()
