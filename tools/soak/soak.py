"""Uses the program at random for as long as one likes, in real windows under Xvfb, and looks for harm.

    python tools/soak/soak.py [--minutes 60] [--seed S] [--renderers cpu,quads,tiles,old] [-o REPORT.json]
    python tools/soak/soak.py --replay LOG [--seed S]

Each renderer gets its share of the time, in a window and a process of its own that trains the whole while;
within it the renderer is changed as well. What the user does (`actions`) is drawn by the seed: action n
of a part is the same in every run. What is looked at on the way is in `checks`: memory, GL errors, threads,
pictures against the CPU's of the baked scene, exports against the document, undo to the byte, and at the
end the files that training leaves.

Every part writes a log, one JSON object a line, each action before it is done. `--replay` does what a log
says and nothing else: lines may be deleted from it, to find those that do the harm. After a failure the
folder of logs also holds the picture that was wrong, the one that was right, and the traceback.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from screen import screen

from splatview.measure.machine import FOLDER, write_results

RENDERERS = ("cpu", "quads", "tiles", "old")
"""`old` is quads on OpenGL 3.3."""

DRIVES = Path(__file__).parents[2] / "tests" / "viewer"
"""Where the hands of the window's tests are."""

GRACE_SECONDS = 480.0
"""How long a part may take beyond its time, to start and to end, before it counts as hung."""

OLD_GL = {"MESA_GL_VERSION_OVERRIDE": "3.3", "MESA_GLSL_VERSION_OVERRIDE": "330"}


class Result(dict[str, Any]):
    """What a part has found, as `session.Session.result` writes it; `problems` and `renderer` always."""


def run_part(
    renderer: str, seconds: float, seed: int, folder: Path, *, replay: Path | None = None, size: str = "full"
) -> Result:
    """One window; what came of it. `size` "small" makes the scenes and the capture tiny."""
    folder.mkdir(parents=True, exist_ok=True)
    log, result = folder / "log.jsonl", folder / "result.json"
    result.unlink(missing_ok=True)
    options = {
        "renderer": "quads" if renderer == "old" else renderer,
        "seconds": seconds,
        "seed": seed,
        "log": str(log),
        "result": str(result),
        "replay": None if replay is None else str(replay.resolve()),
        "size": size,
    }
    # Not on a GPU, unless who runs it says so by LIBGL_ALWAYS_SOFTWARE=0.
    environment = (
        {"LIBGL_ALWAYS_SOFTWARE": "1"} | os.environ | {"SPLATVIEW_CONFIG_DIR": str(folder / "config")}
    )
    environment.update(OLD_GL if renderer == "old" else {})
    environment["PYTHONPATH"] = os.pathsep.join([str(DRIVES), *filter(None, [os.environ.get("PYTHONPATH")])])
    environment.pop("WAYLAND_DISPLAY", None)
    command = [sys.executable, "-X", "faulthandler", str(Path(__file__).with_name("session.py"))]
    with open(folder / "output.txt", "w") as output:
        try:
            code = subprocess.run(
                [*command, json.dumps(options)],
                env=environment,
                cwd=folder,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=seconds + GRACE_SECONDS,
                check=False,
            ).returncode
        except subprocess.TimeoutExpired:
            code = None
    found = Result(json.loads(result.read_text()) if result.exists() else {"problems": []})
    found["renderer"] = renderer
    if code is None:
        found["problems"].append(f"hung after {last_action(log)}; see {folder}")
    elif code != 0 or not result.exists():
        found["problems"].append(f"ended with {code} after {last_action(log)}; see {folder}")
    said = (folder / "output.txt").read_text()
    if "Traceback" in said and not found["problems"]:
        found["problems"].append(f"a traceback in {folder / 'output.txt'}")
    return found


def last_action(log: Path) -> str:
    lines = log.read_text().splitlines() if log.exists() else []
    return next((line for line in reversed(lines) if '"action"' in line), "nothing")


def report(parts: list[Result], seed: int, minutes: float) -> dict[str, Any]:
    columns = ["renderer", "minutes", "actions", "pictures compared", "largest share of pixels off"]
    columns += ["exports", "undos", "memory, MiB", "its growth, MiB", "allowed", "problems"]
    rows = []
    for part in parts:
        if "actions" not in part:
            rows.append([part["renderer"], *[""] * 9, str(len(part["problems"]))])
            continue
        memory = part["memory"]
        rows.append(
            [
                part["renderer"],
                f"{part['seconds'] / 60:.1f}",
                f"{part['actions']:,}",
                f"{part['pictures']:,}",
                f"{part['largest_share_off']:.1e}",
                f"{part['exports']:,}",
                f"{part['undos']:,}",
                f"{memory['end_mib']:.0f}",
                "too short" if memory["growth_mib"] is None else f"{memory['growth_mib']:.0f}",
                f"{memory['allowed_mib']:.0f}",
                str(len(part["problems"])),
            ]
        )
    note = (
        f"{minutes:g} minutes at random, seed {seed}: training, flying, editing, undoing, exporting, other"
        " scenes, sizes, modes, renderers. Growth is of the median between the second and the last third of a"
        " part, what scene and history hold left out."
    )
    return {
        "seed": seed,
        "minutes": minutes,
        "parts": parts,
        "table": {"columns": columns, "rows": rows, "note": note},
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=int(time.time()) % 100_000)
    parser.add_argument("--renderers", default=",".join(RENDERERS))
    parser.add_argument("--replay", type=Path)
    parser.add_argument("--logs", type=Path, default=Path("soak"))
    parser.add_argument("--size", choices=("small", "full"), default="full")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "soak.json")
    options = parser.parse_args()
    # A request to end ends the part under way and its display too.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    names = options.renderers.split(",")
    print(f"seed {options.seed}, logs in {options.logs}")
    parts = []
    with screen() as made:
        os.environ["DISPLAY"] = made.display
        for name in names:
            part = run_part(
                name,
                60 * options.minutes / len(names),
                options.seed,
                (options.logs / name).resolve(),
                replay=options.replay,
                size=options.size,
            )
            parts.append(part)
            print(name, {key: value for key, value in part.items() if not isinstance(value, (list, dict))})
            for problem in part["problems"]:
                print(f"  {problem}")
    if options.replay is None:
        write_results(options.output, report(parts, options.seed, options.minutes))
    if any(part["problems"] for part in parts):
        raise SystemExit(1)


if __name__ == "__main__":
    main()
