"""What the last of several scenes gains by one rule or another, by the same scenes that teach it.

    python tools/bench/bench_last_scene.py DATA MADE CAPTURE ... [--splits 0 1 2] [--seeds 0] [-o FILE]

Runs of the bench (`generalisation_run`) differ by chance from the first scene on, by more than most rules
bring. Here those that teach are trained once; then a last scene is trained by each way, by pictures of the
same cameras and photos in the same order. What FILE has stays, so that captures can be run one by one.
"""

from __future__ import annotations

import argparse
import copy
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from capture_set import bench_split
from generalisation_run import DRAWN, START, step_seconds
from PIL import Image

from splatview.measure.machine import write_results
from splatview.raster import Parameters
from splatview.trainer import ensemble, free_space
from splatview.trainer.ensemble import EnsembleTrainer
from splatview.trainer.evaluate import Evaluation, evaluation_of, pictures, side_by_side
from splatview.trainer.exposure import fitted_by_tiles
from splatview.trainer.setup import kernel_threads_only, settings_for, trainer_for
from splatview.trainer.views import TrainViews, train_views
from splatview.trainer.warm_up import warm_up

NOW, WITHOUT = "now", "without"

NEVER = 10**9

WAYS: dict[str, list[tuple[Any, str, Any]]] = {
    NOW: [],
    WITHOUT: [],
    "the least depth": [(ensemble, "FOG_OF_ONE_IN", NEVER)],
    "the middle depth": [(ensemble, "FOG_OF_ONE_IN", 2)],
    "one block about": [(free_space, "ABOUT", 1)],
    "half of the steps on photos": [(ensemble, "TAUGHT_SHARE", 0.5)],
    "all steps on pictures": [(ensemble, "TAUGHT_SHARE", 1.0)],
}
"""Constants, by their modules and names, and what they are while the last scene is taught and trained.
WITHOUT has no free space before pictures taught, which no constant says."""


@contextmanager
def changed(constants: list[tuple[Any, str, Any]]) -> Iterator[None]:
    """The constants as a way has them, for a while."""
    before = [getattr(module, name) for module, name, _ in constants]
    try:
        for module, name, value in constants:
            setattr(module, name, value)
        yield
    finally:
        for (module, name, _), value in zip(constants, before, strict=True):
            setattr(module, name, value)


def train(trainer: EnsembleTrainer, pixels: float, seconds: float, over: Callable[[], bool]) -> float:
    """Steps until `over` says so, or the run is; the seconds that are over then, by the bench's model."""
    settings = trainer.settings
    while not (trainer.done or over()):
        factor = trainer.downscale
        seconds += step_seconds(pixels / factor**2, len(trainer.splats), trainer.batch)
        taught = trainer.taught
        trainer.step(seconds)
        if trainer.taught is not None and taught is None:
            drawn = len(trainer.taught) * len(trainer.members) * (2 if trainer.taught_depths else 1)
            seconds += drawn * step_seconds(pixels, settings.max_splats) / DRAWN
    return seconds


