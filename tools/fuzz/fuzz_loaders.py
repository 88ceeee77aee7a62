"""Damaged files through every loader, in processes of their own, with limits to memory and time.

    python tools/fuzz/fuzz_loaders.py --seconds 60 [--loader ply ...] [--failures DIR] [--json FILE] [--more]
    python tools/fuzz/fuzz_loaders.py --minimise LOADER FILE > SMALLER

Every file is drawn by a number: those of a loader begin at --start, or with --more where the counts in the
JSON file end, which are added to. A failure is anything but a scene or one line that says what is wrong: its
file is kept in DIR. The exit code is 1 if there was any.
"""

from __future__ import annotations

import argparse
import multiprocessing
import multiprocessing.sharedctypes
import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from loaders import BY_NAME, LOADERS, Loader
from results import add_to, read
from trials import (
    SECONDS,
    SPARE_BYTES,
    TIMES_THE_FILE,
    Trial,
    damaged_file,
    limit_memory,
)

OUTCOMES = ("loaded", "refused", "failed")

PATIENCE = 150.0
"""Seconds for a file on a busy machine: a loader that takes longer waits for something, or computes where no
signal reaches it."""

KEPT_OF_A_KIND = 3
"""Files of failures that end in the same line."""

_CONTEXT = multiprocessing.get_context("fork")


@dataclass
class Counts:
    """Of one loader."""

    next_seed: int = 0
    loaded: int = 0
    refused: int = 0
    failed: int = 0
    largest_growth: int = 0
    """Bytes."""
    seconds: float = 0.0

    @property
    def inputs(self) -> int:
        return self.loaded + self.refused + self.failed


class Failures:
    """Files that made a loader fail, a few of each kind."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kinds: dict[tuple[str, str], int] = {}

    def add(self, loader: Loader, seed: int, data: bytes, what: str) -> None:
        kind = (loader.name, what.strip().splitlines()[-1][:80])
        self._kinds[kind] = self._kinds.get(kind, 0) + 1
        if self._kinds[kind] > KEPT_OF_A_KIND:
            return
        folder = self._folder / loader.name
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{seed}").write_bytes(data)
        (folder / f"{seed}.why").write_text(what, errors="backslashreplace")


def fuzz(loader: Loader, counts: Counts, seconds: float, failures: Failures, most: int) -> None:
    """Adds to `counts` what comes of at most `most` files in so many seconds."""
    until = time.monotonic() + seconds
    last = counts.next_seed + most
    while counts.next_seed < last and time.monotonic() < until:
        _batch(loader, counts, until, failures, last)


def _batch(loader: Loader, counts: Counts, until: float, failures: Failures, last: int) -> None:
    """Runs a worker until it is done or dies, of which the file is to blame that it was at."""
    started = time.monotonic()
    with tempfile.TemporaryDirectory(dir=_fast_folder()) as name:
        folder = Path(name)
        # What the worker counts stays readable when it dies: next seed, outcomes, growth, ended in order.
        shared = multiprocessing.sharedctypes.RawArray("q", [counts.next_seed, 0, 0, 0, 0, 0])
        receive, send = _CONTEXT.Pipe(duplex=False)
        worker = _CONTEXT.Process(target=_work, args=(loader, folder, last, until, shared, send))
        worker.start()
        send.close()
        at = counts.next_seed
        while True:
            try:
                if receive.poll(PATIENCE):
                    failures.add(loader, *receive.recv())
                elif shared[0] == at:
                    worker.kill()
                    break
            except EOFError:
                break
            at = shared[0]
        worker.join()
        counts.seconds += time.monotonic() - started
        counts.next_seed, loaded, refused, failed, grown, is_over = shared
        counts.loaded += loaded
        counts.refused += refused
        counts.failed += failed
        counts.largest_growth = max(counts.largest_growth, grown)
        if not is_over:
            counts.failed += 1
            why = "hung" if worker.exitcode == -signal.SIGKILL else f"ended with exit code {worker.exitcode}"
            failures.add(loader, counts.next_seed, (folder / loader.file).read_bytes(), f"the process {why}")
            counts.next_seed += 1


def _work(loader: Loader, folder: Path, last: int, until: float, shared: Any, send: Any) -> None:
    limit_memory()
    # Decoders write about damage to standard error by themselves.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    corpus = loader.corpus()
    trial = Trial(loader, folder)
    # What is made once, compiled say, is no part of the memory of a file.
    for data in corpus:
        trial(data)
    while shared[0] < last and time.monotonic() < until:
        data = damaged_file(loader, corpus, shared[0])
        result = trial(data)
        if result.outcome == "failed":
            send.send((shared[0], data, result.what))
        shared[1 + OUTCOMES.index(result.outcome)] += 1
        shared[4] = max(shared[4], result.grown)
        shared[0] += 1
    shared[5] = 1
    send.close()
    os._exit(0)


def _fast_folder() -> str | None:
    """A folder in memory, where the system has one."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def minimised(loader: Loader, data: bytes) -> bytes:
    """A smaller file that fails in the same way: parts are left out as long as it does."""
    with tempfile.TemporaryDirectory(dir=_fast_folder()) as name:
        trial = Trial(loader, Path(name))

        def failing(candidate: bytes) -> str | None:
            result = trial(candidate)
            return result.what.strip().splitlines()[-1][:60] if result.outcome == "failed" else None

        trial(data)
        kind = failing(data)
        if kind is None:
            raise SystemExit("the file does not fail")
        return _shrunk(data, lambda candidate: failing(candidate) == kind)


