"""The renderer by tiles after a jump of the camera from far to near: each frame, and its longest dispatch.

    python tools/bench/bench_jump.py [SCENE] [--size WxH] [--frames N] [--tuning software|hardware]

Dispatches are timed one by one, with waits between them, so frames take longer than drawn in one go. Without
a scene a synthetic one of 100,000 splats is drawn.
"""

from __future__ import annotations

import time
from typing import Any

import moderngl
from bench_kernels import synthetic_scene
from harness import load_scenes, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.gl import tiles
from splatview.renderers.gl.context import create_headless_context, describe
from splatview.renderers.request import FrameRequest
from splatview.scene import Gaussians, RenderSettings, look_at
from splatview.scene.framing import robust_bounds

FAR, NEAR = 30.0, 0.6
"""Distances of the eye, in radii of the scene."""

DISPATCHES = ("run", "run_indirect")


class TimedDispatches:
    """Milliseconds of every dispatch while it is entered."""

    def __init__(self, ctx: moderngl.Context) -> None:
        self._ctx = ctx
        self.ms: list[float] = []

    def __enter__(self) -> TimedDispatches:
        self._real = {name: getattr(moderngl.ComputeShader, name) for name in DISPATCHES}
        for name, real in self._real.items():
            setattr(moderngl.ComputeShader, name, self._timed(real))
        return self

    def _timed(self, real: Any) -> Any:
        def run(program: moderngl.ComputeShader, *arguments: Any) -> None:
            self._ctx.finish()
            began = time.perf_counter()
            real(program, *arguments)
            self._ctx.finish()
            self.ms.append(1000 * (time.perf_counter() - began))

        return run

    def __exit__(self, *_: object) -> None:
        for name, real in self._real.items():
            setattr(moderngl.ComputeShader, name, real)


def jump(ctx, name: str, gaussians: Gaussians, size: tuple[int, int], frames: int, tuning) -> dict[str, Any]:
    centre, radius = robust_bounds(gaussians.means)

    def draw(distance: float) -> dict[str, float]:
        view = look_at(
            centre - (0, 0, distance * radius), centre, up=(0, -1, 0), width=size[0], height=size[1]
        )
        with TimedDispatches(ctx) as timed:
            began = time.perf_counter()
            renderer.draw(FrameRequest(None, view, RenderSettings(blend="float32")))
            ctx.finish()
            elapsed = 1000 * (time.perf_counter() - began)
        return {"frame": elapsed, "dispatch": max(timed.ms), "dispatches": len(timed.ms)}

    renderer = tiles.TilesRenderer(ctx, tuning=tuning)
    renderer.load(gaussians)
    for distance in (NEAR, FAR):  # programs are compiled
        draw(distance)
    renderer.close()
    renderer = tiles.TilesRenderer(ctx, tuning=tuning)
    renderer.load(gaussians)
    for frame in range(4):
        draw(FAR + 1e-3 * frame)
    after = [draw(NEAR + 1e-3 * frame) for frame in range(frames)]
    renderer.close()
    return {"scene": name, "splats": len(gaussians), "size": list(size), "after_ms": after}


def main() -> None:
    parser = make_parser(__doc__, "jump.json", scenes=True, size="640x360", frames=4)
    parser.add_argument("--tuning", choices=("software", "hardware"), default="software")
    options = parser.parse_args()
    ctx = create_headless_context(require=430)
    tuning = {"software": tiles.SOFTWARE, "hardware": tiles.HARDWARE}[options.tuning]
    scenes = load_scenes(options.scenes, lambda: {"synthetic": synthetic_scene(100_000)})
    results = []
    for name, gaussians in scenes.items():
        results.append(jump(ctx, name, gaussians, options.size, options.frames, tuning))
        for frame, after in enumerate(results[-1]["after_ms"], start=1):
            print(name, "frame", frame, {key: round(value) for key, value in after.items()}, flush=True)
    write_results(
        options.output, {"gl": describe(ctx).renderer, "tuning": options.tuning, "results": results}
    )


if __name__ == "__main__":
    main()