def compare(name: str, split: int, seed: int, options: argparse.Namespace) -> list[dict[str, Any]]:
    """A result for each way: PSNR in dB of held-out photos, after a fit of exposures, their mean and each,
    and SSIM; of the last scene, of those that teach it, and of the mean of their pictures. None where the run
    has no last scene."""
    capture = bench_split(name, split, options.data, options.made, 1, None)
    centre = capture.centre
    capture = capture.about(centre)
    views, held_out = TrainViews(train_views(capture.train), 0), train_views(capture.held_out)
    settings = settings_for(capture, views, minutes=options.minutes, seed=seed)
    first = trainer_for(capture, views, settings, centre=centre, threads=options.threads)
    if not isinstance(first, EnsembleTrainer):
        return []
    pixels = views.pixel_count / len(views)

    def shown(arrays: Parameters) -> list[np.ndarray]:
        return list(pictures(arrays, held_out, first.shown_settings, threads=options.threads))

    def score(drawn: Sequence[np.ndarray]) -> Evaluation:
        fitted = [fitted_by_tiles(one, view) for one, view in zip(drawn, held_out, strict=True)]
        return evaluation_of(held_out, fitted, threads=options.threads)

    with kernel_threads_only():
        seconds = train(first, pixels, START, lambda: first.taught is not None)
        if first.done:
            return []
        teach = [shown(member) for member in first.members]
        mean = score(list(np.clip(teach, 0, 1).mean(axis=0)))
        results = []
        for way in options.ways:
            trainer = copy.deepcopy(first)
            with changed(WAYS[way]):
                trainer._teach()
                if way == WITHOUT:
                    trainer.taught_depths.clear()
                train(trainer, pixels, seconds, lambda: False)
            drawn = shown(trainer.splats.arrays)
            found = score(drawn)
            if options.pictures is not None:
                options.pictures.mkdir(parents=True, exist_ok=True)
                rows = [
                    np.concatenate([np.asarray(side_by_side(view, picture)) for picture in (one, two)])
                    for view, one, two in zip(held_out, np.mean(teach, axis=0), drawn, strict=True)
                ]
                file = options.pictures / f"{name}-{split}-{seed}-{way}.png".replace(" ", "-")
                Image.fromarray(np.concatenate(rows)).save(file)
            results.append(
                {
                    "capture": name,
                    "split": split,
                    "seed": seed,
                    "minutes": options.minutes,
                    "photos": len(views),
                    "way": way,
                    "psnr_fitted": found.psnr,
                    "ssim": found.ssim,
                    "each": [one.psnr for one in found.scores],
                    "teachers": [score(one).psnr for one in teach],
                    "their_mean": mean.psnr,
                    "goes_on": trainer.goes_on,
                    "gaussians": len(trainer.splats),
                }
            )
            print(json.dumps(results[-1]), file=sys.stderr)
    return results


def table(runs: list[dict[str, Any]]) -> dict[str, Any]:
    """Means by capture, and what each way gains over WITHOUT, with the standard error of that mean."""
    ways = [way for way in WAYS if any(run["way"] == way for run in runs) and way != WITHOUT]
    rows = []
    for name in dict.fromkeys(run["capture"] for run in runs):
        by = {
            way: {(r["split"], r["seed"]): r for r in runs if r["capture"] == name and r["way"] == way}
            for way in WAYS
        }
        base = by[WITHOUT]

        def of(what: str, base: dict[Any, dict[str, Any]] = base) -> float:
            return float(np.mean([np.mean(run[what]) for run in base.values()]))

        row = [name, len(base), f"{of('psnr_fitted'):.2f}, {of('ssim'):.3f}"]
        row += [f"{of('teachers'):.2f}", f"{of('their_mean'):.2f}"]
        for way in ways:
            gains = [r["psnr_fitted"] - base[key]["psnr_fitted"] for key, r in by[way].items() if key in base]
            error = f" ± {np.std(gains, ddof=1) / len(gains) ** 0.5:.2f}" if len(gains) > 1 else ""
            some = f" ({len(gains)})" if len(gains) != len(base) else ""
            row.append(f"{np.mean(gains):+.2f}{error}{some}" if gains else "")
        rows.append(row)
    return {
        "columns": ["capture", "last scenes", "without", "those before", "their mean", *ways],
        "rows": rows,
        "note": "Last scenes by the same scenes before, that teach them: mean PSNR in dB of held-out thirds"
        " of the photos, after a fit of exposures, and SSIM, without free space before pictures taught; the"
        " PSNR of those that teach, and of the mean of their pictures; and what each way gains, with the"
        " standard error of its mean, in brackets of how many last scenes, where not of all. Minutes of a"
        " model of what a step costs on two cores.",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("captures", nargs="+")
    parser.add_argument("--splits", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--minutes", type=float, default=3.0)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=[WITHOUT, NOW])
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument(
        "--pictures",
        type=Path,
        help="folder for held-out photos beside the mean of the scenes that teach, and beside the last one",
    )
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()
    warm_up(lens=True)
    runs: list[dict[str, Any]] = []
    if options.output is not None and options.output.exists():
        runs = json.loads(options.output.read_text())["runs"]
    for name in options.captures:
        for split in options.splits:
            for seed in options.seeds:
                found = compare(name, split, seed, options)
                new = {(name, split, seed, run["way"]) for run in found}
                runs = [r for r in runs if (r["capture"], r["split"], r["seed"], r["way"]) not in new] + found
                if options.output is not None and runs:
                    write_results(options.output, {"runs": runs, "table": table(runs)})
    print(json.dumps(table(runs)["rows"], indent=1, ensure_ascii=False))


if __name__ == "__main__":
    main()
