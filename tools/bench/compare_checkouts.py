"""Times one checkout against another: start-up, loading, frames, training steps.

    python tools/bench/compare_checkouts.py BEFORE AFTER [-o OUT.json] [--items help,info] [--rounds N]

Each item runs `CHECKOUT/.venv/bin/splatview` in turn (before, after, before, after, ...), so that a machine
that becomes slower meets both. The ratio is after by before, pair by pair: its median, and its quartiles as
the spread. Beside the time that is meant (milliseconds of a frame, seconds of a whole run) stands the ratio
of processor seconds, which other programs on the machine disturb less.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

STEPS = 200
"""Of a training run."""

WARM_UP_STEPS = 50
"""Training steps that are not counted: the first ones load kernels."""


class Failed(Exception):
    """A command ended with an error; the message is its last line."""


@dataclass(frozen=True)
class Item:
    """One thing that is timed."""

    name: str
    arguments: tuple[str, ...]
    unit: str
    value: Callable[[Path, str, float], float]
    """The time from the folder that the command ran in, its standard output, and its seconds."""


def whole_run(folder: Path, out: str, seconds: float) -> float:
    return seconds


def frame_ms(folder: Path, out: str, seconds: float) -> float:
    return json.loads(out)["ms"]["total"]


def step_ms(folder: Path, out: str, seconds: float) -> float:
    """Milliseconds of a step, without start-up and evaluation."""
    lines = [json.loads(line) for line in (folder / "o.jsonl").read_text().splitlines()]
    at = {line["iteration"]: line["seconds"] for line in lines}
    # The line of the last step is written after the evaluation of the held-out photos.
    last = max(step for step in at if step < STEPS)
    return 1e3 * (at[last] - at[WARM_UP_STEPS]) / (last - WARM_UP_STEPS)


def make_items(scenes: Path, captures: Path) -> list[Item]:
    """What can be timed with the shared data that there is; the bundled demo's photos need none."""
    items = [Item("help", ("--help",), "s", whole_run)]
    for name, file in (("info", "train-1000"), ("load-skull", "skull"), ("load-playbot", "playbot_lod0")):
        path = scenes / f"{file}.ply"
        if path.exists():
            items.append(Item(name, ("info", str(path), "--json"), "s", whole_run))
    skull = scenes / "skull.ply"
    if skull.exists():
        moving = ("--frames", "15", "--turn", "3", "--stats")
        for backend, size in (("cpu", "480x320"), ("quads", "160x120"), ("tiles", "160x120")):
            command = ("render", str(skull), "--renderer", backend, "--size", size, *moving)
            items.append(Item(f"frame-{backend}", command, "ms", frame_ms))
    banana = captures / "banana"
    photos = (str(banana), "--downscale", "4") if banana.exists() else ("--demo",)
    run = ("--headless", "--iterations", str(STEPS), "--seed", "1", "-o", "o.ply", "--metrics", "o.jsonl")
    items.append(Item("train-step", ("train", *photos, *run), "ms", step_ms))
    return items


def timed(checkout: Path, item: Item) -> tuple[float, float]:
    """The item's time, and processor seconds. Raises Failed."""
    with tempfile.TemporaryDirectory(prefix="bench-") as name:
        folder = Path(name)
        hidden = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH", "PYTHONDONTWRITEBYTECODE")
        environment = {key: value for key, value in os.environ.items() if key not in hidden}
        command = [checkout / ".venv" / "bin" / "splatview", *item.arguments]
        with open(folder / "out", "w+") as out, open(folder / "err", "w+") as err:
            begun = time.perf_counter()
            child = subprocess.Popen(
                command, cwd=folder, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=err
            )
            _, status, usage = os.wait4(child.pid, 0)
            seconds = time.perf_counter() - begun
            child.returncode = os.waitstatus_to_exitcode(status)
            out.seek(0)
            err.seek(0)
            if child.returncode != 0:
                raise Failed((err.read().splitlines() or ["no word why"])[-1])
            return item.value(folder, out.read(), seconds), usage.ru_utime + usage.ru_stime


def compared(before: Path, after: Path, item: Item, rounds: int) -> dict[str, Any]:
    """Times of both by turns, and their ratios. Raises Failed."""
    checkouts = (before, after)
    for checkout in checkouts:
        timed(checkout, item)
    times: tuple[list[float], list[float]] = ([], [])
    processor: tuple[list[float], list[float]] = ([], [])
    for number in range(rounds):
        # Which one is first changes, so that neither always has the warmer caches.
        for side in (0, 1) if number % 2 == 0 else (1, 0):
            value, used = timed(checkouts[side], item)
            times[side].append(value)
            processor[side].append(used)
    return {
        "item": item.name,
        "unit": item.unit,
        "before": statistics.median(times[0]),
        "after": statistics.median(times[1]),
        "ratio": spread([b / a for a, b in zip(*times, strict=True)]),
        "processor_ratio": spread([b / a for a, b in zip(*processor, strict=True)]),
        "times": {"before": times[0], "after": times[1]},
    }


def spread(values: Sequence[float]) -> dict[str, float]:
    if len(values) == 1:
        return {"median": values[0], "low": values[0], "high": values[0]}
    low, median, high = statistics.quantiles(values, n=4, method="inclusive")
    return {"median": median, "low": low, "high": high}


def as_line(result: dict[str, Any]) -> str:
    ratios = (result["ratio"], result["processor_ratio"])
    cells = [f"{r['median']:6.3f} ({r['low']:.3f} to {r['high']:.3f})" for r in ratios]
    unit = result["unit"]
    return (
        f"{result['item']:14}{result['before']:9.3f} {unit:3}{result['after']:9.3f} {unit:3}{cells[0]:27}"
        f"{cells[1]}"
    )


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("-o", "--output", type=Path, metavar="OUT.json")
    parser.add_argument("--items", metavar="A,B", help="only these")
    parser.add_argument("--rounds", type=int, default=7, metavar="N", help="runs of each (default: 7)")
    parser.add_argument("--scenes", type=Path, help="default: ../shared/data/scenes of BEFORE")
    parser.add_argument("--captures", type=Path, help="default: ../shared/data/captures of BEFORE")
    args = parser.parse_args(argv)
    before, after = args.before.resolve(), args.after.resolve()
    data = before.parent / "shared" / "data"
    items = make_items(
        (args.scenes or data / "scenes").resolve(), (args.captures or data / "captures").resolve()
    )
    if args.items:
        wanted = args.items.split(",")
        unknown = set(wanted) - {item.name for item in items}
        if unknown:
            parser.error(
                f"no item {', '.join(sorted(unknown))}; there are {', '.join(i.name for i in items)}"
            )
        items = [item for item in items if item.name in wanted]
    if args.rounds < 1:
        parser.error("--rounds must be at least 1")
    print(f"{'item':14}{'before':>9}    {'after':>9}    {'after / before':27}of processor time")
    results, failed = [], 0
    for item in items:
        try:
            results.append(compared(before, after, item, args.rounds))
            print(as_line(results[-1]), flush=True)
        except Failed as error:
            failed += 1
            print(f"{item.name:14}failed: {error}", flush=True)
    if args.output:
        machine = {"system": " ".join(os.uname()), "cores": os.cpu_count()}
        report = {"machine": machine, "rounds": args.rounds, "items": results}
        args.output.write_text(json.dumps(report, indent=1) + "\n", encoding="utf8")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
