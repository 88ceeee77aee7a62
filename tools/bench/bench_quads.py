"""Frame time of `quads`, and of `cpu` beside it, while the camera turns: every frame projects and sorts anew.

    python tools/bench/bench_quads.py [SCENE ...] [--orbit x,y,z,radius,height] [--size WxH] [--frames N]

Without a scene: the demo landscape at 100,000 and 500,000 splats. The peers' figures were taken on scenes of
those counts at 1280x720, orbiting by 3 degrees a frame on --orbit 0,-0.2,0,8.7,3; a scene of one of those
counts is set beside them.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from splatview import raster
from splatview.measure.machine import FOLDER, write_results
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.demo import demo_scene
from splatview.scene.formats import load_scene
from splatview.scene.framing import robust_bounds

TURN = 3.0
"""Degrees a frame."""

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
    times: list[list[float]] = [[] for _ in variants]
    cpu: list[list[float]] = [[] for _ in variants]
    stages: list[list[dict[str, float]]] = [[] for _ in variants]
    raster_times: list[float] = []
    raster_cpu: list[float] = []
    for frame in range(WARM_UP + frames):
        for i, (renderer, (blend, _)) in enumerate(zip(renderers, variants, strict=True)):
            begun, cpu_begun = time.perf_counter(), time.process_time()
            renderer.draw(FrameRequest(None, views(frame), RenderSettings(blend=blend)))  # pyright: ignore[reportArgumentType]
            ctx.finish()
            elapsed = 1000 * (time.perf_counter() - begun)
            if frame >= WARM_UP:
                times[i].append(elapsed)
                cpu[i].append(1000 * (time.process_time() - cpu_begun))
                stages[i].append(dict(renderer.stats(wait=True).ms))
        begun, cpu_begun = time.perf_counter(), time.process_time()
        raster.render(scene, views(frame), RenderSettings())
        if frame >= WARM_UP:
            raster_times.append(1000 * (time.perf_counter() - begun))
            raster_cpu.append(1000 * (time.process_time() - cpu_begun))
    results = []
    for i, (blend, _) in enumerate(variants):
        results.append(
            {
                "renderer": "quads",
                "blend": blend,
                "early_stop": renderers[i].early_stop,
                "visible": renderers[i].stats(wait=True).visible,
                **timing(name, scene, times[i], cpu[i]),
                "stages_ms": {key: float(np.median([one[key] for one in stages[i]])) for key in stages[i][0]},
            }
        )
        renderers[i].release()
    results.append({"renderer": "cpu", **timing(name, scene, raster_times, raster_cpu)})
    return results


def timing(name: str, scene: Gaussians, wall_ms: list[float], cpu_ms: list[float]) -> dict[str, Any]:
    """Medians and spread, and the ratio to the least figure of the fastest peer for this number of splats."""
    median = float(np.median(wall_ms))
    fastest = min((min(figures.get(len(scene), (math.inf,))) for figures in PEERS.values()), default=math.inf)
    return {
        "scene": name,
        "splats": len(scene),
        "median_ms": median,
        "range_ms": [min(wall_ms), max(wall_ms)],
        # Of all threads: twice this over the wall time of two cores tells whether others used them.
        "cpu_ms": float(np.median(cpu_ms)),
        "ratio_to_fastest_peer": median / fastest if math.isfinite(fastest) else None,
    }


def rows_of(results: list[dict[str, Any]]) -> list[list[str]]:
    """Ours and, where their figures are known, the peers', scene by scene."""
    rows = []
    for result in results:
        low, high = result["range_ms"]
        name = "`cpu`" if result["renderer"] == "cpu" else f"`quads`, {result['blend']}"
        if result.get("early_stop") == 0:
            name += ", no early stop"
        stages = result.get("stages_ms")
        split = " / ".join(f"{stages[stage]:.0f}" for stage in ("project", "sort", "draw")) if stages else ""
        ratio = result["ratio_to_fastest_peer"]
        share = "" if ratio is None else f"{ratio:.2f}"
        spread = f"{result['median_ms']:.0f} ({low:.0f} to {high:.0f})"
        rows.append([f"splatview {name}", f"{result['splats']:,}", spread, split, share])
    for splats in sorted({result["splats"] for result in results}):
        known = {peer: figures[splats] for peer, figures in PEERS.items() if splats in figures}
        fastest = min((min(figures) for figures in known.values()), default=math.nan)
        for peer, (low, high) in known.items():
            spread = f"{low} to {high}" if high > low else f"{low}"
            rows.append([peer, f"{splats:,}", spread, "", f"{low / fastest:.2f}"])
    return sorted(rows, key=lambda row: int(row[1].replace(",", "")))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--orbit", help="x,y,z of the target, radius, height of the eye")
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--frames", type=int, default=11)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "quads.json")
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    ctx = create_headless_context(require=430)
    scenes = [(path.name, load_scene(path)) for path in options.scenes]
    scenes = scenes or [(f"demo {n:,}", demo_scene(splats=n)) for n in (100_000, 500_000)]
    results: list[dict[str, Any]] = []
    for name, scene in scenes:
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
