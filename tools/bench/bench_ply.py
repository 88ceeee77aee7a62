"""Reading and writing a .ply of 500,000 splats: ours against plyfile, and the floor that a plain read sets.

    python tools/bench/bench_ply.py [SCENE.ply] [--rounds N]

All take turns in one process, with the file in the page cache; ratios are those of the medians. Peak memory
is what tracemalloc sees (numpy reports its arrays to it), in a run of its own. Without a scene a synthetic
one of SH degree 3 is made.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import plyfile
from bench_kernels import synthetic_scene
from harness import in_turn, peak_bytes

from splatview.measure.machine import FOLDER, write_results
from splatview.scene import Gaussians
from splatview.scene.formats import load_scene, save_scene

SPLATS = 500_000


def read_with_plyfile(path: Path) -> list[np.ndarray]:
    """What one writes by hand: plyfile, then the columns stacked to the arrays of a scene."""
    rows = plyfile.PlyData.read(path)["vertex"].data

    def stacked(*names: str) -> np.ndarray:
        return np.stack([rows[name] for name in names], axis=1)

    rest = sum(name.startswith("f_rest_") for name in rows.dtype.names)
    sh = stacked(*(f"f_dc_{i}" for i in range(3)))[:, None]
    if rest:
        higher = stacked(*(f"f_rest_{i}" for i in range(rest))).reshape(len(rows), 3, -1)
        sh = np.concatenate([sh, higher.transpose(0, 2, 1)], axis=1)
    return [
        stacked(*"xyz"),
        stacked(*(f"rot_{i}" for i in range(4))),
        stacked(*(f"scale_{i}" for i in range(3))),
        np.array(rows["opacity"]),
        sh,
    ]


def write_with_plyfile(scene: Gaussians, path: Path) -> None:
    """The same file by hand: a table of all columns, then plyfile."""
    rest = scene.sh.shape[1] - 1
    columns = {name: scene.means[:, i] for i, name in enumerate("xyz")}
    columns |= dict.fromkeys(("nx", "ny", "nz"), np.zeros(len(scene), np.float32))
    columns |= {f"f_dc_{c}": scene.sh[:, 0, c] for c in range(3)}
    columns |= {f"f_rest_{c * rest + k}": scene.sh[:, 1 + k, c] for c in range(3) for k in range(rest)}
    columns["opacity"] = scene.opacity_logits
    columns |= {f"scale_{i}": scene.log_scales[:, i] for i in range(3)}
    columns |= {f"rot_{i}": scene.quats[:, i] for i in range(4)}
    table = np.empty(len(scene), dtype=[(name, "<f4") for name in columns])
    for name, values in columns.items():
        table[name] = values
    plyfile.PlyData([plyfile.PlyElement.describe(table, "vertex")], byte_order="<").write(str(path))


def measure(path: Path, folder: Path, rounds: int) -> dict[str, Any]:
    scene = load_scene(path)
    for ours, theirs in zip(
        (scene.means, scene.quats, scene.log_scales, scene.opacity_logits, scene.sh),
        read_with_plyfile(path),
        strict=True,
    ):
        if ours.tobytes() != theirs.tobytes():
            raise AssertionError("plyfile reads other values: the comparison is void")
    target = folder / "written.ply"
    tasks: dict[str, Callable[[], object]] = {
        "read, splatview": lambda: load_scene(path),
        "read, plyfile and stacked columns": lambda: read_with_plyfile(path),
        "read, numpy.fromfile (the floor)": lambda: np.fromfile(path, dtype=np.uint8),
        "write, splatview (fsync included)": lambda: save_scene(scene, target),
        "write, plyfile from the arrays (no fsync)": lambda: write_with_plyfile(scene, target),
    }
    times = in_turn({name: lambda _, task=task: task() for name, task in tasks.items()}, rounds)
    medians = {name: own.median for name, own in times.items()}
    ranges = {name: own.range for name, own in times.items()}
    peaks = {name: peak_bytes(task) for name, task in tasks.items()}
    ours, theirs, floor = (medians[name] for name in list(tasks)[:3])
    return {
        "scene": {"name": path.name, "splats": len(scene), "sh_degree": scene.sh_degree},
        "file_bytes": path.stat().st_size,
        "array_bytes": scene.nbytes,
        "rounds": rounds,
        "ratios": {
            "plyfile / splatview": round(theirs / ours, 2),
            "splatview / fromfile": round(ours / floor, 2),
            "peak / arrays": round(peaks["read, splatview"] / scene.nbytes, 3),
        },
        "results": {
            name: {
                "ms": round(medians[name], 1),
                "min": round(low, 1),
                "max": round(high, 1),
                "peak_bytes": peaks[name],
            }
            for name, (low, high) in ranges.items()
        },
        "table": {
            "columns": ["operation", "ms (median)", "min to max", "peak memory / arrays"],
            "rows": [
                [
                    name,
                    f"{medians[name]:.0f}",
                    f"{low:.0f} to {high:.0f}",
                    f"{peaks[name] / scene.nbytes:.2f}",
                ]
                for name, (low, high) in ranges.items()
            ],
            "note": f"{path.name}: {len(scene):,} splats, SH degree {scene.sh_degree}, "
            f"{path.stat().st_size / 2**20:.0f} MiB, in the page cache; {rounds} rounds, taking turns.",
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="?")
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        path = options.scene
        if path is None:
            path = Path(name) / "synthetic.ply"
            save_scene(synthetic_scene(SPLATS), path)
        results = measure(path, Path(name), options.rounds)
    for name, each in results["results"].items():
        print(
            f"{name:41} {each['ms']:7.1f} ms  {each['peak_bytes'] / results['array_bytes']:5.2f} x the arrays"
        )
    print(results["ratios"])
    write_results(FOLDER / "ply.json", results)


if __name__ == "__main__":
    main()
