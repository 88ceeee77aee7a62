"""Frame time of `quads` and `tiles` where OpenGL runs on a GPU, from 100,000 splats to millions, in one run.

    python tools/bench/bench_gpu.py [SCENE ...] [--size WxH] [--frames N] [--counts N ...] [-o JSON]

Every view of an orbit is drawn by each way in turn, up to finished pixels; then each way draws all views of
the orbit without waiting between them, as a window does that shows every frame. Each picture of the last
view is compared with that of `cpu`. Scenes come first, then synthetic ones of --counts splats, SH degree 3.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from bench_kernels import synthetic_scene
from harness import in_turn, load_scenes, make_parser, orbit_of, spread

from splatview import raster
from splatview.measure.machine import write_results
from splatview.measure.metrics import psnr
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings

WAYS = {
    "`quads`, float16": (QuadsRenderer, RenderSettings(blend="float16")),
    "`quads`, float32": (QuadsRenderer, RenderSettings(blend="float32")),
    "`tiles`": (TilesRenderer, RenderSettings(blend="float32")),
}
"""Renderer and settings."""

WARM_UP = 3
"""Frames drawn before any is timed: programs compile, memory is touched, clocks rise."""


def compare(ctx: Any, name: str, gaussians: Gaussians, size: tuple[int, int], frames: int) -> dict[str, Any]:
    """Milliseconds a frame of every way, and its picture against that of `cpu`."""
    view = orbit_of(gaussians, size)
    renderers = {}
    for way, (kind, settings) in WAYS.items():
        renderers[way] = (kind(ctx), settings)
        renderers[way][0].load(gaussians)

    def draw(way: str, frame: int) -> dict[str, float]:
        renderer, settings = renderers[way]
        renderer.draw(FrameRequest(None, view(frame), settings))
        ctx.finish()
        return dict(renderer.stats(wait=True).ms)

    ways: dict[str, Callable[[int], Any]] = {way: partial(draw, way) for way in WAYS}
    times = in_turn(ways, frames, warm_up=WARM_UP)
    truth = raster.render(gaussians, view(frames - 1), RenderSettings())
    results = {}
    for way, (renderer, settings) in renderers.items():
        renderer.draw(FrameRequest(None, view(frames - 1), settings))
        picture = renderer.read()
        ctx.finish()
        begun = time.perf_counter()
        for frame in range(frames):
            renderer.draw(FrameRequest(None, view(frames + frame), settings))
        ctx.finish()
        results[way] = {
            "median_ms": times[way].median,
            "range_ms": times[way].range,
            "stages_ms": times[way].medians(),
            "unwaited_ms": 1e3 * (time.perf_counter() - begun) / frames,
            "visible": renderer.stats(wait=True).visible,
            "psnr_to_cpu": psnr(picture[..., :3], truth[..., :3]),
            "largest_difference": float(np.abs(picture - truth).max()),
        }
        renderer.close()
    return {"scene": name, "splats": len(gaussians), "size": list(size), "frames": frames, "ways": results}


def row_of(result: dict[str, Any]) -> list[str]:
    """Milliseconds by way, and the least agreement with `cpu`."""
    ways = result["ways"].values()
    return [
        result["scene"].removesuffix(f" {result['splats']:,}"),
        f"{result['splats']:,}",
        *(f"{spread(way['median_ms'], way['range_ms'], 1)}; {way['unwaited_ms']:.1f}" for way in ways),
        f"{min(way['psnr_to_cpu'] for way in ways):.0f}",
    ]


def main() -> None:
    parser = make_parser(__doc__, "gpu.json", scenes=True, size="1920x1080", frames=20)
    parser.add_argument("--counts", type=int, nargs="*", default=[100_000, 1_000_000, 6_000_000])
    options = parser.parse_args()
    ctx = create_headless_context(require=430)
    scenes: dict[str, Callable[[], Gaussians]] = {
        path.name: partial(lambda path: load_scenes([path], dict)[path.name], path) for path in options.scenes
    }
    scenes |= {f"synthetic {count:,}": partial(synthetic_scene, count) for count in options.counts}
    results = []
    for name, load in scenes.items():
        results.append(compare(ctx, name, load(), options.size, options.frames))
        print(results[-1], flush=True)
    info = describe(ctx)
    write_results(
        options.output,
        {
            "gl": info.renderer,
            "version": info.version,
            "results": results,
            "table": {
                "columns": ["scene", "splats", *(f"{way}, ms" for way in WAYS), "dB to `cpu`"],
                "rows": [row_of(result) for result in results],
                "note": f"Medians (least to most) of {options.frames} views at "
                f"{options.size[0]}x{options.size[1]}, in turn, each up to finished pixels; then the mean of "
                f"as many frames in a row, waited for at the end. GL is {info.renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
