"""Forward and backward of a small training picture, beside what CPU peers take for theirs.

    python tools/bench/bench_step.py [SCENE.ply[=CAMERA.json] | SPLATS ...] [--size WxH]

A camera is our JSON or one with "viewmat" for its matrix; without it the whole scene is framed. A number is
the rasteriser's synthetic scene of so many splats; without any, of 5,000, 20,000 and 100,000.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from bench_kernels import measure, synthetic_camera, synthetic_scene
from harness import make_parser

from splatview.measure.machine import write_results
from splatview.raster import available_threads, parameters_of
from splatview.scene import Camera, Gaussians
from splatview.scene.formats import load_scene
from splatview.scene.framing import frame_camera

PEER = "OpenSplat 1.1.5, CPU"
PEER_MS = {5_000: (96, 116), 20_000: (149, 154), 100_000: (264, 264)}
"""Forward and backward of OpenSplat (C++ on libtorch) at 256x256, SH 3, L1, medians of several runs in
milliseconds, lowest and highest, by splats: its whole step less Adam. Taken on 2 cores of an AMD EPYC with
AVX-512, 2 threads, on random scenes of these counts. The fastest CPU peer that trains."""


def read_camera(path: Path) -> Camera:
    values = json.loads(path.read_text())
    matrix = values.get("viewmat", values.get("world_to_camera"))
    intrinsics = {key: values[key] for key in ("width", "height", "fx", "fy", "cx", "cy")}
    return Camera(**intrinsics, world_to_camera=matrix)


def cases(names: list[str], size: tuple[int, int]) -> list[tuple[str, Gaussians, Camera]]:
    found = []
    for name in names or map(str, sorted(PEER_MS)):
        if name.isdecimal():
            count = int(name)
            found.append((f"synthetic, {count:,}", synthetic_scene(count), synthetic_camera(*size)))
            continue
        scene, _, camera = name.partition("=")
        gaussians = load_scene(scene)
        view = read_camera(Path(camera)).resized(*size) if camera else frame_camera(gaussians, *size)
        label = Path(scene).stem if not camera else f"{Path(scene).parent.name}/{Path(scene).stem}"
        found.append((label, gaussians, view))
    return found


def beside_peer(splats: int, step_ms: float) -> dict[str, Any]:
    """The peer's figure at the nearest count, and how many times as fast ours is."""
    nearest = min(PEER_MS, key=lambda count: abs(count - splats))
    if not 0.8 < splats / nearest < 1.25:
        return {"peer_splats": None, "ratio": None}
    return {"peer_splats": nearest, "ratio": [round(ms / step_ms, 1) for ms in PEER_MS[nearest]]}


def main() -> None:
    parser = make_parser(__doc__, "step.json", size="256x256")
    parser.add_argument("scenes", nargs="*")
    options = parser.parse_args()
    width, height = options.size
    results, rows = [], []
    for name, gaussians, camera in cases(options.scenes, options.size):
        result = measure(parameters_of(gaussians), camera, available_threads(), seconds=5.0)
        compared = beside_peer(result["splats"], result["step_ms"])
        results.append({"scene": name, **result, **compared})
        forward = result["picture_ms"]
        ratio = "-".join(f"{value:.1f}" for value in sorted(set(compared["ratio"] or ()))) or "not known"
        rows.append(
            [name, f"{result['splats']:,}", f"{forward:.1f}", f"{result['step_ms'] - forward:.1f}", ratio]
        )
        print(*rows[-1], sep="  ", flush=True)
    table = {
        "columns": ["scene", "splats", "forward ms", "backward ms", f"times as fast as {PEER}"],
        "rows": rows,
        "note": f"Median ms at {width}x{height}, all stages from splats to picture and from picture to "
        f"gradients of every parameter, {available_threads()} threads. The peer's figures (whole step less "
        "its optimiser, at 5,000, 20,000 and 100,000 splats of a random scene) were taken on such a "
        "machine in another run.",
    }
    write_results(options.output, {"peer": PEER, "peer_ms": PEER_MS, "results": results, "table": table})


if __name__ == "__main__":
    main()
