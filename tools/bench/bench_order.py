"""What the order of splats in memory costs a step of training: as it is, by chance, and along a Morton curve.

    python tools/bench/bench_order.py [SCENE ...] [--size WxH] [--frames N]

A step is a picture, its gradients and Adam, at rates of 0. Every view of an orbit is taken in all orders
before the next. Synthetic scenes of 20,000 and 100,000 splats, whose order is chance, and each SCENE.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from bench_kernels import synthetic_scene
from harness import in_turn, load_scenes, make_parser, orbit_of

from splatview.measure.machine import write_results
from splatview.raster import Parameters, parameters_of
from splatview.scene import Gaussians
from splatview.scene.formats.point_cloud import morton_codes
from splatview.trainer import SelectiveAdam, Splats, rasterize
from splatview.trainer.adam_kernels import Rates

AS_IS, CHANCE, MORTON = "as it is", "by chance", "Morton"

SYNTHETIC = (20_000, 100_000)
"""Splats."""

STILL = Rates(*[0.0] * len(Rates._fields))


def orders_of(means: np.ndarray) -> dict[str, np.ndarray]:
    """(N,) permutations by name; the Morton curve is through a box that holds 98 of 100 means (N, 3) by each
    axis, and ends at its sides for the others."""
    low, high = np.percentile(means, [1, 99], axis=0)
    places = np.clip((means - low) / (high - low).max(), 0, 1)
    return {
        AS_IS: np.arange(len(means)),
        CHANCE: np.random.default_rng(0).permutation(len(means)),
        MORTON: np.argsort(morton_codes(places), kind="stable"),
    }


def steps_of(
    gaussians: Gaussians, order: np.ndarray, size: tuple[int, int], repeats: int
) -> Callable[[int], None]:
    """A way that takes so many steps on the splats of a scene in an order (N,), from view `i` of an orbit."""
    arrays = parameters_of(gaussians)
    splats = Splats(Parameters(*(np.ascontiguousarray(array[order]) for array in arrays)))
    optimizer, view = SelectiveAdam(splats, STILL), orbit_of(gaussians, size)
    shape = (size[1], size[0], 4)
    weights = torch.from_numpy(np.random.default_rng(1).normal(size=shape).astype(np.float32))

    def way(number: int) -> None:
        for _ in range(repeats):
            optimizer.zero_grad()
            image, info = rasterize(*splats.parameters(), view(number))
            (image * weights).sum().backward()
            optimizer.step(info.pieces)

    return way


def measure(gaussians: Gaussians, size: tuple[int, int], frames: int) -> dict[str, Any]:
    """Milliseconds a step as it is, by the clock and of the processor, and by order the median and quartiles
    of the ratio to these, view by view."""
    repeats = max(round(400_000 / len(gaussians)), 2)
    orders = orders_of(np.asarray(gaussians.means, np.float64))
    ways = {name: steps_of(gaussians, order, size, repeats) for name, order in orders.items()}
    found = in_turn(ways, frames)
    result: dict[str, Any] = {"splats": len(gaussians)}
    for what in ("ms", "cpu_ms"):
        times = {name: np.array(getattr(own, what)) / repeats for name, own in found.items()}
        ratios = {name: values / times[AS_IS] for name, values in times.items()}
        result[what] = {
            AS_IS: float(np.median(times[AS_IS])),
            "ratio": {name: np.percentile(ratios[name], [50, 25, 75]).tolist() for name in orders},
        }
    return result


def main() -> None:
    parser = make_parser(__doc__, "order.json", scenes=True, size="256x256", frames=25)
    options = parser.parse_args()
    scenes = {f"synthetic, {count:,} splats": synthetic_scene(count) for count in SYNTHETIC}
    if options.scenes:
        files = load_scenes(options.scenes, dict)
        scenes |= {f"{name}, {len(scene):,} splats": scene for name, scene in files.items()}
    results, rows = {}, []
    for name, scene in scenes.items():
        result = results[name] = measure(scene, options.size, options.frames)
        cells = [
            "{:.3f} ({:.3f}-{:.3f})".format(*result[what]["ratio"][order])
            for order in (CHANCE, MORTON)
            for what in ("ms", "cpu_ms")
        ]
        rows.append([name, f"{result['ms'][AS_IS]:.1f}", *cells])
        print(*rows[-1], sep=" | ", flush=True)
    width, height = options.size
    table = {
        "columns": [
            *("scene", "a step as it is, ms", "by chance", "in processor time"),
            *("Morton", "in processor time"),
        ],
        "rows": rows,
        "note": f"{width}x{height}, {options.frames} views, all cores: medians; of the orders by chance and "
        "along a Morton curve medians and quartiles of the ratio to the order as it is, view by view.",
    }
    write_results(options.output, {"results": results, "size": options.size, "table": table})


if __name__ == "__main__":
    main()
