"""What discs cost against ellipsoids: time and memory of the same flattened scene, frames in turn.

    python tools/bench/bench_discs.py [SCENE] [--size WxH] [--frames N] [-o JSON]

Without a scene the demo of 100,000 splats is drawn, as if each were flat. Every frame is of another view,
so that nothing is kept. Ratios are those of the medians; takes about a minute.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from splatview.measure.machine import FOLDER, write_results
from splatview.renderers import FrameRequest
from splatview.renderers.headless import make_headless
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
    found: dict[str, Any] = {}
    drawn: dict[str, list[float]] = {footprint: [] for footprint in FOOTPRINTS}
    # A renderer each: what discs take once stays with the renderer.
    renderers = {footprint: make_headless(name) for footprint in FOOTPRINTS}
    models = {"ellipsoid": ImageModel(), "disc": ImageModel().with_footprint("disc")}
    for frame in range(frames + 2):
        for footprint, renderer in renderers.items():
            renderer.load(scene, "float32")
            begun = time.perf_counter()
            settings = RenderSettings(model=models[footprint])
            renderer.render(FrameRequest(scene, moved(camera, target, frame), settings))
            if frame >= 2:  # the first ones compile
                drawn[footprint].append(1000 * (time.perf_counter() - begun))
    for footprint, renderer in renderers.items():
        times = np.array(drawn[footprint])
        found[footprint] = {
            "ms": float(np.median(times)),
            "spread_ms": float(np.subtract(*np.percentile(times, [75, 25]))),
            "bytes": renderer.memory(),
        }
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("scene", nargs="?", type=Path)
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--frames", type=int, default=11)
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "discs.json")
    options = parser.parse_args()
    scene = flattened(load_scene(options.scene) if options.scene else demo_scene(splats=100_000))
    width, height = map(int, options.size.split("x"))
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
        "note": f"{title}, {len(scene):,} splats made flat, {options.size}; frames of both in turn, medians.",
    }
    write_results(
        options.output, {"splats": len(scene), "size": [width, height], "results": results, "table": table}
    )


if __name__ == "__main__":
    main()
