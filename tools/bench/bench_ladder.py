"""The accuracy ladder and the bill of real scenes, for docs/accuracy.md.

    python tools/bench/bench_ladder.py [SCENE.ply ...] [--size WxH] [--seconds S] [--renderers A,B]
                                            [--rounds N] [--name NAME]

Runs `splatview ladder` and `splatview bill` as a user would; writes ladder_NAME.json, ladder_NAME.png,
bill_NAME.json and bill_playbot.png. On a quiet machine: `make tables` then brings the page up to date.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from benchmark_docs import bill_table, ladder_table

from splatview.measure.machine import FOLDER, write_results

ROOT = Path(__file__).parents[2]
SHOWN = "playbot"
"""Whose heat map is on the page."""

SCENES = {"playbot": "playbot_lod0.ply", "skull": "skull.ply"}


def splatview(*arguments: object) -> dict[str, Any]:
    """The JSON that a command prints."""
    command = [str(Path(sys.executable).with_name("splatview")), *map(str, arguments), "--json"]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--rounds", type=int, help="pairs of each shortcut, however long they take")
    parser.add_argument("--renderers")
    parser.add_argument("--name", help="of the files, in place of the scene's; then there is no bill")
    args = parser.parse_args()
    data = ROOT.parent / "shared" / "data" / "scenes"
    given = {path.stem.partition("_")[0]: path for path in args.scenes}
    for name, path in (given or {name: data / file for name, file in SCENES.items()}).items():
        print(name, flush=True)
        folder = ROOT / FOLDER
        name = args.name or name
        extra = ["--renderers", args.renderers] if args.renderers else []
        ladder = splatview(
            "ladder",
            path,
            "--size",
            args.size,
            *(("--seconds", args.seconds) if args.rounds is None else ("--rounds", args.rounds)),
            "--plot",
            folder / f"ladder_{name}.png",
            *extra,
        )
        write_results(folder / f"ladder_{name}.json", {**ladder, "table": ladder_table(ladder)})
        if args.name:
            continue
        shown = ["--heatmap", folder / f"bill_{name}.png"] if name == SHOWN else []
        bill = splatview("bill", path, "--size", args.size, *shown)
        rows, sums = [tuple(row) for row in bill["rows"]], bill["sums"]
        write_results(folder / f"bill_{name}.json", {**bill, "table": bill_table(path.name, rows, sums)})


if __name__ == "__main__":
    main()
