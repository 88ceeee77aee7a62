"""The renderer by tiles against `quads` on this machine's GL, frame by frame in one run.

    python tools/bench/bench_tiles.py [SCENE ...] [--size WxH] [--frames N]

Both draw every view of an orbit, in turn, up to finished pixels; the ratio is that of the medians. Without
a scene a synthetic one of 100,000 splats is drawn.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench_cpu_vs_quads import TURN, turned
from bench_kernels import synthetic_scene

from splatview.measure.machine import FOLDER, write_results
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera, robust_bounds

STAGES = ("project", "sort", "draw")


def compare(ctx, name: str, gaussians: Gaussians, size: tuple[int, int], frames: int) -> dict[str, Any]:
    settings = RenderSettings(blend="float32")
    camera = frame_camera(gaussians, *size)
    centre, _ = robust_bounds(gaussians.means)
    renderers = {"quads": QuadsRenderer(ctx), "tiles": TilesRenderer(ctx)}
    times: dict[str, list[float]] = {each: [] for each in renderers}
    stages: dict[str, list[dict[str, float]]] = {each: [] for each in renderers}
    difference = 0.0
    for frame in range(frames + 1):
        view = turned(camera, centre, TURN * frame)
        for each, renderer in renderers.items():
            if frame == 0:
                renderer.load(gaussians)
            begun = time.perf_counter()
            renderer.draw(FrameRequest(None, view, settings))
            ctx.finish()
            milliseconds = 1000 * (time.perf_counter() - begun)
            if frame > 0:  # in the first programs are compiled and buffers made
                times[each].append(milliseconds)
                stages[each].append(dict(renderer.stats(wait=True).ms))
        pictures = [renderer.read() for renderer in renderers.values()]
        difference = max(difference, float(np.abs(pictures[0] - pictures[1]).max()))
    for renderer in renderers.values():
        renderer.close()
    medians = {each: float(np.median(values)) for each, values in times.items()}
    return {
        "scene": name,
        "splats": len(gaussians),
        "size": list(size),
        "frames": frames,
        "median_ms": medians,
        "range_ms": {each: [min(values), max(values)] for each, values in times.items()},
        "stages_ms": {
            each: {stage: float(np.median([ms[stage] for ms in values])) for stage in STAGES}
            for each, values in stages.items()
        },
        "ratio": medians["tiles"] / medians["quads"],
        "largest_difference": difference,
    }


def cell(result: dict[str, Any], renderer: str) -> str:
    low, high = result["range_ms"][renderer]
    return f"{result['median_ms'][renderer]:.0f} ({low:.0f} to {high:.0f})"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--frames", type=int, default=15)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "tiles.json")
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    ctx = create_headless_context(require=430)
    scenes = [(path.name, load_scene(path)) for path in options.scenes]
    scenes = scenes or [("synthetic", synthetic_scene(100_000))]
    results = []
    for name, gaussians in scenes:
        result = compare(ctx, name, gaussians, (width, height), options.frames)
        print(result, flush=True)
        results.append(result)
    write_results(
        options.output,
        {
            "gl": describe(ctx).renderer,
            "results": results,
            "table": {
                "columns": ["scene", "splats", "size", "`quads` ms", "`tiles` ms", "ratio"],
                "rows": [
                    [
                        result["scene"],
                        f"{result['splats']:,}",
                        f"{result['size'][0]}x{result['size'][1]}",
                        cell(result, "quads"),
                        cell(result, "tiles"),
                        f"{result['ratio']:.2f}",
                    ]
                    for result in results
                ],
                "note": f"Medians (and range) of {options.frames} views each, in turn, both in float32; GL "
                f"is {describe(ctx).renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
