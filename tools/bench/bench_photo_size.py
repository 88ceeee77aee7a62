"""What training on photos at the size that time allows brings, for photos larger than that.

    python tools/bench/bench_photo_size.py DATA MADE [--captures NAME ...] [--minutes 1 3]

Three ways for each capture and length: on all pixels, on smaller photos alone, and on these until near the
end and then on larger ones, as `trainer.photo_size` decides. All are measured on the held-out third
in full size, and in half of it. Minutes are those of `generalisation_run.step_seconds`, of two cores. What a
call has measured before is kept in assets/benchmarks/photo_size.json.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from capture_set import Use, front, objects, split_of
from generalisation_run import START, step_seconds

from splatview.measure.machine import FOLDER, write_results
from splatview.scene.captures import Capture, load_capture
from splatview.trainer.evaluate import evaluate
from splatview.trainer.photo_size import (
    HALF_THE_SIZE,
    Levels,
    automatic_downscale,
    automatic_levels,
    pixels_for,
)
from splatview.trainer.setup import kernel_threads_only, settings_for, trainer_for
from splatview.trainer.views import TrainViews, train_views
from splatview.trainer.warm_up import warm_up

CORES = 2

SPLIT = 0


class Large(NamedTuple):
    """A capture of large photos."""

    use: Use
    make: Callable[[Path, Path], None] | None
    """What renders it; None: photographs of DATA."""


CAPTURES = {
    "miku": Large("choose", None),
    "banana": Large("choose", None),
    "skull 800": Large("judge", objects("skull.ply", 40, points=True, size=800)),
    "guitar 800": Large("judge", objects("guitar/guitar.compressed.ply", 24, points=True, size=800)),
    "biker 960": Large("judge", front("biker/biker.compressed.ply", 24, size=960)),
}

NOTE = (
    "A third of the photos held out, one split and run each. All pixels: photos as they are, half their size"
    " for 30 % of the run. Smaller alone: smaller by as much as there are steps for. Larger at the end: the"
    " same until 80 % of the run, then up to three times as large each way, which is what is done where"
    " nobody says. PSNR in dB and SSIM in full size, then PSNR in half of it. The rule was chosen on captures"
    " marked so, and is only judged by the others."
)


def folder_of(name: str, data: Path, made: Path) -> Path:
    """Of a capture, rendered if it has to be."""
    make = CAPTURES[name].make
    if make is None:
        return data / "captures" / name
    folder = made / name.replace(" ", "-")
    if not (folder / "whole").exists():
        folder.mkdir(parents=True, exist_ok=True)
        make(data, folder)
        (folder / "whole").touch()
    return folder


def read(folder: Path, downscale: int) -> Capture:
    return split_of(load_capture(folder, downscale=downscale), SPLIT)


def ways(size: tuple[int, int], minutes: float) -> dict[str, tuple[int, Levels]]:
    """Way -> by what photos are made smaller, and the factors along the run."""
    factor = automatic_downscale([size], minutes, CORES)
    smaller = size[0] // factor, size[1] // factor
    alone = max(round(math.sqrt(math.prod(size) / pixels_for(minutes, CORES))), 1)
    return {
        "all pixels": (1, HALF_THE_SIZE),
        "smaller alone": (alone, HALF_THE_SIZE),
        "larger at the end": (factor, automatic_levels([smaller], minutes, CORES)),
    }


def train(folder: Path, minutes: float, downscale: int, levels: Levels) -> dict[str, Any]:
    """One run and its scores."""
    whole = read(folder, downscale)
    capture = whole.about(whole.centre)
    views = TrainViews(train_views(capture.train), 0)
    settings = settings_for(capture, views, minutes=minutes, resolution=levels)
    trainer = trainer_for(capture, views, settings, centre=whole.centre, threads=1)
    pixels, used = views.pixel_count / len(views), START
    with kernel_threads_only():
        while not trainer.done:
            used += step_seconds(pixels / trainer.downscale**2, len(trainer.splats))
            trainer.step(used)
    found: dict[str, Any] = {"steps": trainer.counters.iteration, "splats": len(trainer.splats)}
    for name, factor in (("full", 1), ("half", 2)):
        held_out = train_views(read(folder, factor).about(whole.centre).held_out)
        score = evaluate(
            *(trainer.splats.arrays, held_out, trainer.shown_settings),
            exposures_differ=trainer.exposures.is_on,
        )
        found |= {f"{name}_psnr": score.psnr, f"{name}_ssim": score.ssim}
    return found


Key = tuple[str, float, str]


def known(path: Path) -> dict[Key, dict[str, Any]]:
    """What earlier calls have measured: capture, minutes and way -> a run."""
    if not path.exists():
        return {}
    runs = json.loads(path.read_text(encoding="utf8"))["runs"]
    return {(run["capture"], run["minutes"], run["way"]): run for run in runs}


def table(runs: dict[Key, dict[str, Any]]) -> dict[str, Any]:
    names = list(ways((4000, 3000), 1))
    rows = []
    for name in CAPTURES:
        for minutes in sorted({m for capture, m, _ in runs if capture == name}):
            of = {way: runs[name, minutes, way] for way in names if (name, minutes, way) in runs}
            if len(of) < len(names):
                continue
            size = "{}x{}".format(*next(iter(of.values()))["size"])
            scores = [
                f"{r['full_psnr']:.2f} ({r['full_ssim']:.3f}), {r['half_psnr']:.2f}" for r in of.values()
            ]
            rows.append([name, CAPTURES[name].use, size, f"{minutes:g}", *scores])
    return {"columns": ["capture", "rules", "photos, px", "minutes", *names], "rows": rows, "note": NOTE}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--captures", nargs="+", choices=list(CAPTURES), default=list(CAPTURES))
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.0, 3.0])
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "photo_size.json")
    options = parser.parse_args()
    warm_up()
    for name in options.captures:
        folder = folder_of(name, options.data, options.made)
        camera = read(folder, 1).photos[0].camera
        size = camera.width, camera.height
        for minutes in options.minutes:
            for way, (downscale, levels) in ways(size, minutes).items():
                if (name, minutes, way) in known(options.output):
                    continue
                run = {"capture": name, "minutes": minutes, "way": way, "size": size}
                run |= {"downscale": downscale, "levels": levels, **train(folder, minutes, downscale, levels)}
                # Another call may have been at other captures meanwhile.
                runs = known(options.output) | {(name, minutes, way): run}
                print(name, minutes, way, f"{run['full_psnr']:.2f}", flush=True)
                write_results(options.output, {"runs": list(runs.values()), "table": table(runs)})


if __name__ == "__main__":
    main()
