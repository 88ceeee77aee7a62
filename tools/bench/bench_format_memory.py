"""Memory that reading and writing scenes of each format takes at its peak, in units of the scene.

    python tools/bench/bench_format_memory.py [--splats 500000] [-o JSON]

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

import numpy as np
from harness import make_parser

from splatview.measure.machine import write_results
from splatview.scene.formats import FORMATS, load_scene, save_scene
from splatview.scene.gaussians import Gaussians

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
        scene = load_scene(place(folder, "scene", suffix))
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
    parser.add_argument("--only", metavar="SUFFIX", help="this format alone")
    options = parser.parse_args()
    scene, few = made_scene(options.splats), made_scene(FEW)
    results, rows = [], []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        np.savez(
            folder / "scene.npz",
            **{key: getattr(scene, key) for key in ("means", "quats", "log_scales", "opacity_logits", "sh")},
        )
        for known in FORMATS.values():
            suffix = known.suffix
            if known.write is None or (options.only and options.only != suffix):
                continue
            cells = []
            for one, label in ((few, "few"), (scene, "scene")):
                save_scene(one, place(folder, label, suffix))
            for work in ("read", "write"):
                command = [sys.executable, __file__, "--child", work, suffix, name]
                done = subprocess.run(command, check=True, capture_output=True, text=True)
                peak, size = json.loads(done.stdout)
                results.append({"format": suffix, "work": work, "peak_bytes": peak, "scene_bytes": size})
                cells.append(f"{peak / size:.2f}")
                print(
                    f"{work} {suffix}: {peak / 1e6:.0f} MB, {peak / size:.2f} scenes of {size / 1e6:.0f} MB"
                )
            rows.append([f"`{suffix}`", *cells])
    note = (
        f"Peaks in units of the scene ({options.splats:,} splats of SH degree 3, {scene.nbytes / 1e6:.0f} "
        "MB), which counts itself, beyond what the program takes before."
    )
    columns = ["format", "read", "written"]
    write_results(
        options.output,
        {
            "splats": options.splats,
            "results": results,
            "table": {"columns": columns, "rows": rows, "note": note},
        },
    )


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
