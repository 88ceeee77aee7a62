"""Runs entries in parallel and records what came out, as text where it is short and as hashes where not."""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
import struct
import subprocess
import threading
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from .entries import IN, Entry

Recorded = dict[str, Any]
"""What is recorded of one entry: "command" (text), "code" (list), "stdout" and "stderr" (text), "files" (path
-> one line that ends with a hash)."""

LIMIT_SECONDS = 300
"""An entry that runs longer is ended, and recorded so."""

CLOCK = "<by the clock>"

TIMED_KEYS = {
    "ms": "milliseconds of a frame",
    "ms_quartiles": "their spread",
    "ratio": "milliseconds by the baseline's",
    "noise": "the spread of ratios",
    "clear": "whether a ratio is beyond the noise",
    "pareto": "decided by milliseconds",
    "pairs": "how often there was time to measure",
    "rounds": "how often there was time to measure",
    "frame_ms": "milliseconds of a frame",
    "saved_ms": "milliseconds",
    "noise_ms": "milliseconds",
    "measured": "a sentence with milliseconds",
    "seconds": "seconds since a run began",
    "stages": "milliseconds by stage (the stages' names are recorded)",
}
"""Keys of JSON whose values depend on timing, and why. The keys themselves are recorded."""

TIMED_TEXT = (
    (r"\d+:\d\d:\d\d", "elapsed time of a progress bar"),
    (r"\d+(\.\d+)? (ms|s|min)\b( left)?", "seconds of a training run, milliseconds of a compiler"),
)
"""In what `train` and `doctor` print."""

DROPPED_LINES = (
    (r"\d+% done", "printed every two seconds of an edit"),
    (r"compiling took .*|splatview: compiling .*", "only where kernels are not in the cache"),
)

LIBRARIES = "versions of the installed libraries (`doctor`): facts about the environment, not the program"

LEFT_OUT = {
    **{f'JSON key "{key}"': why for key, why in TIMED_KEYS.items()},
    **{f"text /{pattern}/": why for pattern, why in TIMED_TEXT},
    **{f"line /{pattern}/": why for pattern, why in DROPPED_LINES},
    'JSON key "libraries"': LIBRARIES,
    "stderr of ladder and info --measure": "a progress bar with the elapsed time",
    "cache names": "16 digits that change with the sources; files are recorded without them",
}
"""What is not recorded as it is, and the reason."""


def record(checkout: Path, entries: Sequence[Entry], first: Sequence[Entry], folder: Path, jobs: int):
    """Key -> `Recorded`: `first` one after the other, then `entries`, `jobs` at a time, in `folder`."""
    runner = Runner(checkout, folder, len(first) + len(entries))
    results = {}
    for one in first:
        results[one.key] = runner.run(one)
    link_demo(folder)
    with ThreadPoolExecutor(jobs) as pool:
        for one, result in zip(entries, pool.map(runner.run, entries), strict=True):
            results[one.key] = result
    return {key: results[key] for key in sorted(results) if not key.startswith("warm-up/")}


def link_demo(folder: Path) -> None:
    """The bundled demo as an input file: the program keeps it in its cache."""
    for path in (folder / "cache").glob("demo-*.ply"):
        (folder / "in" / "demo.ply").symlink_to(path)


