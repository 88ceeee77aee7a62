"""What splatview makes of packed scenes, against what splat-transform makes of the same files.

    python tools/bench/bench_decodes.py SCENE ... --splat-transform PATH [-o JSON]

splat-transform writes each as a .ply of float32, which is read and compared splat by splat, and in pictures
of six views from around the scene. FILE=FILE compares two files that should hold the same, without it.
"""

from __future__ import annotations

import math
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from harness import make_parser

from splatview.measure.machine import write_results
from splatview.renderers.conversion import sample_views
from splatview.renderers.rate_distortion import Judge
from splatview.scene.formats import load_scene


def compared(path: Path, other: Path) -> dict[str, Any]:
    """Largest difference of positions in shares of the scene's extent, and dB, infinite as None."""
    ours, theirs = load_scene(path), load_scene(other)
    if len(ours) != len(theirs):
        return {"splats": len(ours), "splats_of_the_other": len(theirs)}
    error, _ = Judge(theirs, sample_views(theirs)).error(ours)
    extent = float(np.ptp(theirs.means, axis=0).max())
    return {
        "splats": len(ours),
        "position": float(np.abs(ours.means - theirs.means).max()) / extent,
        "psnr": -10 * math.log10(error) if error else None,
    }


def row(name: str, found: dict[str, Any]) -> list[str]:
    if "refused" in found:
        return [name, "", "", f"not read by the other: {found['refused']}"]
    if "position" not in found:
        return [name, f"{found['splats']:,}", "", f"{found['splats_of_the_other']:,} splats in the other"]
    psnr = "the same" if found["psnr"] is None else f"{found['psnr']:.1f}"
    return [name, f"{found['splats']:,}", f"{found['position']:.1e}" if found["position"] else "0", psnr]


def main() -> None:
    parser = make_parser(__doc__, "decodes.json")
    parser.add_argument("scenes", nargs="+", metavar="SCENE")
    parser.add_argument("--splat-transform", type=Path, required=True, metavar="PATH")
    options = parser.parse_args()
    results: dict[str, dict[str, Any]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for scene in options.scenes:
            path, other = (Path(part) for part in (*scene.split("=", 1), "")[:2])
            name = f"{path.name}, {other.name}" if "=" in scene else path.name
            if path.name == "meta.json":
                name = f"{path.parent.name}/{name}"
            if "=" not in scene:
                other = Path(folder) / f"{len(results)}.ply"
                command = ["node", str(options.splat_transform), "-q", "-w", str(path), str(other)]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                if done.returncode:
                    said = [line for line in (done.stderr + done.stdout).splitlines() if "ERROR" in line]
                    results[name] = {"refused": said[0].strip() if said else f"exit code {done.returncode}"}
                    continue
            results[name] = compared(path, other)
            print(*row(name, results[name]), sep=" | ", flush=True)
    table = {
        "columns": ["file", "splats", "largest difference of positions, of the extent", "dB"],
        "rows": [row(name, found) for name, found in results.items()],
        "note": "Each file as splat-transform 2.7.1 decodes it, or as the second file has it; pictures of "
        "six views from around the scene, by the CPU renderer.",
    }
    write_results(options.output, {"results": results, "table": table})


if __name__ == "__main__":
    main()
