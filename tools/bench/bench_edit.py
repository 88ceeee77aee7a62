"""Time and memory of editing one and five million splats; writes assets/benchmarks/edit.json.

    python tools/bench/bench_edit.py [--counts 1000000 5000000] [--repeats 7]

Each operation is done, undone and redone; the selection in force is a sphere's (runs of a scene in random
order: the worst that an index run can be asked to store) or every splat. "state" is what the picture needs
after an operation: the counts, and the edits as renderers read them.
"""

from __future__ import annotations

import gc
from typing import Any

import numpy as np
from harness import in_turn, make_parser, peak_bytes

from splatview.edit.document import Document
from splatview.edit.operations import operation_from_json
from splatview.measure.machine import write_results
from splatview.scene import Gaussians

FRAME_MS = 1000 / 60
CAMERA = {
    "width": 1920,
    "height": 1080,
    "fx": 1500.0,
    "fy": 1500.0,
    "cx": 960.0,
    "cy": 540.0,
    "world_to_camera": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]],
}
RECTANGLE = {"kind": "rectangle", "camera": CAMERA, "x0": 500, "y0": 300, "x1": 1200, "y1": 800}
SPHERE = {"kind": "sphere", "centre": [0.2, 0, 0], "radius": 0.8}
BOX = {"half_extents": [0.6, 0.5, 0.7], "rotation": [0.8, 0.6, 0, 0]}
TURN = {"op": "transform", "rotation": [0.9, 0.1, 0.3, 0], "translation": [0.1, 0, 0], "scale": 1.1}

Step = dict[str, Any]
CASES: dict[str, tuple[list[Step], Step]] = {
    "select by rectangle": ([], {"op": "select", "by": RECTANGLE}),
    "select by sphere": ([], {"op": "select", "by": SPHERE}),
    "invert the selection": ([{"op": "select", "by": SPHERE}], {"op": "select_inverse"}),
    "delete, scattered": ([{"op": "select", "by": SPHERE}], {"op": "delete"}),
    "delete all": ([{"op": "select_all"}], {"op": "delete"}),
    "hide": ([{"op": "select", "by": SPHERE}], {"op": "hide"}),
    "transform the selection": ([{"op": "select", "by": SPHERE}], TURN),
    "transform it again": ([{"op": "select", "by": SPHERE}, TURN], TURN),
    "transform the scene": ([], {**TURN, "scope": "scene"}),
    "add a crop box": ([], {"op": "add_crop", "crop": BOX}),
    "crop with a selection": ([{"op": "select", "by": SPHERE}], {"op": "add_crop", "crop": BOX}),
    "select in a crop": ([{"op": "add_crop", "crop": BOX}], {"op": "select_all"}),
    "grade colours": ([], {"op": "grade", "grade": {"saturation": 1.2}}),
}


def make_scene(count: int) -> Gaussians:
    rng = np.random.default_rng(0)
    return Gaussians(
        means=rng.uniform(-1, 1, (count, 3)).astype(np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        log_scales=rng.normal(-4, 0.5, (count, 3)).astype(np.float32),
        opacity_logits=rng.normal(size=count).astype(np.float32),
        sh=np.zeros((count, 1, 3), np.float32),
    )


def measure(scene: Gaussians, before: list[Step], step: Step, repeats: int) -> dict[str, float]:
    document = Document(scene)
    for earlier in before:
        document.apply(operation_from_json(earlier))
    operation = operation_from_json(step)
    start = document.history.position
    _ = document.edits
    ways = {
        "do": lambda _: document.apply(operation),
        "state": lambda _: document.edits,
        "undo": lambda _: document.undo(),
        "redo": lambda _: document.redo(),
    }

    def back(number: int) -> None:
        if number < repeats:
            document.jump(start)
            _ = document.edits

    # Once before for the compiler.
    times = in_turn(ways, repeats, rotate=False, after_round=back)
    change = document.history.steps[-1].change
    document.undo()
    gc.collect()
    return {
        **{name: own.median for name, own in times.items()},
        "stored_bytes": change.nbytes,
        "peak_bytes": peak_bytes(lambda: document.apply(operation)),
        "splats": change.count,
    }


def main() -> None:
    parser = make_parser(__doc__, "edit.json")
    parser.add_argument("--counts", type=int, nargs="+", default=[1_000_000, 5_000_000])
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    results: dict[str, dict[str, Any]] = {}
    for count in args.counts:
        scene = make_scene(count)
        for name, (before, step) in CASES.items():
            figures = measure(scene, before, step, args.repeats)
            results.setdefault(name, {})[str(count)] = figures
            over = "  over a frame" if figures["do"] > FRAME_MS else ""
            stored, peak = figures["stored_bytes"] / 1e6, figures["peak_bytes"] / 1e6
            times = "".join(f"{key} {figures[key]:8.2f}  " for key in ("do", "undo", "redo", "state"))
            print(f"{count:>9,} {name:24}{times}stored {stored:5.2f} MB, peak {peak:6.1f} MB{over}")
    columns = ["operation"]
    for count in args.counts:
        millions = f"{count / 1e6:g} M"
        columns += [f"{millions}: do, ms", "undo", "redo", "stored, MB", "peak, MB"]
    rows = []
    for name, by_count in results.items():
        row = [name]
        for count in args.counts:
            figures = by_count[str(count)]
            row += [f"{figures[key]:.1f}" for key in ("do", "undo", "redo")]
            row += [f"{figures[key] / 1e6:.2f}" for key in ("stored_bytes", "peak_bytes")]
        rows.append(row)
    write_results(
        args.output,
        {
            "results": results,
            "table": {
                "columns": columns,
                "rows": rows,
                "note": "Medians. Stored is what the history keeps of the step, peak the most that doing it "
                "takes besides the scene, which has 56 MB per million splats here and is never copied.",
            },
        },
    )


if __name__ == "__main__":
    main()