class Runner:
    """Runs entries with one checkout, each in a folder of its own; prints a line for each."""

    def __init__(self, checkout: Path, folder: Path, total: int) -> None:
        self.program = checkout / ".venv" / "bin" / "splatview"
        self.folder = folder
        self.total, self.done = total, 0
        self.begun = time.perf_counter()
        self.names = ((str(folder.resolve()), "WORK"), (str(checkout.resolve()), "CHECKOUT"))
        self._lock = threading.Lock()

    def run(self, one: Entry) -> Recorded:
        with self._lock:
            self.done += 1
            number = self.done
        begun = time.perf_counter()
        cwd = self.folder / "runs" / f"{number:04}"
        cwd.mkdir(parents=True)
        for name in one.copies:
            shutil.copy(self.folder / "in" / name, cwd / name)
        codes, outs, errs = [], [], []
        for arguments in one.commands:
            code, out, err = self.launch(arguments, cwd, one.environment)
            codes.append(code)
            outs.append(self.plain(out, cwd, one))
            errs.append("" if one.ignore_stderr else self.plain(err, cwd, one))
        recorded = {
            "command": "; ".join(" ".join(("splatview", *arguments)) for arguments in one.commands),
            **({"environment": one.environment} if one.environment else {}),
            "code": codes,
            "stdout": "\n".join(outs),
            "stderr": "\n".join(errs),
            "files": files_in(cwd, one),
        }
        shutil.rmtree(cwd)
        seconds, elapsed = time.perf_counter() - begun, time.perf_counter() - self.begun
        failed = "" if not any(codes) or one.key.startswith("mistake/") else f"  exit code {codes}"
        print(f"{elapsed:5.0f} s  {number}/{self.total}  {one.key}  {seconds:.1f} s{failed}", flush=True)
        return recorded

    def launch(
        self, arguments: Sequence[str], cwd: Path, extra: dict[str, str]
    ) -> tuple[int | str, str, str]:
        """Exit code (or why there is none), standard output, standard error."""
        hidden = ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH", "MESA_GL_VERSION_OVERRIDE")
        environment = {name: value for name, value in os.environ.items() if name not in hidden}
        environment |= {
            "SPLATVIEW_CACHE_DIR": str(self.folder / "cache"),
            "SPLATVIEW_CONFIG_DIR": str(self.folder / "config"),
            "COLUMNS": "100",
            "NO_COLOR": "1",
            "TERM": "dumb",
            "PYTHONIOENCODING": "utf8",
            **extra,
        }
        try:
            done = subprocess.run(
                [self.program, *arguments],
                cwd=cwd,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=LIMIT_SECONDS,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return f"ended after {LIMIT_SECONDS} s", "", ""
        return done.returncode, done.stdout.decode(errors="replace"), done.stderr.decode(errors="replace")

    def plain(self, text: str, cwd: Path, one: Entry) -> str:
        """What was printed, without folders and without what depends on timing."""
        for path, name in ((f"{cwd.resolve()}/", ""), *self.names):
            text = text.replace(path, name)
        text = "\n".join(without_traceback(text.splitlines()))
        if text.startswith(("{", "[")):
            try:
                return json.dumps(untimed(json.loads(text)), indent=1, ensure_ascii=False)
            except ValueError:
                pass
        if one.says_times:
            text = timeless(text)
        return text


def without_traceback(lines: Sequence[str]) -> list[str]:
    """`lines` without those of DROPPED_LINES. Of a traceback only the last line stays: files move."""
    kept = [line for line in lines if not any(re.fullmatch(pattern, line) for pattern, _ in DROPPED_LINES)]
    start = next((i for i, line in enumerate(kept) if line.startswith("Traceback ")), None)
    return kept if start is None else [*kept[:start], "Traceback", kept[-1]]


def timeless(text: str) -> str:
    for pattern, _ in TIMED_TEXT:
        text = re.sub(pattern, CLOCK, text)
    # Columns around a time are as wide as it is long.
    return re.sub(rf" *{CLOCK}", f" {CLOCK}", text)


def untimed(value: Any) -> Any:
    """JSON with CLOCK in place of all that depends on timing."""
    if isinstance(value, list):
        return [untimed(part) for part in value]
    if isinstance(value, str):
        return timeless(value) if re.search(r"\d ms\b", value) else value
    if not isinstance(value, dict):
        return value
    plain = {}
    for key, part in value.items():
        if key == "libraries":
            plain[key] = LIBRARIES
        elif key in TIMED_KEYS:
            plain[key] = clocked(part)
        else:
            plain[key] = untimed(part)
    return plain


def clocked(value: Any) -> Any:
    """CLOCK in place of a value; of objects the keys stay."""
    return {key: clocked(part) for key, part in value.items()} if isinstance(value, dict) else CLOCK


def files_in(cwd: Path, one: Entry) -> dict[str, str]:
    """Path -> description of each file that an entry has written."""
    found = {}
    for pattern in one.collect:
        for path in sorted(cwd.glob(pattern)):
            name = re.sub(r"-[0-9a-f]{16}\b", "", os.path.relpath(path, cwd))
            if path.is_file() and name not in one.copies:
                found[name] = described(path)
    return found


def described(path: Path) -> str:
    """One line: what the file holds, and the sha256 of exactly that."""
    try:
        match path.suffix:
            case ".npy":
                return describe_array(np.load(path))
            case ".png":
                with Image.open(path) as image:
                    return f"{image.mode} {describe_array(np.asarray(image))}"
            case ".jsonl":
                lines = [json.dumps(untimed(json.loads(line))) for line in path.read_text().splitlines()]
                last = {
                    key: lines and json.loads(lines[-1]).get(key) for key in ("iteration", "loss", "psnr")
                }
                return f"{len(lines)} lines, the last {last}, {digest(*map(str.encode, lines))}"
            case ".safetensors":
                return describe_tensors(path.read_bytes())
            case _:
                data = path.read_bytes()
                return f"{len(data)} bytes, {digest(data)}"
    except (OSError, ValueError, KeyError, EOFError, struct.error) as error:
        return f"cannot be read: {type(error).__name__}"


def describe_array(array: np.ndarray) -> str:
    shape, kind = array.shape, array.dtype.str
    value = digest(repr((shape, kind)).encode(), np.ascontiguousarray(array).tobytes())
    with np.errstate(all="ignore"):
        mean, largest = array.mean(dtype=np.float64), array.max(initial=0)
    return f"{shape} {kind}, mean {mean:.6g}, largest {largest:.6g}, {value}"


def describe_tensors(data: bytes) -> str:
    """Of a checkpoint: its tensors as they are, and its description without seconds."""
    (size,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + size])
    metadata = {key: maybe_json(value) for key, value in header.pop("__metadata__", {}).items()}
    text = json.dumps([untimed(metadata), header], sort_keys=True)
    return f"{len(header)} tensors, {digest(text.encode(), data[8 + size :])}"


def maybe_json(text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        return text


def digest(*parts: bytes) -> str:
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return f"sha256 {total.hexdigest()}"


def link_shared(folder: Path, scenes: Path | None, captures: Path | None, files: dict[str, str]) -> None:
    """Shared data as input files: `files` is name -> path in `scenes`."""
    if scenes is not None:
        (folder / "scenes").symlink_to(scenes.resolve())
        for name, file in files.items():
            if (scenes / file).exists():
                (folder / f"{name}.ply").symlink_to((scenes / file).resolve())
    if captures is not None:
        (folder / "captures").symlink_to(captures.resolve())


__all__ = ["IN", "LEFT_OUT", "link_shared", "record"]
