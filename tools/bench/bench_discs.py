"""What discs cost against ellipsoids: time and memory of the same flattened scene, frames in turn.

    python tools/bench/bench_discs.py [SCENE] [--size WxH] [--frames N] [-o JSON]

Without a scene the demo of 100,000 splats is drawn, as if each were flat. Every frame is of another view,
so that nothing is kept. Ratios are those of the medians; takes about a minute.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from harness import in_turn, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.headless import make_headless
from splatview.renderers.request import FrameRequest, Renderer
from splatview.scene import Camera, Gaussians, ImageModel, RenderSettings, look_at_matrix
from splatview.scene.demo import demo_scene
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera

RENDERERS = ("cpu", "quads", "tiles")
FOOTPRINTS = ("ellipsoid", "disc")
TURN = 0.001
"""Share of its distance by which the eye moves from frame to frame."""


def flattened(scene: Gaussians) -> Gaussians:
    """The shortest axis of each splat a thousandth of the middle one."""
    log_scales = scene.log_scales.copy()
    shortest = log_scales.argmin(axis=1)
    log_scales[np.arange(len(scene)), shortest] = np.sort(log_scales, axis=1)[:, 1] - np.log(1e3)
    return replace(scene, log_scales=log_scales.astype(np.float32))


def moved(camera: Camera, target: np.ndarray, frame: int) -> Camera:
    right, up = camera.R_camera_world[0], -camera.R_camera_world[1]
    reach = float(np.linalg.norm(target - camera.eye))
    return replace(
        camera, world_to_camera=look_at_matrix(camera.eye + TURN * reach * frame * right, target, up)
    )


def measure(name: str, scene: Gaussians, camera: Camera, frames: int) -> dict[str, Any]:
    """Median ms and bytes by footprint."""
    target = camera.eye + camera.forward * float(
        np.median((scene.means.astype(np.float64) - camera.eye) @ camera.forward)
    )
    # A renderer each: what discs take once stays with the renderer.
    renderers = {footprint: make_headless(name) for footprint in FOOTPRINTS}

    def draw(renderer: Renderer, settings: RenderSettings, frame: int) -> None:
        renderer.load(scene, "float32")
        renderer.render(FrameRequest(scene, moved(camera, target, frame), settings))

    models = {"ellipsoid": ImageModel(), "disc": ImageModel().with_footprint("disc")}
    ways = {
        footprint: partial(draw, renderer, RenderSettings(model=models[footprint]))
        for footprint, renderer in renderers.items()
    }
    return {
        footprint: {
            "ms": own.median,
            "spread_ms": float(np.subtract(*np.percentile(own.ms, [75, 25]))),
            "bytes": renderers[footprint].memory(),
        }
        for footprint, own in in_turn(ways, frames, warm_up=2).items()
    }


def main() -> None:
    options = make_parser(__doc__, "discs.json", scene=True, size="960x540", frames=11).parse_args()
    scene = flattened(load_scene(options.scene) if options.scene else demo_scene(splats=100_000))
    width, height = options.size
    camera = frame_camera(scene, width, height)
    results = {name: measure(name, scene, camera, options.frames) for name in RENDERERS}
    rows = []
    for name, by_footprint in results.items():
        solid, flat = by_footprint["ellipsoid"], by_footprint["disc"]
        rows.append(
            [
                name,
                *(f"{one['ms']:.0f} ± {one['spread_ms'] / 2:.0f}" for one in (solid, flat)),
                f"{flat['ms'] / solid['ms']:.2f}",
                *(f"{one['bytes'] / 2**20:.0f}" for one in (solid, flat)),
                f"{flat['bytes'] / solid['bytes']:.2f}",
            ]
        )
        print(rows[-1], flush=True)
    title = options.scene.stem if options.scene else "the demo scene"
    table = {
        "columns": [
            "renderer",
            "ellipsoids, ms",
            "discs, ms",
            "ratio",
            "ellipsoids, MiB",
            "discs, MiB",
            "ratio",
        ],
        "rows": rows,
        "note": f"{title}, {len(scene):,} splats made flat, {width}x{height}; frames in turn, medians.",
    }
    write_results(
        options.output, {"splats": len(scene), "size": [width, height], "results": results, "table": table}
    )


if __name__ == "__main__":
    main()
