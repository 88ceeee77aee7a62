"""How long packed scenes take to read and write, by splatview and by other programs, in one run.

    python tools/bench/bench_format_speed.py SCENE [--gsply PYTHON] [--splat-transform PATH] [--rounds 5]

Every way once a round, in turn. splatview and gsply (a Python with the package gsply[spz,sogs]) are measured
in processes that stay, after a round that compiles; splat-transform is a program that starts anew each time,
from which the time of `--version` is taken off. Its output is `null` when it reads; when it writes, it reads
the compressed .ply, the time of which is taken off too. Times are elapsed; those of the processor beside
them say how much of a ratio is threads. Rows of a program that is not there are left out, and so is what one
has not written after LIMIT seconds, which is written down as more than that. With --add a program can be
measured in a run of its own, each beside splatview.

STAGES are what no reader of these files goes without: reading the bytes, unpacking them by the same libraries
in two threads, and filling the memory that the scene's arrays take, which the system clears first, in two
threads as well. All programs return every attribute as arrays of float32. gsply's SH of a compressed .ply are
a view of an array in the file's order, channel by channel; IN_ORDER is the same with the copy that has them
coefficient by coefficient, as its readers of other formats and ours return them.
"""

from __future__ import annotations

import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from harness import make_parser
from webp import WebPData

from splatview.measure.machine import write_results
from splatview.scene.formats import load_scene, save_scene
from splatview.scene.gaussians import Gaussians

SUFFIXES = (".spz", ".splat", ".sog", ".compressed.ply")

LIMIT = 60.0
"""Seconds."""

GSPLY = """
import json, sys, time
import gsply
import numpy as np
scene = gsply.plyread(sys.argv[1])
writers = {
    ".compressed.ply": lambda path: gsply.plywrite(path, scene, compressed=True),
    ".spz": lambda path: gsply.write_spz(path, scene, version=4),
}
def in_order(path):
    scene = gsply.plyread(path)
    scene.shN = np.ascontiguousarray(scene.shN)
    return scene
readers = {".compressed.ply": gsply.plyread, ".spz": gsply.read_spz, ".sog": gsply.sogread}
print(json.dumps({"read": sorted(readers), "write": sorted(writers)}), flush=True)
works = {"read": readers, "write": writers, "in order": {".compressed.ply": in_order}}
for line in sys.stdin:
    work, suffix, path = json.loads(line)
    begun, busy = time.perf_counter(), time.process_time()
    works[work][suffix](path)
    print(json.dumps([time.perf_counter() - begun, time.process_time() - busy]), flush=True)
"""
"""A process that does what it is told in lines, and answers with seconds."""


@dataclass
class Times:
    elapsed: list[float] = field(default_factory=list)
    """Seconds of each round."""
    busy: list[float] = field(default_factory=list)
    """Seconds of the processor."""

    def add(self, pair: tuple[float, float]) -> None:
        self.elapsed.append(pair[0])
        self.busy.append(pair[1])


Way = Callable[[], tuple[float, float]]


def timed(work: Callable[[], object]) -> tuple[float, float]:
    begun, busy = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - begun, time.process_time() - busy


def ways_of_ours(scene: Path, files: dict[str, Path], folder: Path) -> dict[tuple[str, str], Way]:
    gaussians = load_scene(scene)
    ways: dict[tuple[str, str], Way] = {}
    for suffix, path in files.items():
        ways["read", suffix] = lambda path=path: timed(lambda: load_scene(path))
        target = folder / f"ours{suffix}"
        ways["write", suffix] = lambda target=target: timed(lambda: save_scene(gaussians, target))
    return ways


STAGES = ("its bytes alone", "unpacking alone", "memory alone")
IN_ORDER = "gsply, its SH in order"


