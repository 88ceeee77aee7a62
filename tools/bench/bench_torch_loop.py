"""The training loop of one checkout against that of another, step by step in turn; and what autograd costs.

    python tools/bench/bench_torch_loop.py BEFORE AFTER CAPTURES [--rounds N] [--steps N]

BEFORE and AFTER are checkouts with a `.venv`; CAPTURES has the folders `banana` and `miku`. Each checkout has
a process that trains the same photos from the same splats. The two take STEPS steps in turn, so that a
machine that becomes slower meets both; the ratio is that of pairs: its median, and its quartiles as the
spread. Beside the clock stands processor time, which other programs on the machine disturb less. The overhead
of autograd is what a step's picture, loss and gradients take through torch, by what the same kernels take
when they are called one after the other, in turn as well.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from compare_checkouts import Item, compared, spread

CASES = (("banana", 2, 20_000), ("miku", 4, 20_000), ("miku", 4, 200_000))
"""Capture, --downscale, splats."""

WARM_UP_STEPS = 20


def work(capture: str, downscale: int, splats: int) -> None:
    """The process of one checkout: trains, a line of answer for each line asked."""
    import numpy as np

    from splatview.raster import Workspace
    from splatview.scene.captures import load_capture
    from splatview.trainer.settings import TrainSettings
    from splatview.trainer.trainer import Trainer
    from splatview.trainer.views import TrainViews, train_views

    try:
        from splatview.trainer.initialisation import initial_parameters
        from splatview.trainer.recipe import automatic_dropout, automatic_max_aspect
        from splatview.trainer.torch_import import TorchImport

        TorchImport().wait()  # as the command has it, with its threads off
    except ImportError:  # the checkout before
        from splatview.trainer.settings import automatic_dropout, automatic_max_aspect  # pyright: ignore
        from splatview.trainer.splats import initial_parameters  # pyright: ignore

    photos = load_capture(capture, downscale=downscale)
    rng = np.random.default_rng(0)
    chosen = rng.integers(len(photos.points), size=splats)
    points = photos.points[chosen] + rng.normal(scale=0.002 * photos.scene_radius, size=(splats, 3))
    views = TrainViews(train_views(photos.train), 0)
    settings = TrainSettings(
        resolution=(),
        sh_every=0.0,
        max_splats=splats,
        dropout=automatic_dropout(len(views)),
        max_aspect=automatic_max_aspect(len(views)),
    )
    radius = photos.scene_radius
    parameters = initial_parameters(points, photos.point_colours[chosen], radius)
    trainer = Trainer(views, parameters, radius, settings)
    for _ in range(WARM_UP_STEPS):
        trainer.step()
    kept: dict[str, Any] = {"gradients": None, "workspace": Workspace()}
    print("ready", flush=True)
    for line in sys.stdin:
        what, count = line.split()
        begun, used = time.perf_counter(), time.process_time()
        if what == "step":
            for _ in range(int(count)):
                trainer.step()
        else:
            one_way(trainer, what, int(count), kept)
        print(time.perf_counter() - begun, time.process_time() - used, flush=True)


def one_way(trainer: Any, what: str, count: int, kept: dict[str, Any]) -> None:
    """Pictures, losses and gradients of a step, through torch or by the kernels themselves, whose memory is
    `kept` from call to call."""
    import torch

    from splatview.raster import EARLY_STOP, draw_frame
    from splatview.raster.gradients import differentiate
    from splatview.trainer import functional
    from splatview.trainer.loss import photo_loss

    settings, workspace = trainer.render_settings, kept["workspace"]
    for place in range(count):
        view = trainer.views.at(place)
        if what == "torch":
            image, _ = functional.rasterize(
                *trainer.splats.parameters(),
                camera=view.camera,
                settings=settings,
                early_stop=EARLY_STOP,
            )
            functional.photo_loss(image, torch.from_numpy(view.pixels)).backward()
            trainer.optimizer.zero_grad()
        else:
            frame = draw_frame(trainer.splats.arrays, view.camera, settings, workspace)
            loss = photo_loss(frame.image, view.pixels, workspace)
            arrays, reuse = trainer.splats.arrays, kept["gradients"]
            kept["gradients"] = differentiate(arrays, frame, loss.d_image, reuse=reuse)


def answer(once: Callable[[], object]) -> None:
    """In a worker's process: runs `once` as often as each line asked says, and answers with the seconds and
    processor seconds."""
    for line in sys.stdin:
        count = int(line.split()[1])
        begun, used = time.perf_counter(), time.process_time()
        for _ in range(count):
            once()
        print(time.perf_counter() - begun, time.process_time() - used, flush=True)


class Worker:
    def __init__(self, checkout: Path, capture: Path, downscale: int, splats: int) -> None:
        python = checkout / ".venv" / "bin" / "python"
        command = [python, Path(__file__).resolve(), "--work", capture, str(downscale), str(splats)]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self._line()

    def ask(self, what: str, count: int) -> tuple[float, float]:
        """Seconds and processor seconds."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{what} {count}\n")
        self.process.stdin.flush()
        seconds, used = map(float, self._line().split())
        return seconds, used

    def _line(self) -> str:
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise SystemExit("a process of the benchmark has ended")
        return line

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()
        self.process.wait()


