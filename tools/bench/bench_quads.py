"""Frame time of `quads`, and of `cpu` beside it, while the camera turns: every frame projects and sorts anew.

    python tools/bench/bench_quads.py [SCENE ...] [--orbit x,y,z,radius,height] [--size WxH] [--frames N]

Without a scene: the demo landscape at 100,000 and 500,000 splats. The peers' figures were taken on scenes of
those counts at 1280x720, orbiting by 3 degrees a frame on --orbit 0,-0.2,0,8.7,3; a scene of one of those
counts is set beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import moderngl
import numpy as np
from harness import TURN, Timings, in_turn, load_scenes, make_parser, spread

from splatview import raster
from splatview.measure.machine import write_results
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.demo import demo_scene
from splatview.scene.framing import robust_bounds

WARM_UP = 2
"""Frames drawn before any is timed: programs compile, memory is touched."""

PEER_MACHINE = "2 cores AMD EPYC, llvmpipe 22.3"
PEERS = {
    "GaussianSplats3D 0.4.7": {100_000: (451, 498), 500_000: (1155, 1176)},
    "PlayCanvas engine 2.23.3": {100_000: (466, 485), 500_000: (1118, 1191)},
    "GaussianSplattingViewer": {100_000: (480, 480), 500_000: (1219, 1219)},
    "Spark 2.2.0 + three.js": {100_000: (674, 698), 500_000: (1656, 1740)},
}
"""Median ms a frame, lowest and highest of the runs, by peer and number of splats."""

Views = Callable[[int], Camera]


def orbit(target: np.ndarray, radius: float, height: float, size: tuple[int, int]) -> Views:
    """View i of an orbit about the vertical through `target`; `height` is the eye's y."""

    def view(i: int) -> Camera:
        angle = 0.23 + math.radians(TURN * i)
        eye = (target[0] + radius * math.sin(angle), height, target[2] + radius * math.cos(angle))
        return look_at(eye, target, fov_y=50, width=size[0], height=size[1])

    return view


def orbit_around(scene: Gaussians, size: tuple[int, int]) -> Views:
    """An orbit that shows all of `scene`, from a little above."""
    centre, radius = robust_bounds(scene.means)
    return orbit(centre, 2.0 * radius, float(centre[1] + 0.7 * radius), size)


def measure(
    ctx: moderngl.Context, name: str, scene: Gaussians, views: Views, frames: int
) -> list[dict[str, Any]]:
    """`quads` in each blend precision and without early stop, and `cpu`: frame by frame in turn."""
    variants = [("float16", None), ("float32", None), ("float32", 0.0)]
    renderers = []
    for _, stop in variants:
        renderer = QuadsRenderer(ctx)
        renderer.load(scene)
        if stop is not None:
            renderer.early_stop = stop
        renderers.append(renderer)

    def draw(i: int, frame: int) -> dict[str, float]:
        blend, _ = variants[i]
        renderers[i].draw(FrameRequest(None, views(frame), RenderSettings(blend=blend)))  # pyright: ignore[reportArgumentType]
        ctx.finish()
        return dict(renderers[i].stats(wait=True).ms)

    ways = {str(i): partial(draw, i) for i in range(len(variants))}

    def draw_by_cpu(frame: int) -> None:  # and keep no picture, for new memory is slow
        raster.render(scene, views(frame), RenderSettings())

    times = in_turn({**ways, "cpu": draw_by_cpu}, frames, warm_up=WARM_UP)
    results = []
    for i, (blend, _) in enumerate(variants):
        results.append(
            {
                "renderer": "quads",
                "blend": blend,
                "early_stop": renderers[i].early_stop,
                "visible": renderers[i].stats(wait=True).visible,
                **timing(name, scene, times[str(i)]),
                "stages_ms": times[str(i)].medians(),
            }
        )
        renderers[i].close()
    results.append({"renderer": "cpu", **timing(name, scene, times["cpu"])})
    return results


def timing(name: str, scene: Gaussians, times: Timings) -> dict[str, Any]:
    """Medians and spread, and the ratio to the least figure of the fastest peer for this number of splats."""
    fastest = min((min(figures.get(len(scene), (math.inf,))) for figures in PEERS.values()), default=math.inf)
    return {
        "scene": name,
        "splats": len(scene),
        "median_ms": times.median,
        "range_ms": times.range,
        "cpu_ms": float(np.median(times.cpu_ms)),
        "ratio_to_fastest_peer": times.median / fastest if math.isfinite(fastest) else None,
    }


def rows_of(results: list[dict[str, Any]]) -> list[list[str]]:
    """Ours and, where their figures are known, the peers', scene by scene."""
    rows = []
    for result in results:
        name = "`cpu`" if result["renderer"] == "cpu" else f"`quads`, {result['blend']}"
        if result.get("early_stop") == 0:
            name += ", no early stop"
        stages = result.get("stages_ms")
        split = " / ".join(f"{stages[stage]:.0f}" for stage in ("project", "sort", "draw")) if stages else ""
        ratio = result["ratio_to_fastest_peer"]
        share = "" if ratio is None else f"{ratio:.2f}"
        ms = spread(result["median_ms"], result["range_ms"])
        rows.append([f"splatview {name}", f"{result['splats']:,}", ms, split, share])
    for splats in sorted({result["splats"] for result in results}):
        known = {peer: figures[splats] for peer, figures in PEERS.items() if splats in figures}
        fastest = min((min(figures) for figures in known.values()), default=math.nan)
        for peer, (low, high) in known.items():
            ms = f"{low} to {high}" if high > low else f"{low}"
            rows.append([peer, f"{splats:,}", ms, "", f"{low / fastest:.2f}"])
    return sorted(rows, key=lambda row: int(row[1].replace(",", "")))


def main() -> None:
    parser = make_parser(__doc__, "quads.json", scenes=True, size="1280x720", frames=11)
    parser.add_argument("--orbit", help="x,y,z of the target, radius, height of the eye")
    options = parser.parse_args()
    width, height = options.size
    ctx = create_headless_context(require=430)
    demos = lambda: {f"demo {n:,}": demo_scene(splats=n) for n in (100_000, 500_000)}  # noqa: E731
    scenes = load_scenes(options.scenes, demos)
    results: list[dict[str, Any]] = []
    for name, scene in scenes.items():
        if options.orbit:
            x, y, z, radius, eye_height = (float(part) for part in options.orbit.split(","))
            views = orbit(np.array([x, y, z]), radius, eye_height, (width, height))
        else:
            views = orbit_around(scene, (width, height))
        for result in measure(ctx, name, scene, views, options.frames):
            print(result, flush=True)
            results.append(result)
    info = describe(ctx)
    write_results(
        options.output,
        {
            "gl": info.renderer,
            "size": [width, height],
            "frames": options.frames,
            "turn_degrees": TURN,
            "peers": {"machine": PEER_MACHINE, "median_ms": {k: dict(v) for k, v in PEERS.items()}},
            "results": results,
            "table": {
                "columns": ["renderer", "splats", "ms", "project / sort / draw", "of the fastest peer's"],
                "rows": rows_of(results),
                "note": f"Medians (least to most) of {options.frames} frames at {width}x{height}, GL by "
                f"{info.renderer}. The peers' figures (browsers and Python programs on {PEER_MACHINE}, the "
                "same scenes, the same orbit) are of other runs and good to some 15 %; those that sort "
                "asynchronously may have drawn an old order.",
            },
        },
    )


if __name__ == "__main__":
    main()