def ways_of_stages(files: dict[str, Path], scene: Gaussians) -> dict[str, dict[tuple[str, str], Way]]:
    """By name of STAGES."""
    pool = ThreadPoolExecutor(2)
    numbers = dict.fromkeys(files, scene.nbytes // 4)
    numbers[".splat"] = 14 * len(scene)

    def frames(data: bytes) -> list[tuple[bytes, int]]:
        """Streams of a .spz of version 4 and their sizes unpacked, the largest first."""
        streams, table_at = data[15], int.from_bytes(data[16:20], "little")
        sizes = np.frombuffer(data, "<u8", 2 * streams, table_at).astype(int).reshape(-1, 2)
        edges = table_at + 16 * streams + np.concatenate([[0], np.cumsum(sizes[:, 0])])
        packed = [data[start:stop] for start, stop in itertools.pairwise(edges.tolist())]
        return list(zip(packed, sizes[:, 1].tolist(), strict=True))[::-1]

    def unpack_frame(frame: tuple[bytes, int]) -> None:
        zstandard.ZstdDecompressor().stream_reader(frame[0]).readinto(np.empty(frame[1], np.uint8).data)

    def unpack(suffix: str, path: Path) -> None:
        if suffix == ".spz":
            list(pool.map(unpack_frame, frames(path.read_bytes())))
        else:
            with zipfile.ZipFile(path) as archive:
                names = [name for name in archive.namelist() if name.endswith(".webp")]
                list(pool.map(lambda name: WebPData.from_buffer(archive.read(name)).decode(), names))

    def fill(count: int) -> None:
        memory = np.empty(count, np.float32)
        list(pool.map(lambda part: part.fill(0), np.array_split(memory, 2)))

    packed = {suffix: path for suffix, path in files.items() if suffix in (".spz", ".sog")}
    ways: list[dict[tuple[str, str], Way]] = [
        {("read", suffix): lambda path=path: timed(path.read_bytes) for suffix, path in files.items()},
        {
            ("read", suffix): lambda suffix=suffix, path=path: timed(lambda: unpack(suffix, path))
            for suffix, path in packed.items()
        },
        {
            ("read", suffix): lambda count=count: timed(lambda: fill(count))
            for suffix, count in numbers.items()
        },
    ]
    return dict(zip(STAGES, ways, strict=True))


def ways_of_gsply(
    python: Path, scene: Path, files: dict[str, Path], folder: Path
) -> tuple[dict[tuple[str, str], Way], dict[tuple[str, str], Way]]:
    """Of gsply and of IN_ORDER."""
    process = subprocess.Popen(
        [python, "-c", GSPLY, scene], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdin is not None and process.stdout is not None
    told, answers = process.stdin, process.stdout

    def ask(work: str, suffix: str, path: Path) -> tuple[float, float]:
        told.write(json.dumps([work, suffix, str(path)]) + "\n")
        told.flush()
        elapsed, busy = json.loads(answers.readline())
        return elapsed, busy

    known = json.loads(answers.readline())
    ways: dict[tuple[str, str], Way] = {}
    for suffix, path in files.items():
        if suffix in known["read"]:
            ways["read", suffix] = lambda suffix=suffix, path=path: ask("read", suffix, path)
        if suffix in known["write"]:
            target = folder / f"gsply{suffix}"
            ways["write", suffix] = lambda suffix=suffix, target=target: ask("write", suffix, target)
    packed = ".compressed.ply"
    return ways, {("read", packed): lambda: ask("in order", packed, files[packed])}


def run_program(command: list[str]) -> tuple[float, float]:
    """Seconds, infinite where it takes longer than LIMIT."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    begun = time.perf_counter()
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return float("inf"), float("inf")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    busy = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return time.perf_counter() - begun, busy


def ways_of_splat_transform(
    program: Path, files: dict[str, Path], folder: Path
) -> dict[tuple[str, str], Way]:
    command = ["node", str(program)]
    ways: dict[tuple[str, str], Way] = {("start", ""): lambda: run_program([*command, "--version"])}
    for suffix, path in files.items():
        read = [*command, "-q", "-w", str(path), "null"]
        ways["read", suffix] = lambda read=read: run_program(read)
        if suffix != ".splat":  # which it does not write
            write = [
                *command,
                "-g",
                "cpu",
                "-q",
                "-w",
                str(files[".compressed.ply"]),
                str(folder / f"other{suffix}"),
            ]
            ways["write", suffix] = lambda write=write: run_program(write)
    return ways


def measured(
    programs: dict[str, dict[tuple[str, str], Way]], rounds: int
) -> dict[tuple[str, str, str], Times]:
    """By program, work and suffix. What once took longer than LIMIT is not done again."""
    found = {(name, *key): Times() for name, ways in programs.items() for key in ways}
    for number in range(rounds + 1):
        for key, times in found.items():
            if times.elapsed and not np.isfinite(times.elapsed[-1]):
                continue
            # Virtual machines give free memory back to their host, and whoever is the first to take it again
            # waits for it: ten times as long as for memory that another program has just left.
            np.empty(1 << 28, np.uint8).fill(0)
            pair = programs[key[0]][key[1], key[2]]()
            # The first round compiles, but a program that starts anew never does better.
            if number or not np.isfinite(pair[0]):
                times.add(pair)
        os.sync()
    return found


def net(times: Times, off: list[Times]) -> tuple[list[float], float]:
    """Elapsed seconds by round, less those of `off` in the same round, and the median of the processor's."""
    elapsed = [
        max(value - sum(each.elapsed[i] for each in off), 1e-3) for i, value in enumerate(times.elapsed)
    ]
    return elapsed, float(np.median(times.busy) - sum(float(np.median(each.busy)) for each in off))


def results_of(found: dict[tuple[str, str, str], Times], sizes: dict[str, int]) -> list[dict[str, Any]]:
    results = []
    for (name, work, suffix), times in found.items():
        if work == "start":
            continue
        off = []
        if name == "splat-transform":
            off.append(found[name, "start", ""])
            if work == "write":
                # Reading it has a start of its own, so that this takes off both.
                off = [found[name, "read", ".compressed.ply"]]
        elapsed, busy = net(times, off) if np.isfinite(times.elapsed[0]) else ([float("inf")], float("inf"))
        ours = found["splatview", work, suffix]
        ratios = [a / b for a, b in zip(ours.elapsed, elapsed, strict=False)]
        endless = not np.isfinite(elapsed[0])
        results.append(
            {
                "program": name,
                "work": work,
                "format": suffix,
                "ours_seconds": float(np.median(ours.elapsed)),
                "seconds": None if endless else float(np.median(elapsed)),
                "processor_seconds": None if endless else busy,
                "rounds": None if endless else elapsed,
                "ours_in_it": float(np.median(ratios)) if not endless else max(ours.elapsed) / LIMIT,
                "ours_in_it_range": [min(ratios), max(ratios)],
                "ours_in_it_of_the_processor": None if endless else float(np.median(ours.busy)) / busy,
                "bytes": sizes.get(f"{name}{suffix}") if work == "write" else None,
            }
        )
    return results


def rows_of(results: list[dict[str, Any]]) -> list[list[str]]:
    rows = []
    for result in results:
        if result["program"] == "splatview":
            continue
        endless = result["seconds"] is None
        low, high = result["ours_in_it_range"]
        rows.append(
            [
                f"{result['work']} `{result['format']}`, {result['program']}",
                f"{result['ours_seconds']:.3f}",
                f"more than {LIMIT:.0f}" if endless else f"{result['seconds']:.3f}",
                f"under {result['ours_in_it']:.2f}"
                if endless
                else f"{result['ours_in_it']:.2f} ({low:.2f} to {high:.2f})",
                "" if endless else f"{result['ours_in_it_of_the_processor']:.2f}",
            ]
        )
    return rows


def stored_results(path: Path) -> list[dict[str, Any]]:
    """What an earlier run has found. Ends the program where it is of another shape, before anything is
    measured."""
    needed = {"program", "work", "format", "ours_seconds", "seconds", "ours_in_it", "ours_in_it_range"}
    try:
        stored = json.loads(path.read_text(encoding="utf8"))["results"]
        if all(needed | {"ours_in_it_of_the_processor"} <= one.keys() for one in stored):
            return stored
    except (ValueError, KeyError, TypeError, AttributeError):
        pass
    raise SystemExit(
        f"{path}: is of another version of this benchmark: measure all without --add, or move it"
    )


def main() -> None:
    parser = make_parser(__doc__, "format_speed.json")
    parser.add_argument("scene", type=Path)
    parser.add_argument("--gsply", type=Path, metavar="PYTHON")
    parser.add_argument("--splat-transform", type=Path, metavar="PATH")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--add", action="store_true", help="keep what the JSON has of other programs")
    options = parser.parse_args()
    stored = stored_results(options.output) if options.add and options.output.exists() else []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        files = {suffix: folder / f"scene{suffix}" for suffix in SUFFIXES}
        gaussians = load_scene(options.scene)
        for path in files.values():
            save_scene(gaussians, path)
        programs = {"splatview": ways_of_ours(options.scene, files, folder)}
        programs |= ways_of_stages(files, gaussians)
        missing = []
        if options.gsply and options.gsply.exists():
            programs["gsply"], programs[IN_ORDER] = ways_of_gsply(options.gsply, options.scene, files, folder)
        else:
            missing.append("gsply")
        if options.splat_transform and options.splat_transform.exists():
            programs["splat-transform"] = ways_of_splat_transform(options.splat_transform, files, folder)
        else:
            missing.append("splat-transform")
        found = measured(programs, options.rounds)
        sizes = {
            f"{label}{suffix}": path.stat().st_size
            for suffix in SUFFIXES
            for label, path in (
                ("splatview", folder / f"ours{suffix}"),
                ("gsply", folder / f"gsply{suffix}"),
                ("splat-transform", folder / f"other{suffix}"),
            )
            if path.exists()
        }
    if missing:
        print(f"not there, and left out: {', '.join(missing)}", file=sys.stderr)
    results = results_of(found, sizes)
    results += [one for one in stored if one["program"] not in programs]
    columns = ["what, and beside whom", "splatview, s", "the other, s", "ratio", "ratio of processor time"]
    note = (
        f"Medians of rounds in turn ({options.rounds} of the first rows) on {options.scene.name} "
        f"({len(gaussians):,} splats of SH degree {gaussians.sh_degree}); ratios are our time divided "
        "by the other's, with their range. splat-transform's start, and its reading where it writes, are "
        "taken off; gsply writes .spz "
        "in version 4."
    )
    seconds = {(one["program"], one["work"], one["format"]): one["seconds"] for one in results}
    shares = []
    for (name, work, suffix), other in seconds.items():
        if (name, work) == ("gsply", "read"):
            least = sum(seconds.get((stage, work, suffix), 0.0) for stage in STAGES[1:])
            shares.append(f"{least / other:.2f} of gsply's time for `{suffix}`")
    if shares:
        note += f" Unpacking alone and memory alone together take {', '.join(shares)}."
    missing = [name for name in missing if all(one["program"] != name for one in results)]
    if missing:
        note += f" Not measured, as not there: {', '.join(missing)}."
    write_results(
        options.output,
        {
            "scene": options.scene.name,
            "splats": len(gaussians),
            "results": results,
            "table": {"columns": columns, "rows": rows_of(results), "note": note},
        },
    )


if __name__ == "__main__":
    main()