def in_turn(
    sides: list[tuple[Worker, str]], rounds: int, steps: int
) -> tuple[list[dict[str, float]], list[dict[str, float]]]:
    """Of two ways: ratios (clock, processor) of the second by the first, and ms of a step by the second."""
    found: list[list[tuple[float, float]]] = [[], []]
    for number in range(rounds):
        for side in (0, 1) if number % 2 == 0 else (1, 0):
            worker, what = sides[side]
            found[side].append(worker.ask(what, steps))
    ratios = [spread([after[k] / before[k] for before, after in zip(*found, strict=True)]) for k in (0, 1)]
    return ratios, [
        {
            "before_ms": 1e3 * statistics.median(one[k] for one in found[0]) / steps,
            "after_ms": 1e3 * statistics.median(one[k] for one in found[1]) / steps,
        }
        for k in (0, 1)
    ]


def start_seconds(folder: Path, out: str, seconds: float) -> float:
    """From the process's begin to the end of the first step, everything cached."""
    return float(json.loads((folder / "o.jsonl").read_text().splitlines()[0])["seconds"])


def measured(
    before: Path, after: Path, captures: Path, rounds: int, steps: int, kinds: list[str]
) -> list[dict[str, Any]]:
    results = []
    for name, downscale, splats in CASES if set(kinds) != {"start"} else ():
        few = steps if splats < 100_000 else max(steps // 4, 2)
        workers = [Worker(checkout, captures / name, downscale, splats) for checkout in (before, after)]
        compare = {
            "loop": [(workers[0], "step"), (workers[1], "step")],
            "autograd": [(workers[1], "kernels"), (workers[1], "torch")],
        }
        for kind, sides in compare.items():
            if kind not in kinds:
                continue
            (clock, processor), (ms, processor_ms) = in_turn(sides, rounds, few)
            case = f"{name} --downscale {downscale}, {splats:,} splats"
            result = {"case": case, "kind": kind, "clock": clock, "processor": processor}
            results.append({**result, "ms": ms, "processor_ms": processor_ms})
            print(row(results[-1]), flush=True)
        for worker in workers:
            worker.close()
    if "start" not in kinds:
        return results
    run = ("--downscale", "2", "--headless", "--iterations", "1", "-o", "o.ply", "--metrics", "o.jsonl")
    item = Item("start", ("train", str(captures / "banana"), *run), "s", start_seconds)
    found = compared(before, after, item, max(rounds // 2, 3))
    results.append(
        {
            "case": "banana --downscale 2, start to first step",
            "kind": "start",
            "clock": found["ratio"],
            "processor": found["processor_ratio"],
            "ms": {"before_ms": 1e3 * found["before"], "after_ms": 1e3 * found["after"]},
        }
    )
    print(row(results[-1]), flush=True)
    return results


KINDS = {"loop": "a step", "autograd": "of it, autograd", "start": "start"}


def row(result: dict[str, Any]) -> list[str]:
    times = result["ms"]
    cells = [f"{one['median']:.3f} ({one['low']:.3f}-{one['high']:.3f})" for one in (result["clock"],)]
    cells += [f"{one['median']:.3f} ({one['low']:.3f}-{one['high']:.3f})" for one in (result["processor"],)]
    return [
        f"{result['case']}: {KINDS[result['kind']]}",
        f"{times['before_ms']:.2f}",
        f"{times['after_ms']:.2f}",
        *cells,
    ]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    for name in ("before", "after", "captures"):
        parser.add_argument(name, type=Path)
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--steps", type=int, default=20)
    kinds = [*KINDS]
    parser.add_argument("--only", choices=kinds, nargs="+", default=kinds, help="others stay as they are")
    parser.add_argument("-o", "--output", type=Path)
    options = parser.parse_args()

    from splatview.measure.machine import FOLDER, write_results

    before, after = options.before.resolve(), options.after.resolve()
    captures, path = options.captures.resolve(), options.output or FOLDER / "torch_loop.json"
    found = measured(before, after, captures, options.rounds, options.steps, options.only)
    known = json.loads(path.read_text(encoding="utf8"))["results"] if path.exists() else []
    merged = {(one["case"], one["kind"]): one for one in (*known, *found)}
    results = list(merged.values())
    table = {
        "columns": ["what", "before, ms", "after, ms", "after / before", "in processor time"],
        "rows": [row(result) for result in results],
        "note": "Medians and quartiles of pairs in turn. Before: a loop in numpy; after: the same kernels"
        " through torch. Of autograd: the kernels of a step called directly, and through torch. The start:"
        " from the process's begin to the first step's end.",
    }
    write_results(path, {"results": results, "table": table})


if __name__ == "__main__":
    if sys.argv[1:2] == ["--work"]:
        work(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    else:
        main()
