"""What bands of zeros cost: a scene of SH 0, the same padded with zeros to SH 3, and scenes in between.

    python tools/bench/bench_padded_sh.py [SCENE] [--size WxH] [--frames N] [--splats N]

Every view of an orbit is drawn with all variants before the next, in an order that rotates, up to finished
pixels. The SH 0 scene is drawn twice, as two scenes: how far those two are apart is the noise floor. Of a
SCENE only the constant band is taken, but for the variants that have more; without one a synthetic scene of
--splats is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
from bench_kernels import synthetic_scene
from harness import in_turn, make_parser, orbit_of

from splatview import raster
from splatview.measure.machine import write_results
from splatview.renderers.gl import scene_buffers as harmonics
from splatview.renderers.gl.context import create_headless_context, describe, held_bytes
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.quads_gl33 import QuadsGL33Renderer
from splatview.renderers.gl.tiles import TilesRenderer
from splatview.renderers.request import FrameRequest
from splatview.scene import Camera, Gaussians, RenderSettings
from splatview.scene.formats import load_scene

SETTINGS = RenderSettings(blend="float32")

BASELINE, AGAIN, PADDED = "SH 0", "SH 0 again", "SH 0 padded to SH 3"
HALF, HALF_ALIKE, FULL = "half SH 0, half SH 3", "the same, stored alike", "SH 3"

RENDERERS = {"quads": QuadsRenderer, "tiles": TilesRenderer, "quads, OpenGL 3.3": QuadsGL33Renderer}

Draw = Callable[[Camera], float]
"""Draws a view; returns the milliseconds of projection, in which harmonics are read."""

RESAMPLES = 2000


def variants_of(gaussians: Gaussians) -> dict[str, Gaussians]:
    n, rng = len(gaussians), np.random.default_rng(0)
    constant = np.ascontiguousarray(gaussians.sh[:, :1])
    every = rng.normal(scale=0.05, size=(n, 16, 3)).astype(np.float32)
    every[:, :1] = constant
    half = every.copy()
    half[: n // 2, 1:] = 0
    padded = np.zeros_like(every)
    padded[:, :1] = constant
    arrays = {
        BASELINE: constant,
        AGAIN: constant.copy(),
        PADDED: padded,
        HALF: half,
        HALF_ALIKE: half.copy(),
        FULL: every,
    }
    return {name: replace(gaussians, sh=sh) for name, sh in arrays.items()}


@contextmanager
def alike(wanted: bool) -> Iterator[None]:
    """Within it, all splats are stored by the highest degree of any, if that is wanted."""
    before = harmonics.own_degrees
    if wanted:
        harmonics.own_degrees = lambda sh: None
    try:
        yield
    finally:
        harmonics.own_degrees = before


def on_gpu(ctx, make, scenes: dict[str, Gaussians]) -> dict[str, tuple[Draw, int, Callable[[], None]]]:
    """By variant: what draws it, bytes held, and what releases it."""
    made = {}
    for name, scene in scenes.items():
        renderer = make(ctx)
        with alike(name == HALF_ALIKE):
            renderer.load(scene)
        held = held_bytes(renderer)

        def draw(view: Camera, renderer=renderer, scene=scene) -> float:
            renderer.render(FrameRequest(scene, view, SETTINGS))
            return renderer.stats(wait=True).ms["project"]

        made[name] = draw, held, renderer.release
    return made


def on_cpu(scenes: dict[str, Gaussians]) -> dict[str, tuple[Draw, int, Callable[[], None]]]:
    made = {}
    for name, scene in scenes.items():
        workspace, splats = raster.Workspace(), raster.parameters_of(scene)
        nonzero = None if name == HALF_ALIKE else raster.nonzero_bands(scene)

        def draw(view: Camera, splats=splats, workspace=workspace, nonzero=nonzero) -> float:
            frame = raster.draw_frame(splats, view, SETTINGS, workspace, nonzero=nonzero)
            return frame.milliseconds["project"]

        made[name] = draw, scene.sh.nbytes, lambda: None
    return made


def measure(
    made: dict[str, tuple[Draw, int, Callable[[], None]]], view: Callable[[int], Camera], frames: int
) -> dict[str, Any]:
    """Milliseconds by variant, and their ratios to the baseline, frame by frame."""
    ways = {name: (lambda frame, draw=draw: draw(view(frame))) for name, (draw, _, _) in made.items()}
    times = in_turn(ways, frames)
    result: dict[str, Any] = {"bytes": {name: made[name][1] for name in made}}
    for what in ("frame", "projection"):
        drawn = {name: np.array(own.ms if what == "frame" else own.values) for name, own in times.items()}
        ratios = {name: values / drawn[BASELINE] for name, values in drawn.items()}
        medians = {name: float(np.median(values)) for name, values in ratios.items()}
        noise = noise_of(ratios[AGAIN])
        result[what] = {
            "median_ms": {name: float(np.median(values)) for name, values in drawn.items()},
            "ratio": medians,
            "quartiles": {
                name: [float(q) for q in np.percentile(values, [25, 75])] for name, values in ratios.items()
            },
            "noise": noise,
            "padded_within_noise": abs(medians[PADDED] - 1) <= noise,
        }
    return result


def noise_of(ratios: np.ndarray) -> float:
    """How far from 1 the median of ratios (frames,) of a scene to itself lies in 19 of 20 runs, by
    resampling them."""
    chosen = np.random.default_rng(0).integers(len(ratios), size=(RESAMPLES, len(ratios)))
    return float(np.percentile(np.abs(np.median(ratios[chosen], axis=1) - 1), 95))


def main() -> None:
    parser = make_parser(__doc__, "padded_sh.json", scene=True, size="640x360", frames=21)
    parser.add_argument("--splats", type=int, default=200_000)
    options = parser.parse_args()
    width, height = options.size
    gaussians = load_scene(options.scene) if options.scene else synthetic_scene(options.splats)
    view = orbit_of(gaussians, options.size)
    scenes = variants_of(gaussians)
    ctx = create_headless_context()
    results: dict[str, Any] = {}
    for name, make in RENDERERS.items():
        made = on_gpu(ctx, make, scenes)
        results[name] = measure(made, view, options.frames)
        for _, _, release in made.values():
            release()
    results["cpu"] = measure(on_cpu(scenes), view, options.frames)
    rows = [
        [
            renderer,
            f"{result['frame']['median_ms'][BASELINE]:.1f}",
            f"{result['frame']['ratio'][PADDED]:.3f} ±{result['frame']['noise']:.3f}",
            f"{result['projection']['ratio'][PADDED]:.3f} ±{result['projection']['noise']:.3f}",
            *(f"{result['projection']['ratio'][name]:.2f}" for name in (HALF, HALF_ALIKE, FULL)),
            *(f"{result['bytes'][name] / 2**20:.1f}" for name in (BASELINE, PADDED, HALF, FULL)),
        ]
        for renderer, result in results.items()
    ]
    for row in rows:
        print(*row, sep=" | ")
    write_results(
        options.output,
        {
            "gl": describe(ctx).renderer,
            "scene": options.scene.name if options.scene else "synthetic",
            "splats": len(gaussians),
            "size": [width, height],
            "frames": options.frames,
            "renderers": results,
            "table": {
                "columns": [
                    "renderer",
                    "SH 0, ms",
                    "padded, frame",
                    *("padded, projection", "half SH 3", "half, stored alike", "SH 3"),
                    *(f"MiB, {name}" for name in ("SH 0", "padded", "half SH 3", "SH 3")),
                ],
                "rows": rows,
                "note": f"{len(gaussians):,} splats, {width}x{height}; times by that of SH 0, medians of "
                f"{options.frames} views: of the frame, then of projection, where harmonics are read. ±: how "
                "far SH 0 differs from itself in 19 of 20 runs. MiB of all that is on the GPU, for `cpu` of "
                f"the coefficients in memory. GL is {describe(ctx).renderer}.",
            },
        },
    )


if __name__ == "__main__":
    main()
