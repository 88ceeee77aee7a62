"""What a frame of a sequence takes to be decoded, and to be handed to the picture, in turn.

    python tools/bench/bench_sequence.py [--rounds N] [-o JSON]

Frames are the demo of 196,000 splats, as .ply, .spz and .sog. Compared are a frame of a sequence that plays
and the same file as a scene of its own, and an upload whose plan another thread has found with one that
finds it itself. Counted is the processor time of the thread, which other programs lengthen little.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from harness import in_turn, make_parser

from splatview.measure.machine import write_results
from splatview.renderers.gl import context
from splatview.renderers.gl.quads import QuadsRenderer
from splatview.renderers.gl.scene_buffers import upload_plan
from splatview.scene.demo import demo_scene
from splatview.scene.formats import save_scene
from splatview.scene.formats.sequence import SceneSequence
from splatview.scene.gaussians import Gaussians
from splatview.scene.progress import NO_PROGRESS
from splatview.viewer.loading import load_frame

SUFFIXES = (".ply", ".spz", ".sog")


def thread_ms(work: Callable[[], object]) -> float:
    begun = time.thread_time()
    work()
    return 1e3 * (time.thread_time() - begun)


def longest_step(steps: Any) -> tuple[float, float]:
    """Processor ms of the whole upload, and of its longest step."""
    ms = []
    begun = time.thread_time()
    ended = False
    while not ended:
        ended = next(steps, None) is None
        now = time.thread_time()
        ms.append(1e3 * (now - begun))
        begun = now
    return sum(ms), max(ms)


def quartiles(values: np.ndarray) -> list[float]:
    return [float(value) for value in np.percentile(values, [25, 50, 75])]


def main() -> None:
    parser = make_parser(__doc__, "sequence.json")
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    scene = demo_scene()
    results: list[dict[str, Any]] = []

    def compare(name: str, one: str, other: str, ways: dict[str, Callable[[int], float]]) -> None:
        timings = in_turn(ways, options.rounds)
        ms = {way: np.array(timings[way].values) for way in ways}
        ratio = quartiles(ms[one] / ms[other])
        results.append({"what": name, "ms": {way: quartiles(ms[way]) for way in ways}, "ratio": ratio})
        print(f"{name}: {np.median(ms[one]):.1f} against {np.median(ms[other]):.1f} ms, {ratio[1]:.2f}")

    with tempfile.TemporaryDirectory() as folder:
        for suffix in SUFFIXES:
            path = Path(folder) / f"frame{suffix}"
            save_scene(scene, path)
            sequence = SceneSequence(paths=(path, path), name="frames")
            like = load_frame(sequence, 0, NO_PROGRESS)

            def frame(_: int, sequence=sequence, like=like) -> float:
                return thread_ms(lambda: load_frame(sequence, 1, NO_PROGRESS, like=like))

            def alone(_: int, sequence=sequence) -> float:
                return thread_ms(lambda: load_frame(sequence, 0, NO_PROGRESS))

            compare(f"decode {suffix}", "frame", "scene", {"frame": frame, "scene": alone})
    with context.create_headless_context() as ctx:
        renderer = QuadsRenderer(ctx)

        def fresh() -> Gaussians:
            return scene.take(slice(None))

        def planned(_: int) -> float:
            copy = fresh()
            upload_plan(copy, every_band=True)
            return longest_step(renderer.load_steps(copy))[0]

        def unplanned(_: int) -> float:
            return longest_step(renderer.load_steps(fresh()))[0]

        compare("upload", "planned", "unplanned", {"planned": planned, "unplanned": unplanned})
        renderer.close()
    columns = ["work", "as a frame, ms", "as a scene, ms", "ratio"]
    rows = []
    for one in results:
        first, second = (found[1] for found in one["ms"].values())
        low, middle, high = one["ratio"]
        rows.append([one["what"], f"{first:.0f}", f"{second:.0f}", f"{middle:.2f} ({low:.2f} to {high:.2f})"])
    note = (
        "Processor time of the thread that does it; the demo of 196,000 splats. Upload by OpenGL in software."
    )
    write_results(
        options.output, {"results": results, "table": {"columns": columns, "rows": rows, "note": note}}
    )


if __name__ == "__main__":
    main()
