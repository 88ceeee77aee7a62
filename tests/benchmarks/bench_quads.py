"""Frame time of `quads` while the camera turns, so that every frame projects and sorts anew.

    python tests/benchmarks/bench_quads.py [SCENE ...] [--orbit x,y,z,radius,height] [--size WxH] [--frames N]

Without a scene: the demo landscape at 100,000 and 500,000 splats. The peers' figures were taken on scenes of
those counts at 1280x720, orbiting by 3 degrees a frame on --orbit 0,-0.2,0,8.7,3; a scene of one of those
counts is set beside them.
"""

from __future__ import annotations

import argparse
import math
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moderngl
import numpy as np

from splatview.measure.tables import FOLDER, write_results
from splatview.scene import Camera, Gaussians, RenderSettings, look_at
from splatview.scene.demo import demo_scene
from splatview.scene.files import load_scene
from splatview.scene.framing import robust_bounds
from splatview.viewer.gl.context import create_headless_context, describe
from splatview.viewer.gl.quads import QuadsRenderer

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
    """Each blend precision and, beside it, no early stop: frame by frame in turn."""
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
    for frame in range(WARM_UP + frames):
        for i, (renderer, (blend, _)) in enumerate(zip(renderers, variants, strict=True)):
            begun, cpu_begun = time.perf_counter(), time.process_time()
            renderer.draw(views(frame), RenderSettings(blend=blend))  # pyright: ignore[reportArgumentType]
            ctx.finish()
            elapsed = 1000 * (time.perf_counter() - begun)
            if frame >= WARM_UP:
                times[i].append(elapsed)
                cpu[i].append(1000 * (time.process_time() - cpu_begun))
                stages[i].append(dict(renderer.finished_stats().ms))
    results = []
    for i, (blend, _) in enumerate(variants):
        median = float(np.median(times[i]))
        alone = float(np.median(cpu[i])) / (os.cpu_count() or 1)
        peers = {
            peer: {
                "median_ms": figures[len(scene)],
                "ratio": median / min(figures[len(scene)]),
                "ratio_alone": alone / min(figures[len(scene)]),
            }
            for peer, figures in PEERS.items()
            if len(scene) in figures
        }
        results.append(
            {
                "scene": name,
                "splats": len(scene),
                "visible": renderers[i].finished_stats().visible,
                "blend": blend,
                "early_stop": renderers[i].early_stop,
                "median_ms": median,
                "range_ms": [min(times[i]), max(times[i])],
                # Of all threads: what a software GL costs even where other programs share the machine.
                "cpu_ms": float(np.median(cpu[i])),
                "alone_ms": alone,
                "stages_ms": {key: float(np.median([one[key] for one in stages[i]])) for key in stages[i][0]},
                "peers": peers,
            }
        )
        renderers[i].release()
    return results


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
    rows = [
        [
            result["scene"],
            f"{result['splats']:,}",
            result["blend"],
            "off" if not result["early_stop"] else f"{result['early_stop']:g}",
            f"{result['median_ms']:.0f}",
            f"{result['alone_ms']:.0f}",
            " / ".join(f"{result['stages_ms'][stage]:.0f}" for stage in ("project", "sort", "draw")),
            f"{max(peer['ratio_alone'] for peer in result['peers'].values()):.2f}"
            if result["peers"]
            else "-",
        ]
        for result in results
    ]
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
                "columns": [
                    *("scene", "splats", "target", "early stop", "ms", "ms alone", "project / sort / draw"),
                    "alone / fastest peer's",
                ],
                "rows": rows,
                "note": f"Medians of {options.frames} frames at {width}x{height} on {info.renderer}; "
                f'"alone" is the processor time of all threads over {os.cpu_count()} cores: a frame '
                f"where nothing else runs; peers' figures are of a run on {PEER_MACHINE}.",
            },
        },
    )


if __name__ == "__main__":
    main()
