"""Memory that reading and writing scenes of each format takes at its peak, in units of the scene.

    python tools/bench/bench_format_memory.py [--splats 500000] [--only SUFFIX ...] [-o JSON]

Each in a child process, which first does the same with a few splats, so that libraries are loaded and kernels
compiled; what it holds then is taken off. The scene counts, be it the one that is read or the one that is
written: 1.0 is the scene alone. Splats have SH of degree 3 and are all different: nothing that was quantised
before is recognised again. Linux alone tells a process's peak (VmHWM), and starts it anew.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from harness import make_parser

from splatview.measure.machine import write_results
from splatview.scene.formats import FORMATS, load_scene, save_scene
from splatview.scene.gaussians import ARRAYS, Gaussians

FEW = 1000
"""Splats of the scene that warms up."""


def made_scene(splats: int) -> Gaussians:
    """Splats on a wavy surface, with colours and SH that change along it and some noise."""
    rng = np.random.default_rng(7)
    flat = rng.uniform(-1, 1, (splats, 2))
    height = 0.3 * np.sin(3 * flat[:, :1]) * np.cos(2 * flat[:, 1:])
    waves = np.sin(flat @ rng.normal(0, 3, (2, 48)) + rng.uniform(0, 6, 48)) * np.geomspace(0.3, 0.02, 48)
    sh = (waves + rng.normal(0, 0.02, (splats, 48))).astype(np.float32)
    return Gaussians(
        means=np.column_stack([flat, height]).astype(np.float32),
        quats=rng.normal(size=(splats, 4)).astype(np.float32),
        log_scales=rng.normal(-6, 0.7, (splats, 3)).astype(np.float32),
        opacity_logits=rng.normal(1, 2, splats).astype(np.float32),
        sh=sh.reshape(splats, 16, 3),
    )


def kept(name: str) -> int:
    """Bytes of this process: VmRSS now, or VmHWM, the most since `forget_peak`."""
    found = re.search(rf"{name}:\s*(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return int(found[1]) << 10


def forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


def child(work: str, suffix: str, folder: Path) -> None:
    """Prints the peak in bytes, and those of the scene."""
    few = place(folder, "few", suffix)
    if work == "read":
        load_scene(few)
        before = kept("VmRSS")
        forget_peak()
        scene = load_scene(place(folder, "written", suffix))
    else:
        save_scene(load_scene(few), place(folder, "few_written", suffix))
        before = kept("VmRSS")
        stored = np.load(folder / "scene.npz")
        scene = Gaussians(**{name: stored[name] for name in stored.files})
        forget_peak()
        save_scene(scene, place(folder, "written", suffix))
    print(json.dumps([kept("VmHWM") - before, scene.nbytes]))


def main() -> None:
    if sys.argv[1:2] == ["--child"]:
        work, suffix, folder = sys.argv[2:]
        child(work, suffix, Path(folder))
        return
    parser = make_parser(__doc__, "format_memory.json")
    parser.add_argument("--splats", type=int, default=500_000)
    parser.add_argument("--only", nargs="*", metavar="SUFFIX", help="measure these; others stay in the JSON")
    options = parser.parse_args()
    scene, few = made_scene(options.splats), made_scene(FEW)
    found: dict[str, dict[str, Any]] = {}
    if options.only and options.output.exists():
        found = json.loads(options.output.read_text(encoding="utf8"))["results"]
    for known in FORMATS.values():
        if known.write is None or (options.only and known.suffix not in options.only):
            continue
        found[known.suffix] = peaks_of(known.suffix, scene, few)
        # After each, as a palette takes a while.
        write_results(options.output, {"results": found, "table": table_of(found, scene)})


def peaks_of(suffix: str, scene: Gaussians, few: Gaussians) -> dict[str, Any]:
    """Bytes of the peaks and of the scenes, by what is done."""
    found = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(folder / "scene.npz", **{key: getattr(scene, key) for key in ARRAYS})
        save_scene(few, place(folder, "few", suffix))
        for work in ("write", "read"):
            command = [sys.executable, __file__, "--child", work, suffix, name]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            peak, size = json.loads(done.stdout)
            found[work] = {"peak_bytes": peak, "scene_bytes": size}
            print(f"{work} {suffix}: {peak / 1e6:.0f} MB, {peak / size:.2f} scenes of {size / 1e6:.0f} MB")
    return found


def table_of(found: dict[str, dict[str, Any]], scene: Gaussians) -> dict[str, Any]:
    order = [known.suffix for known in FORMATS.values() if known.suffix in found]
    rows = [
        [
            f"`{suffix}`",
            *(
                f"{found[suffix][work]['peak_bytes'] / found[suffix][work]['scene_bytes']:.2f}"
                for work in ("read", "write")
            ),
        ]
        for suffix in order
    ]
    note = (
        f"Peaks in units of the scene ({len(scene):,} splats of SH degree 3, {scene.nbytes / 1e6:.0f} MB), "
        "which counts itself, beyond what the program takes before."
    )
    return {"columns": ["format", "read", "written"], "rows": rows, "note": note}


def place(folder: Path, label: str, suffix: str) -> Path:
    """Where a scene of a format lies; those of folders have one each."""
    if not suffix.startswith("/"):
        return folder / f"{label}{suffix}"
    (folder / label).mkdir(exist_ok=True)
    below = folder / label / Path(suffix).stem
    below.mkdir(exist_ok=True)
    return below / suffix.strip("/")


if __name__ == "__main__":
    main()