def _shrunk(data: bytes, still: Callable[[bytes], bool]) -> bytes:
    size = max(len(data) // 2, 1)
    while size >= 1:
        at = 0
        while at < len(data):
            candidate = data[:at] + data[at + size :]
            if still(candidate):
                data = candidate
            else:
                at += size
        size //= 2
    return data


def read_counts(path: Path) -> dict[str, Counts]:
    """Of an earlier run; empty where there is none."""
    known = {field.name for field in fields(Counts)}
    entries = read(path).get("loaders", {})
    return {
        name: Counts(**{key: value for key, value in entry.items() if key in known})
        for name, entry in entries.items()
    }


def report(table: dict[str, Counts]) -> dict[str, Any]:
    """What the JSON file holds of the loaders."""
    return {
        "inputs": sum(counts.inputs for counts in table.values()),
        "failed": sum(counts.failed for counts in table.values()),
        "limits": {"times_the_file": TIMES_THE_FILE, "spare_bytes": SPARE_BYTES, "seconds": SECONDS},
        "loaders": {
            name: {"inputs": counts.inputs, **asdict(counts), "seconds": round(counts.seconds, 1)}
            for name, counts in sorted(table.items())
        },
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0, help="for all loaders together")
    parser.add_argument("--inputs", type=int, default=10**9, help="for each loader, at most")
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--loader", action="append", choices=sorted(BY_NAME))
    parser.add_argument("--failures", type=Path, default=Path("out/fuzz"))
    parser.add_argument("--json", type=Path)
    parser.add_argument("--more", action="store_true", help="go on where the counts in the JSON file end")
    parser.add_argument("--minimise", nargs=2, metavar=("LOADER", "FILE"))
    arguments = parser.parse_args()
    if arguments.minimise:
        name, path = arguments.minimise
        sys.stdout.buffer.write(minimised(BY_NAME[name], Path(path).read_bytes()))
        return 0
    chosen = [loader for loader in LOADERS if arguments.loader is None or loader.name in arguments.loader]
    table = read_counts(arguments.json) if arguments.json and arguments.more else {}
    failures = Failures(arguments.failures)
    before = sum(counts.failed for counts in table.values())
    for loader in chosen:
        counts = table.setdefault(loader.name, Counts(next_seed=arguments.start))
        fuzz(loader, counts, arguments.seconds / len(chosen), failures, arguments.inputs)
        print(
            f"{loader.name:20} {counts.inputs:9,} inputs: "
            + ", ".join(f"{getattr(counts, outcome):,} {outcome}" for outcome in OUTCOMES)
            + f"; grew by {counts.largest_growth / 2**20:.1f} MiB at most",
            flush=True,
        )
        if arguments.json:
            add_to(arguments.json, report(table))
    return int(sum(counts.failed for counts in table.values()) > before)


if __name__ == "__main__":
    sys.exit(main())
