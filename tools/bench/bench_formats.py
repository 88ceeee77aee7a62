"""What each format makes of a scene: size, and the quality of what comes back.

    python tools/bench/bench_formats.py [SCENE ...] [-o JSON]

Without scenes the demo of 196,000 splats is written. No times are taken.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from harness import load_scenes, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.conversion import Conversion, convert
from splatview.scene.demo import demo_scene
from splatview.scene.formats import FORMATS


def cells(found: Conversion) -> list[str]:
    exact = found.psnr == math.inf
    quality = "exact" if exact else f"{found.psnr:.1f}"
    return [f"{found.bytes / 1e6:.2f}", quality, f"{255 * found.max_error:.0f}"]


def main() -> None:
    parser = make_parser(__doc__, "formats.json", scenes=True)
    options = parser.parse_args()
    results, rows = [], []
    for name, scene in load_scenes(options.scenes, lambda: {"the demo": demo_scene()}).items():
        for known in (known for known in FORMATS.values() if known.write):
            with tempfile.TemporaryDirectory() as folder:
                found = convert(scene, Path(folder) / f"scene{known.suffix}")
            result = {"scene": name, "format": known.suffix, "bytes": found.bytes, "splats": found.splats}
            psnr = None if found.psnr == math.inf else found.psnr
            results.append({**result, "psnr": psnr, "max_error": found.max_error, "lost": list(found.lost)})
            rows.append([f"{name}, `{known.suffix}`", *cells(found)])
    columns = ["scene, format", "MB", "dB", "largest error of 255"]
    note = "Pictures of six views from around the scene, by the CPU renderer."
    write_results(
        options.output, {"results": results, "table": {"columns": columns, "rows": rows, "note": note}}
    )


if __name__ == "__main__":
    main()
