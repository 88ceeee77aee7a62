"""The CPU rasteriser against `quads` on this machine's GL, frame by frame in one run.

    python tools/bench/bench_cpu_vs_quads.py [SCENE ...] [--size WxH] [--frames N]

Both draw every view of an orbit, in turn, up to finished pixels; the ratio is that of the medians. Then the
CPU rasteriser draws them one after another: beside a GL in software it finds its caches emptied. No picture
is kept: a next one would have to be written to new memory.
Without a scene a synthetic one of 500,000 splats is drawn.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from bench_kernels import synthetic_scene
from harness import in_turn, load_scenes, make_parser, orbit_of, spread

from splatview import raster
from splatview.measure.machine import write_results
from splatview.renderers import make_renderer
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings


def compare(ctx, name: str, gaussians: Gaussians, size: tuple[int, int], frames: int) -> dict[str, Any]:
    settings = RenderSettings(blend="float32")
    view = orbit_of(gaussians, size)
    quads = make_renderer("quads", ctx)
    quads.load(gaussians)

    def draw(frame: int) -> None:
        quads.draw(FrameRequest(None, view(frame), settings))
        ctx.finish()

    pictures: dict[str, np.ndarray] = {}

    def draw_by_cpu(frame: int) -> None:
        pictures["cpu"] = raster.render(gaussians, view(frame), settings)

    times = in_turn({"quads": draw, "cpu": draw_by_cpu}, frames)
    in_a_row = in_turn({"cpu": draw_by_cpu}, frames)["cpu"]
    difference = float(np.abs(quads.read() - pictures["cpu"]).max())
    quads.close()
    return {
        "scene": name,
        "splats": len(gaussians),
        "size": list(size),
        "frames": frames,
        "median_ms": {renderer: own.median for renderer, own in times.items()},
        "range_ms": {renderer: own.range for renderer, own in times.items()},
        "in_a_row_ms": {"median": in_a_row.median, "range": in_a_row.range},
        "ratio": times["quads"].median / times["cpu"].median,
        "largest_difference": difference,
    }


def main() -> None:
    options = make_parser(__doc__, "cpu_vs_quads.json", scenes=True, size="1280x720", frames=15).parse_args()
    ctx = create_headless_context()
    results = []
    for name, gaussians in load_scenes(
        options.scenes, lambda: {"synthetic": synthetic_scene(500_000)}
    ).items():
        results.append(compare(ctx, name, gaussians, options.size, options.frames))
        print(results[-1], flush=True)
    write_results(
        options.output,
        {
            "gl": describe(ctx).renderer,
            "results": results,
            "table": {
                "columns": [
                    *("scene", "splats", "size", "`quads` ms", "`cpu` ms", "`cpu` is faster by"),
                    "`cpu` in a row, ms",
                ],
                "rows": [
                    [
                        result["scene"],
                        f"{result['splats']:,}",
                        f"{result['size'][0]}x{result['size'][1]}",
                        f"{result['median_ms']['quads']:.0f}",
                        f"{result['median_ms']['cpu']:.0f}",
                        f"{result['ratio']:.1f}x",
                        spread(result["in_a_row_ms"]["median"], result["in_a_row_ms"]["range"]),
                    ]
                    for result in results
                ],
                "note": f"Medians of {options.frames} views each, in turn, then by `cpu` alone one after "
                f"another (least to most); GL is {describe(ctx).renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
