"""The CPU rasteriser against `quads` on this machine's GL, frame by frame in one run.

    python tools/bench/bench_cpu_vs_quads.py [SCENE ...] [--size WxH] [--frames N]

Both draw every view of an orbit, in turn, up to finished pixels; the ratio is that of the medians.
Without a scene a synthetic one of 500,000 splats is drawn.
"""

from __future__ import annotations

import argparse
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from bench_kernels import synthetic_scene

from splatview import raster
from splatview.measure.machine import FOLDER, write_results
from splatview.renderers import make_renderer
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera, robust_bounds

TURN = 3.0
"""Degrees that the eye moves about the scene's centre before each frame."""


def turned(camera: Camera, centre: np.ndarray, degrees: float) -> Camera:
    """The camera carried about the vertical axis through `centre`."""
    angle = math.radians(degrees)
    carry = np.eye(4)
    carry[[0, 0, 2, 2], [0, 2, 0, 2]] = math.cos(angle), math.sin(angle), -math.sin(angle), math.cos(angle)
    carry[:3, 3] = centre - carry[:3, :3] @ centre
    return replace(camera, world_to_camera=camera.world_to_camera @ carry)


def compare(ctx, name: str, gaussians: Gaussians, size: tuple[int, int], frames: int) -> dict[str, Any]:
    settings = RenderSettings(blend="float32")
    camera = frame_camera(gaussians, *size)
    centre, _ = robust_bounds(gaussians.means)
    quads = make_renderer("quads", ctx)
    quads.load(gaussians)
    times: dict[str, list[float]] = {"quads": [], "cpu": []}
    difference = 0.0
    for frame in range(frames + 1):
        view = turned(camera, centre, TURN * frame)
        begun = time.perf_counter()
        quads.draw(FrameRequest(None, view, settings))
        ctx.finish()
        drawn = time.perf_counter()
        picture = raster.render(gaussians, view, settings)
        done = time.perf_counter()
        if frame == 0:  # programs and kernels are compiled, pages touched
            difference = float(np.abs(quads.read() - picture).max())
            continue
        times["quads"].append(1000 * (drawn - begun))
        times["cpu"].append(1000 * (done - drawn))
    quads.close()
    medians = {renderer: float(np.median(values)) for renderer, values in times.items()}
    spread = {renderer: [min(values), max(values)] for renderer, values in times.items()}
    return {
        "scene": name,
        "splats": len(gaussians),
        "size": list(size),
        "frames": frames,
        "median_ms": medians,
        "range_ms": spread,
        "ratio": medians["quads"] / medians["cpu"],
        "largest_difference": difference,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--frames", type=int, default=15)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "cpu_vs_quads.json")
    options = parser.parse_args()
    width, height = (int(part) for part in options.size.split("x"))
    ctx = create_headless_context()
    scenes = [(path.name, load_scene(path)) for path in options.scenes]
    scenes = scenes or [("synthetic", synthetic_scene(500_000))]
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
                "columns": ["scene", "splats", "size", "`quads` ms", "`cpu` ms", "`cpu` is faster by"],
                "rows": [
                    [
                        result["scene"],
                        f"{result['splats']:,}",
                        f"{result['size'][0]}x{result['size'][1]}",
                        f"{result['median_ms']['quads']:.0f}",
                        f"{result['median_ms']['cpu']:.0f}",
                        f"{result['ratio']:.1f}x",
                    ]
                    for result in results
                ],
                "note": f"Medians of {options.frames} views each, in turn; GL is {describe(ctx).renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
