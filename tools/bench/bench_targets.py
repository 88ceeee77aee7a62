"""The smallest file of a quality in each format that has knobs, against the same format as it is written
without a target.

    python tools/bench/bench_targets.py SCENE ... [-o JSON]

No times are compared; the files written for each search are counted.
"""

from __future__ import annotations

from pathlib import Path

from harness import load_scenes, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.conversion import measure, sample_views
from splatview.renderers.rate_distortion import Target
from splatview.scene import InputError
from splatview.scene.demo import demo_scene

SUFFIXES = (".spz", ".sog")

QUALITIES = (35.0, 40.0, 45.0)
"""dB"""


def main() -> None:
    parser = make_parser(__doc__, "targets.json", scenes=True)
    options = parser.parse_args()
    results, rows = [], []
    for name, scene in load_scenes(options.scenes, lambda: {"the demo": demo_scene()}).items():
        views = sample_views(scene)
        for suffix in SUFFIXES:
            path = Path(f"scene{suffix}")
            with measure(scene, path, cameras=views) as plain:
                usual = plain.found
            row = [f"{name}, `{suffix}`", f"{usual.bytes / 1e6:.2f} ({usual.psnr:.1f} dB)"]
            for quality in QUALITIES:
                try:
                    with measure(scene, path, target=Target(psnr=quality), cameras=views) as measured:
                        found = measured.found
                except InputError as error:
                    results.append(
                        {"scene": name, "format": suffix, "target": quality, "refused": str(error)}
                    )
                    row.append("-")
                    continue
                results.append(
                    {
                        "scene": name,
                        "format": suffix,
                        "target": quality,
                        "bytes": found.bytes,
                        "psnr": found.psnr,
                        "max_error": found.max_error,
                        "splats": found.splats,
                        "of": len(scene),
                        "knobs": dict(found.knobs),
                        "lost": list(found.lost),
                        "usual_bytes": usual.bytes,
                        "usual_psnr": usual.psnr,
                    }
                )
                row.append(f"{found.bytes / 1e6:.2f} ({found.splats / len(scene):.0%})")
                print(results[-1], flush=True)
            rows.append(row)
    columns = [
        "scene, format",
        "MB as usual",
        *(f"MB for {quality:g} dB (splats kept)" for quality in QUALITIES),
    ]
    note = "Pictures of six views from around the scene, by the CPU renderer."
    write_results(
        options.output, {"results": results, "table": {"columns": columns, "rows": rows, "note": note}}
    )


if __name__ == "__main__":
    main()
