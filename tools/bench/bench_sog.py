"""Scenes as .sog by splatview and by splat-transform on the CPU: size, quality, and time to encode.

    python tools/bench/bench_sog.py SCENE ... --splat-transform PATH [--limit 250] [-o JSON]

One file of each: splat-transform takes minutes, and is stopped after the limit, in seconds. Its time includes
its start and reading; that of splatview includes both too, in a process of its own. dB over the six views of
`convert`; one that has no file has none. Where both have one, also the smallest of ours with its dB, as
`--target` finds it.
"""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from harness import make_parser

from splatview.measure.machine import write_results
from splatview.renderers.conversion import measure, sample_views
from splatview.renderers.rate_distortion import Judge, Target
from splatview.scene import Gaussians
from splatview.scene.formats import load_scene

OURS = "import sys; from splatview.scene.formats import *; save_scene(load_scene(sys.argv[1]), sys.argv[2])"


def encoded(command: list[str], path: Path, judge: Judge, limit: float) -> dict[str, Any]:
    """Seconds, bytes and dB of what the command writes as `path`; seconds alone where it was stopped."""
    begun = time.perf_counter()
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=limit)
    except subprocess.TimeoutExpired:
        return {"stopped_after": limit}
    seconds = time.perf_counter() - begun
    error, _ = judge.error(load_scene(path))
    psnr = -10 * math.log10(error) if error else None
    return {"seconds": seconds, "bytes": path.stat().st_size, "psnr": psnr}


def at_quality(gaussians: Gaussians, judge: Judge, psnr: float) -> dict[str, Any]:
    """Bytes and dB of the smallest file of ours that is as good."""
    target = Target(psnr=psnr)
    with measure(gaussians, Path("scene.sog"), target=target, cameras=judge.cameras) as measured:
        return {"bytes": measured.found.bytes, "psnr": measured.found.psnr}


def cells(found: dict[str, Any]) -> list[str]:
    if "seconds" not in found:
        return ["", "", f"more than {found['stopped_after']:.0f}"]
    return [f"{found['bytes'] / 1e6:.3f}", f"{found['psnr'] or math.inf:.1f}", f"{found['seconds']:.1f}"]


def main() -> None:
    parser = make_parser(__doc__, "sog.json", scenes=True)
    parser.add_argument("--splat-transform", type=Path, required=True, metavar="PATH")
    parser.add_argument("--limit", type=float, default=250.0)
    options = parser.parse_args()
    results, rows = [], []
    for scene in options.scenes:
        gaussians = load_scene(scene)
        judge = Judge(gaussians, sample_views(gaussians))
        with tempfile.TemporaryDirectory() as name:
            ours, theirs = Path(name) / "ours.sog", Path(name) / "theirs.sog"
            program = ["node", str(options.splat_transform), "-g", "cpu", "-q", "-w", str(scene), str(theirs)]
            own = encoded([sys.executable, "-c", OURS, str(scene), str(ours)], ours, judge, options.limit)
            other = encoded(program, theirs, judge, options.limit)
        equal = at_quality(gaussians, judge, other["psnr"]) if other.get("psnr") else {}
        results.append(
            {"scene": scene.name, "splatview": own, "splat-transform": other, "at_their_quality": equal}
        )
        ratio = other.get("seconds", options.limit) / own["seconds"]
        more = "" if "seconds" in other else "more than "
        smallest = f"{equal['bytes'] / 1e6:.3f}" if equal else ""
        rows.append([scene.name, *cells(own), *cells(other), f"{more}{ratio:.0f}", smallest])
        columns = ["scene", *(f"{who}: {what}" for who in ("ours", "theirs") for what in ("MB", "dB", "s"))]
        table = {
            "columns": [*columns, "times as fast", "ours at their dB: MB"],
            "rows": rows,
            "note": "One file each, from start to end of a process; splat-transform on the CPU.",
        }
        write_results(options.output, {"results": results, "table": table})


if __name__ == "__main__":
    main()
