"""The smallest file of a quality in each format that has knobs, against the same format as it is written
without a target.

    python tools/bench/bench_targets.py SCENE ... [--add] [-o JSON]

No times are compared, so scenes may be added one by one: with --add those that are in the JSON stay.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

from harness import load_scenes, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.conversion import measure, sample_views
from splatview.renderers.rate_distortion import Target
from splatview.scene import Gaussians, InputError
from splatview.scene.demo import demo_scene

SUFFIXES = (".spz", ".sog")

QUALITIES = (35.0, 40.0, 45.0)
"""dB"""


def row_of(found: list[dict[str, Any]]) -> list[str]:
    """The row of one scene and format."""
    first = found[0]
    row = [
        f"{first['scene']}, `{first['format']}`",
        f"{first['usual_bytes'] / 1e6:.3g} ({first['usual_psnr']:.1f} dB)",
    ]
    for result in found:
        kept = f"{result['splats'] / result['of']:.0%}" if "bytes" in result else ""
        row.append(f"{result['bytes'] / 1e6:.3g} ({kept})" if "bytes" in result else "not reached")
    return row


def results_of(name: str, scene: Gaussians, suffix: str) -> list[dict[str, Any]]:
    """One result for each of QUALITIES."""
    views, path, results = sample_views(scene), Path(f"scene{suffix}"), []
    with measure(scene, path, cameras=views) as plain:
        usual = plain.found
    for quality in QUALITIES:
        result: dict[str, Any] = {"scene": name, "format": suffix, "target": quality, "of": len(scene)}
        result |= {"usual_bytes": usual.bytes, "usual_psnr": usual.psnr}
        try:
            with measure(scene, path, target=Target(psnr=quality), cameras=views) as measured:
                found = measured.found
        except InputError as error:
            result["refused"] = str(error)
        else:
            result |= {"bytes": found.bytes, "psnr": found.psnr, "max_error": found.max_error}
            result |= {"splats": found.splats, "knobs": dict(found.knobs), "lost": list(found.lost)}
        print(result, flush=True)
        results.append(result)
    return results


def main() -> None:
    parser = make_parser(__doc__, "targets.json", scenes=True)
    parser.add_argument("--add", action="store_true", help="keep what the JSON has of other scenes")
    options = parser.parse_args()
    results: list[list[dict[str, Any]]] = []
    scenes = load_scenes(options.scenes, lambda: {"the demo": demo_scene()})
    if options.add and options.output.exists():
        stored = json.loads(options.output.read_text(encoding="utf8"))["results"]
        of_one = itertools.groupby(stored, lambda result: (result["scene"], result["format"]))
        results = [list(found) for (name, _), found in of_one if name not in scenes]
    columns = [
        "scene, format",
        "MB as usual",
        *(f"{quality:g} dB: MB (splats)" for quality in QUALITIES),
    ]
    note = "Pictures of six views from around the scene, by the CPU renderer."
    for name, scene in scenes.items():
        for suffix in SUFFIXES:
            results.append(results_of(name, scene, suffix))
            table = {"columns": columns, "rows": [row_of(found) for found in results], "note": note}
            # After each, as a search of a large scene takes minutes.
            write_results(options.output, {"results": list(itertools.chain(*results)), "table": table})


if __name__ == "__main__":
    main()
