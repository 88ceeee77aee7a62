"""What maps of gains for each photo cost: training steps with them and without, in turn.

    python tools/bench/bench_shading.py CAPTURES [--rounds N] [--steps N]

CAPTURES has the folders `banana` and `miku`. Two trainers of the same photos and splats take STEPS steps each
in turn, of processor time, which other programs on the machine disturb less than the clock.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from harness import in_turn, make_parser

from splatview.measure.machine import write_results
from splatview.raster import available_threads
from splatview.scene.captures import load_capture
from splatview.trainer.initialisation import initial_parameters
from splatview.trainer.settings import TrainSettings
from splatview.trainer.shading import BEGINS, Mode
from splatview.trainer.torch_import import TorchImport
from splatview.trainer.trainer import Trainer
from splatview.trainer.views import TrainViews, train_views

CASES = (("miku", 4, 20_000), ("miku", 2, 20_000), ("banana", 2, 20_000))
"""Capture, --downscale, splats."""

ITERATIONS = 1_000
"""Of the run that the steps are a part of: maps are learnt from BEGINS of it on."""


def trainer_of(captures: Path, case: tuple[str, int, int], shading: Mode) -> Trainer:
    """A trainer whose next steps are on full-size photos, of as many splats as ever."""
    name, downscale, splats = case
    capture, rng = load_capture(captures / name, downscale=downscale), np.random.default_rng(0)
    chosen = rng.integers(len(capture.points), size=splats)
    radius = capture.scene_radius
    points = capture.points[chosen] + rng.normal(scale=0.002 * radius, size=(splats, 3))
    settings = TrainSettings(
        iterations=ITERATIONS, resolution=(), sh_every=0.0, max_splats=splats, shading=shading, outliers="off"
    )
    parameters = initial_parameters(points, capture.point_colours[chosen], radius)
    trainer = Trainer(TrainViews(train_views(capture.train), 0), parameters, radius, settings)
    while trainer.progress < 2 * BEGINS:
        trainer.step()
    return trainer


def steps(trainer: Trainer, count: int, _: int) -> None:
    for _ in range(count):
        trainer.step()


def measured(captures: Path, case: tuple[str, int, int], rounds: int, count: int) -> dict[str, Any]:
    modes: dict[str, Mode] = {"without": "off", "with": "on"}
    ways = {way: partial(steps, trainer_of(captures, case, mode), count) for way, mode in modes.items()}
    timings = in_turn(ways, rounds)
    without, with_maps = (np.array(timings[way].cpu_ms) / count for way in modes)
    low, median, high = np.percentile(with_maps - without, (25, 50, 75))
    name, downscale, splats = case
    view = load_capture(captures / name, downscale=downscale).train[0].camera
    return {
        "case": f"{name} --downscale {downscale}, {splats:,} splats",
        "size": [view.width, view.height],
        "without_ms": float(np.median(without)),
        "with_ms": float(np.median(with_maps)),
        "more_ms": float(median),
        "quartiles": [float(low), float(high)],
        "ratio": float(np.median(with_maps / without)),
    }


def row(result: dict[str, Any]) -> list[str]:
    width, height = result["size"]
    low, high = result["quartiles"]
    return [
        result["case"],
        f"{width}x{height}",
        f"{result['without_ms']:.2f}",
        f"{result['with_ms']:.2f}",
        f"{result['more_ms']:+.2f} ({low:+.2f} to {high:+.2f})",
        f"{result['ratio']:.3f}",
    ]


def main() -> None:
    parser = make_parser(__doc__, "shading_cost.json")
    parser.add_argument("captures", type=Path)
    parser.add_argument("--rounds", type=int, default=24)
    parser.add_argument("--steps", type=int, default=15)
    options = parser.parse_args()
    TorchImport().wait()
    results = [measured(options.captures, case, options.rounds, options.steps) for case in CASES]
    for result in results:
        print(*row(result), sep="  ")
    table = {
        "columns": ["run", "photos, px", "without, ms", "with maps, ms", "more, ms", "with / without"],
        "rows": [row(result) for result in results],
        "note": "A step in processor time, without and with a map of gains for each photo, in turn: medians, "
        f"and the median and quartiles of the difference, {available_threads()} threads.",
    }
    write_results(options.output, {"results": results, "table": table})


if __name__ == "__main__":
    main()
