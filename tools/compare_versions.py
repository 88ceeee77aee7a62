"""Records all that the program puts out, and compares the recordings of two checkouts.

    python tools/compare_versions.py record CHECKOUT -o BEFORE.json [--scenes FOLDER] [--captures FOLDER]
    python tools/compare_versions.py compare BEFORE.json AFTER.json

It runs `CHECKOUT/.venv/bin/splatview` and imports nothing of the program, so the same script works on
checkouts whose files and classes have other names. Recorded are exact values: arrays of pictures, bytes of
scenes, tensors of checkpoints by their sha256, and whatever is printed, as text. What depends on timing is
left out and listed, with the reasons, under "left_out" in the recording (`versions.recorder.LEFT_OUT`).

Both recordings must come from the same machine, OpenGL driver, and versions of numpy, numba and torch.
`compare` prints what differs and ends with exit code 1 if anything does. Texts that were changed on purpose
are left out by `--ignore 'help/* stdout'`: patterns of "key field", where field is code, stdout, stderr or
the name of a file.
"""

from __future__ import annotations

import argparse
import difflib
import fnmatch
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

SHOWN_LINES = 8
"""Of a text that differs."""


class Difference(NamedTuple):
    """One field of one entry that is not the same."""

    key: str
    field: str
    before: Any
    """None where it is missing."""
    after: Any


def differences(
    before: dict[str, Any], after: dict[str, Any], ignore: Sequence[str] = ()
) -> list[Difference]:
    """Of two recordings' entries: key -> {"code", "stdout", "stderr", "files": {name: hash}}."""
    found = []
    for key in sorted(before.keys() | after.keys()):
        if key not in before or key not in after:
            change = ("recorded", None) if key in before else (None, "recorded")
            found.append(Difference(key, "entry", *change))
            continue
        one, other = fields(before[key]), fields(after[key])
        names = sorted(one.keys() | other.keys())
        found += [Difference(key, n, one.get(n), other.get(n)) for n in names if one.get(n) != other.get(n)]
    return [d for d in found if not any(fnmatch.fnmatchcase(f"{d.key} {d.field}", p) for p in ignore)]


def fields(entry: dict[str, Any]) -> dict[str, Any]:
    """All that is compared of an entry; the command line is not, as it is the script's own."""
    return {name: entry.get(name) for name in ("code", "stdout", "stderr")} | entry.get("files", {})


def as_lines(difference: Difference) -> Iterator[str]:
    """The difference for people."""
    key, field, before, after = difference
    yield f"{key}  {field}"
    if field in ("stdout", "stderr") and isinstance(before, str) and isinstance(after, str):
        changed = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
        lines = [line for line in changed if not line.startswith(("---", "+++", "@@"))]
        yield from (f"    {line}" for line in lines[:SHOWN_LINES])
        if len(lines) > SHOWN_LINES:
            yield f"    ... and {len(lines) - SHOWN_LINES} lines more"
        return
    yield f"    - {'missing' if before is None else before}"
    yield f"    + {'missing' if after is None else after}"


def run_compare(args: argparse.Namespace) -> int:
    try:
        before, after = (json.loads(path.read_text(encoding="utf8")) for path in (args.before, args.after))
    except (OSError, ValueError) as error:
        print(f"no recording can be read: {error}", file=sys.stderr)
        return 2
    found = differences(before["entries"], after["entries"], args.ignore)
    for difference in found:
        print("\n".join(as_lines(difference)))
    for what in ("machine", "python"):
        if before["about"].get(what) != after["about"].get(what):
            print(f"note: recorded with another {what}: {before['about'][what]}, {after['about'][what]}")
    checked = sum(len(fields(entry)) for entry in before["entries"].values())
    groups: dict[str, int] = {}
    for difference in found:
        group = difference.key.split("/")[0]
        groups[group] = groups.get(group, 0) + 1
    by_group = "".join(f"; {group}: {count}" for group, count in groups.items())
    print(f"{len(before['entries'])} entries, {checked} outputs: {len(found)} differ{by_group}")
    return int(bool(found))


def run_record(args: argparse.Namespace) -> int:
    from versions.entries import SHARED_SCENES, all_entries, warm_up
    from versions.inputs import make_inputs
    from versions.recorder import LEFT_OUT, link_shared, record

    checkout = args.checkout.resolve()
    if not (checkout / ".venv" / "bin" / "splatview").exists():
        print(f"{checkout}: has no .venv/bin/splatview", file=sys.stderr)
        return 2
    if not args.output.resolve().parent.is_dir():
        print(f"{args.output}: its folder does not exist", file=sys.stderr)
        return 2
    scenes, captures = (
        found_folder(args.scenes, checkout, "scenes"),
        found_folder(args.captures, checkout, "captures"),
    )
    entries = all_entries(scenes, captures)
    if args.only:
        entries = [one for one in entries if any(fnmatch.fnmatchcase(one.key, p) for p in args.only)]
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory(prefix="versions-") as name:
        folder = Path(name)
        (folder / "in").mkdir()
        make_inputs(folder / "in", captures)
        link_shared(folder / "in", scenes, captures, SHARED_SCENES)
        results = record(checkout, entries, warm_up(), folder, args.jobs)
    seconds = time.perf_counter() - begun
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    python = subprocess.run(
        [checkout / ".venv" / "bin" / "python", "--version"], capture_output=True, text=True, check=True
    )
    about = {
        "commit": commit(checkout),
        "python": python.stdout.strip(),
        "machine": " ".join(os.uname()),
        "shared_data": {"scenes": scenes is not None, "captures": captures is not None},
        "seconds": round(seconds, 1),
        "processor_seconds": round(used.ru_utime + used.ru_stime, 1),
    }
    text = json.dumps(
        {"about": about, "left_out": LEFT_OUT, "entries": results}, indent=1, ensure_ascii=False
    )
    args.output.write_text(text + "\n", encoding="utf8")
    processor = f"{about['processor_seconds']:.0f} s of processor time"
    print(f"{args.output}: {len(results)} entries in {seconds:.0f} s, {processor}")
    return 0


def found_folder(given: Path | None, checkout: Path, name: str) -> Path | None:
    """The folder of shared data: as given, or beside the checkout; None, said so, where there is none."""
    folder = given or checkout.parent / "shared" / "data" / name
    if folder.is_dir():
        return folder
    print(f"{folder}: no such folder; recording without shared {name}", file=sys.stderr)
    return None


def commit(checkout: Path) -> str:
    done = subprocess.run(
        ["git", "-C", checkout, "rev-parse", "HEAD"], capture_output=True, text=True, check=False
    )
    return done.stdout.strip()


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False
    )
    commands = parser.add_subparsers(required=True)
    recording = commands.add_parser("record", help="run everything with one checkout")
    recording.add_argument("checkout", type=Path)
    recording.add_argument("-o", "--output", type=Path, required=True, metavar="OUT.json")
    recording.add_argument("--scenes", type=Path, help="default: ../shared/data/scenes of the checkout")
    recording.add_argument("--captures", type=Path, help="default: ../shared/data/captures of the checkout")
    recording.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="at a time (default: cores)")
    recording.add_argument("--only", action="append", metavar="PATTERN", help="only keys like this: 'edit/*'")
    recording.set_defaults(run=run_record)
    comparing = commands.add_parser("compare", help="what differs between two recordings")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument(
        "--ignore", action="append", default=[], metavar="PATTERN", help="'key field' to leave out: 'help* *'"
    )
    comparing.set_defaults(run=run_compare)
    args = parser.parse_args(argv)
    return args.run(args)


if __name__ == "__main__":
    sys.exit(main())
