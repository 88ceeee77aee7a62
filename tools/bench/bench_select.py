"""Milliseconds of each way to select, of attributes, histograms, growing and detectors, by scene size.

    python tools/bench/bench_select.py [--counts N ...] [--repeats R]

The scene is a dense surface with a thin cloud about it, half of its splats moved by an edit. Regions of a
picture are of 1280x720; the lasso has 400 corners.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from harness import make_parser

from splatview.edit.detectors import DETECTORS
from splatview.edit.kernels.marks import positions_of
from splatview.edit.selectors import (
    AttributeRange,
    Box,
    Brush,
    Flood,
    InvalidSplats,
    Lasso,
    Rectangle,
    SimilarColour,
    Sphere,
)
from splatview.edit.selectors.attributes import ATTRIBUTES, attribute_values, histogram
from splatview.edit.selectors.region_growing import grow, typical_spacing
from splatview.edit.tools import NoTools
from splatview.measure.machine import write_results
from splatview.scene import Camera, Gaussians, look_at
from splatview.scene.edits import IDENTITY, PALETTE_SHIFT, Adjustment, SceneEdits

LONG = 1000.0
"""Milliseconds of processor time: what takes longer is timed once, and not at all for larger scenes, for
which it takes as many times longer as there are more splats."""

WARMING = 20_000
"""Splats of a first scene, with which everything is compiled."""


def make_scene(count: int) -> tuple[Gaussians, SceneEdits]:
    rng = np.random.default_rng(count)
    around, about = rng.uniform(
        0,
        2 * np.pi,
        (2, count),
    )
    width = 1 + 0.4 * np.cos(about)
    means = np.stack([width * np.cos(around), 0.4 * np.sin(about), width * np.sin(around)], axis=1)
    means[::50] = rng.uniform(-2, 2, means[::50].shape)
    size = 2 / np.sqrt(count)
    scene = Gaussians(
        means=means.astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(np.log(size), 0.5, (count, 3)).astype(np.float32),
        opacity_logits=rng.normal(1, 2, count).astype(np.float32),
        sh=rng.normal(0, 0.4, (count, 4, 3)).astype(np.float32),
    )
    marks = (np.arange(count, dtype=np.uint32) % 2) << PALETTE_SHIFT
    moved = Adjustment(translation=(0.01, 0.0, 0.0), size=1.1)
    return scene, SceneEdits(marks=marks.astype(np.uint32), palette=(IDENTITY, moved))


def ways_of(scene: Gaussians, edits: SceneEdits, camera: Camera) -> dict[str, Callable[[], Any]]:
    turns = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radii = 250 + 60 * np.sin(9 * turns)
    lasso = [
        (640 + r * np.cos(t), 360 + r * np.sin(t))
        for r, t in zip(radii.tolist(), turns.tolist(), strict=True)
    ]
    path = tuple((300 + 4.0 * i, 360 + 80 * float(np.sin(i / 12))) for i in range(160))
    tools = NoTools()
    opacity = attribute_values("opacity", scene, edits, tools)
    size = attribute_values("largest scale", scene, edits, tools)
    ball = Sphere(centre=(1.0, 0.0, 0.0), radius=0.6)
    chosen = ball.mask(scene, edits, tools)
    spacing = typical_spacing(scene, edits)
    band = AttributeRange(attribute="opacity", low=0.2, high=0.6)
    selectors = {
        "rectangle": Rectangle(camera=camera, x0=300, y0=200, x1=900, y1=600),
        "lasso": Lasso(camera=camera, points=tuple(lasso)),
        "brush": Brush(camera=camera, points=path, radius=40),
        "sphere": ball,
        "box": Box(centre=(1.0, 0.0, 0.0), half_extents=(0.5, 0.4, 0.6), rotation=(0.8, 0.0, 0.6, 0.0)),
        "colour": SimilarColour(rgb=(0.5, 0.5, 0.5)),
        "attribute range": band,
        "flood": Flood(seed=1, tolerance=1.0),
        "health": InvalidSplats(finding="needles"),
    }
    ways: dict[str, Callable[[], Any]] = {
        name: (lambda selector=selector: selector.mask(scene, edits, tools))
        for name, selector in selectors.items()
    }
    ways["range while dragging"] = lambda: band.of(opacity)
    ways["histogram"] = lambda: histogram(opacity)
    ways["histogram, log"] = lambda: histogram(size, log=True)
    ways["slowest attribute"] = lambda: [
        attribute_values(name, scene, edits, tools) for name in ("hue",) if name in ATTRIBUTES
    ]
    ways["positions"] = lambda: positions_of(scene, edits)
    ways["grow by distance"] = lambda: grow(chosen, scene, edits, distance=2 * spacing)
    ways["grow by 4 neighbours"] = lambda: grow(chosen, scene, edits, neighbours=4)
    for kind in ("clusters", "sparse", "giants", "needles", "faint"):
        ways[f"detector: {kind}"] = lambda kind=kind: DETECTORS[kind]().scores(scene, edits, tools)
    return ways


def measure(count: int, repeats: int, leave_out: set[str]) -> list[dict[str, Any]]:
    scene, edits = make_scene(count)
    camera = look_at((0, -1.5, -3.5), (0, 0, 0), up=(0, -1, 0), width=1280, height=720)
    ways = {name: way for name, way in ways_of(scene, edits, camera).items() if name not in leave_out}
    times: dict[str, list[float]] = {name: [] for name in ways}
    works: dict[str, list[float]] = {name: [] for name in ways}
    for repeat in range(repeats + 1):
        for name, way in ways.items():
            if works[name] and works[name][0] > LONG:
                continue
            began, used = time.perf_counter(), time.process_time()
            way()
            elapsed, busy = (time.perf_counter() - began) * 1000, (time.process_time() - used) * 1000
            if repeat or busy > LONG:  # the first time touches pages
                times[name].append(elapsed)
                works[name].append(busy)
    return [
        {
            "name": name,
            "splats": count,
            "busy_ms": min(works[name]),
            "median_ms": float(np.median(values)),
            "range_ms": [min(values), max(values)],
        }
        for name, values in times.items()
    ]


def main() -> None:
    parser = make_parser(__doc__, "select.json")
    parser.add_argument("--counts", type=int, nargs="+", default=[1_000_000, 5_000_000])
    parser.add_argument("--repeats", type=int, default=5)
    options = parser.parse_args()
    measure(WARMING, 1, set())
    results = []
    for count in options.counts:
        results += measure(count, options.repeats, {r["name"] for r in results if r["busy_ms"] > LONG})
        print(*results, sep="\n", flush=True)
    by_name: dict[str, dict[int, dict[str, Any]]] = {}
    for result in results:
        by_name.setdefault(result["name"], {})[result["splats"]] = result
    write_results(
        options.output,
        {
            "results": results,
            "table": {
                "columns": [
                    "selecting by",
                    *(f"{count:,} splats: processor ms, elapsed ms" for count in options.counts),
                ],
                "rows": [
                    [name, *(cell(of_count.get(count)) for count in options.counts)]
                    for name, of_count in by_name.items()
                ],
                "note": f"Least of {options.repeats} in turn, half of the splats moved by an edit; processor"
                " time is that of all threads together. What takes more than a second tells its progress"
                " and can be cancelled; it was not run on the larger scene.",
            },
        },
    )


def cell(result: dict[str, Any] | None) -> str:
    if result is None:
        return ""
    numbers = (result["busy_ms"], result["range_ms"][0])
    return ", ".join(f"{number:,.1f}" if number < 100 else f"{number:,.0f}" for number in numbers)


if __name__ == "__main__":
    main()
