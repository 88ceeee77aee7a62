"""The renderer by tiles against `quads` on this machine's GL, frame by frame in one run.

    python tools/bench/bench_tiles.py [SCENE ...] [--size WxH] [--frames N]

Both draw every view of an orbit, in turn, up to finished pixels; the ratio is that of the medians. Without
a scene a synthetic one of 100,000 splats is drawn.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from bench_kernels import synthetic_scene
from harness import in_turn, load_scenes, make_parser, orbit_of, spread

from splatview.measure.machine import write_results
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings


def compare(ctx, name: str, gaussians: Gaussians, size: tuple[int, int], frames: int) -> dict[str, Any]:
    settings, view = RenderSettings(blend="float32"), orbit_of(gaussians, size)
    renderers = {"quads": QuadsRenderer(ctx), "tiles": TilesRenderer(ctx)}
    differences: list[float] = []
    for renderer in renderers.values():
        renderer.load(gaussians)

    def draw(renderer: QuadsRenderer | TilesRenderer, frame: int) -> dict[str, float]:
        renderer.draw(FrameRequest(None, view(frame), settings))
        ctx.finish()
        return dict(renderer.stats(wait=True).ms)

    def difference(frame: int) -> None:
        pictures = [renderer.read() for renderer in renderers.values()]
        differences.append(float(np.abs(pictures[0] - pictures[1]).max()))

    ways = {each: partial(draw, renderer) for each, renderer in renderers.items()}
    times = in_turn(ways, frames, after_round=difference)
    for renderer in renderers.values():
        renderer.close()
    return {
        "scene": name,
        "splats": len(gaussians),
        "size": list(size),
        "frames": frames,
        "median_ms": {each: own.median for each, own in times.items()},
        "range_ms": {each: own.range for each, own in times.items()},
        "stages_ms": {each: own.medians() for each, own in times.items()},
        "ratio": times["tiles"].median / times["quads"].median,
        "largest_difference": max(differences),
    }


def main() -> None:
    options = make_parser(__doc__, "tiles.json", scenes=True, size="1280x720", frames=15).parse_args()
    ctx = create_headless_context(require=430)
    results = []
    for name, gaussians in load_scenes(
        options.scenes, lambda: {"synthetic": synthetic_scene(100_000)}
    ).items():
        results.append(compare(ctx, name, gaussians, options.size, options.frames))
        print(results[-1], flush=True)
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
                        *(
                            spread(result["median_ms"][one], result["range_ms"][one])
                            for one in ("quads", "tiles")
                        ),
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
