"""What each format makes of a scene: size, the quality of what comes back, and how long it takes.

    python tools/bench/bench_formats.py [SCENE ...] [--rounds 5] [-o JSON]

Without scenes the demo of 196,000 splats is written. Every format once a round, in turn, after the conversion
whose quality is told, which has compiled everything by then; a format whose writing took over LONG seconds is
not written again, and has one time.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import load_scenes, make_parser, spread

from splatview.measure.machine import write_results
from splatview.renderers.conversion import Conversion, convert
from splatview.scene.demo import demo_scene
from splatview.scene.formats import FORMATS, load_scene, save_scene, trial_path
from splatview.scene.gaussians import Gaussians

LONG = 5.0
"""Seconds."""


def cells(found: Conversion) -> list[str]:
    exact = found.psnr == math.inf
    quality = "exact" if exact else f"{found.psnr:.1f}"
    return [f"{found.bytes / 1e6:.2f}", quality, f"{255 * found.max_error:.0f}"]


def seconds_of(work: Callable[[], object]) -> float:
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def times_of(scene: Gaussians, folder: Path, rounds: int) -> dict[str, dict[str, list[float]]]:
    """Seconds of each round, by format and what is done. Written files are made anew each time."""
    paths = {}
    for known in (known for known in FORMATS.values() if known.write):
        own = folder / str(len(paths))
        own.mkdir()
        paths[known.suffix] = trial_path(own, Path(f"scene{known.suffix}"))
    found: dict[str, dict[str, list[float]]] = {suffix: {"write": [], "read": []} for suffix in paths}
    for _ in range(rounds):
        for suffix, path in paths.items():
            write, read = found[suffix]["write"], found[suffix]["read"]
            if not write or write[0] <= LONG:
                write.append(seconds_of(lambda path=path: save_scene(scene, path)))
            read.append(seconds_of(lambda path=path: load_scene(path)))
    return found


def cell(seconds: list[float]) -> str:
    return spread(float(np.median(seconds)), (min(seconds), max(seconds)), digits=3)


def main() -> None:
    parser = make_parser(__doc__, "formats.json", scenes=True)
    parser.add_argument("--rounds", type=int, default=5)
    options = parser.parse_args()
    results: list[dict[str, Any]] = []
    rows: list[list[str]] = []
    for name, scene in load_scenes(options.scenes, lambda: {"the demo": demo_scene()}).items():
        found: dict[str, Conversion] = {}
        for known in (known for known in FORMATS.values() if known.write):
            with tempfile.TemporaryDirectory() as folder:
                found[known.suffix] = convert(scene, trial_path(Path(folder), Path(f"scene{known.suffix}")))
        with tempfile.TemporaryDirectory() as folder:
            times = times_of(scene, Path(folder), options.rounds)
        for suffix, made in found.items():
            result = {"scene": name, "format": suffix, "bytes": made.bytes, "splats": made.splats}
            psnr = None if made.psnr == math.inf else made.psnr
            quality = {"psnr": psnr, "max_error": made.max_error, "lost": list(made.lost)}
            results.append({**result, **quality, "seconds": times[suffix]})
            seconds = [cell(times[suffix][work]) for work in ("write", "read")]
            rows.append([f"{name}, `{suffix.lstrip('/')}`", *cells(made), *seconds])
        columns = ["scene, format", "MB", "dB", "largest error of 255", "written, s", "read, s"]
        note = (
            "Pictures of six views from around the scene, by the CPU renderer. Seconds are medians of "
            f"{options.rounds} rounds in turn (least to most); what took over {LONG:g} s was written once."
        )
        table = {"columns": columns, "rows": rows, "note": note}
        write_results(options.output, {"results": results, "table": table})


if __name__ == "__main__":
    main()
