"""The accuracy ladder and the bill of real scenes, for docs/accuracy.md; training's ladder of a capture, for
docs/training.md.

    python tools/bench/bench_ladder.py [SCENE.ply ...] [--size WxH] [--seconds S] [--renderers A,B]
                                            [--rounds N] [--name NAME]
    python tools/bench/bench_ladder.py --train CAPTURE [--minutes M] [--seeds N] [--downscale K]
                                            [--knobs A,B] [--name NAME]

Runs `splatview ladder` and `splatview bill` as a user would; writes ladder_NAME.json, ladder_NAME.png,
bill_NAME.json and bill_playbot.png, or training_ladder_NAME.json. On a quiet machine: `make tables` then
brings the page up to date.
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from splatview.measure.machine import FOLDER, write_results

ROOT = Path(__file__).parents[2]
SHOWN = "playbot"
"""Whose heat map is on the page."""

SCENES = {"playbot": "playbot_lod0.ply", "skull": "skull.ply"}

LADDER_COLUMNS = (
    "shortcut",
    "ms a frame",
    "time",
    "PSNR, dB",
    "SSIM",
    "largest error",
    "popping",
    "MiB",
    "front",
)


def ladder_table(results: Mapping[str, Any]) -> dict[str, Any]:
    """The `table` of a ladder's JSON (`splatview ladder --json`), the noise floor beside each ratio."""
    width, height = results["size"]
    base = results["baseline"]["renderer"]
    rows = []
    last = None
    for rung in results["rungs"]:
        if rung["renderer"] != last:
            last = rung["renderer"]
            rows.append([f"**drawn by `{last}`**", *[""] * (len(LADDER_COLUMNS) - 1)])
        rows.append(_row(rung, rung["noise"] or results["noise"]))
    left_out = results["left_out"]
    return {
        "columns": list(LADDER_COLUMNS),
        "rows": rows,
        "note": f"{results['scene']}, {results['splats']:,} splats at {width}x{height}, "
        f"{results['views']} views, up to {results['rounds']} pairs a row. Time: of `{base}` with its "
        "defaults, drawn in turn with it, and the noise floor for so many pairs, never below that of "
        f'`{base}` against itself; "same" where no difference may be claimed. Errors: against a float64 '
        "truth that agrees with the reference to "
        f"{results['truth']['largest_difference_from_reference']:.0e} in sampled blocks. "
        "Popping: the largest change of a pixel when the eye turns a little. "
        "Front: faster, by more than the noise, than all on the front that are nearer to the truth; nothing "
        "else in the table is both faster and nearer."
        + (f" GL is {opengl['renderer']}." if (opengl := results.get("opengl")) else "")
        + (f" Left out for want of time: {len(left_out)} rows." if left_out else ""),
    }


def _row(rung: Mapping[str, Any], noise: float | None) -> list[str]:
    low, high = (part if part is not None else math.nan for part in rung["ms_quartiles"])
    name = "defaults" if rung["knob"] == "renderer" else f"`--{rung['knob']} {rung['value']}`"
    floor = "" if noise is None else f" ±{noise:.0%}"
    time = f"{rung['ratio']:.2f}{floor}" if rung["clear"] or rung["ratio"] == 1 else f"same{floor}"
    return [
        name,
        f"{rung['ms']:.1f} ±{(high - low) / 2:.1f}",
        time,
        "exact" if rung["psnr"] is None else f"{rung['psnr']:.1f}",
        "-" if rung["ssim"] is None else f"{rung['ssim']:.4f}",
        f"{rung['max_error']:.2g}",
        f"{rung['popping']:.2g}",
        f"{rung['memory'] / 2**20:.0f}",
        "yes" if rung["pareto"] else "",
    ]


def bill_table(scene: str, rows: list[tuple[str, str, str]], sums: list[str]) -> dict[str, Any]:
    """The `table` of a bill, by `bill.rows` and `bill.sums`."""
    return {
        "columns": [scene, "splats", "a NeRF"],
        "rows": [list(row) for row in rows],
        "note": " ".join(f"{line}." if not line.endswith(".") else line for line in sums),
    }


def training_table(results: Mapping[str, Any]) -> dict[str, Any]:
    """The `table` of a training ladder's JSON (`splatview ladder --train --json`)."""
    seeds, rows = results["seeds"], []
    for rung in results["rungs"]:
        is_baseline = rung is results["rungs"][0]
        gain, width, equal = rung["gain"], rung["gain_half_width"], rung["seconds_to_equal"]
        sure = width is not None and abs(gain) > width
        of_seeds = [
            run["psnr"][-1] - base["psnr"][-1]
            for run, base in zip(rung["runs"], results["rungs"][0]["runs"], strict=True)
        ]
        said = f"{gain:+.2f}" + (f" ({min(of_seeds):+.2f} to {max(of_seeds):+.2f})" if seeds > 1 else "")
        steps, splats = (sum(run[name] for run in rung["runs"]) / seeds for name in ("steps", "gaussians"))
        rows.append(
            [
                "the recipe" if is_baseline else f"{rung['knob']}: {rung['value']}",
                f"{rung['psnr']:.2f}",
                "" if is_baseline else said,
                "" if is_baseline else ("yes" if sure else ""),
                "" if is_baseline else ("never" if equal is None else f"{equal:.0f}"),
                f"{steps:,.0f}",
                f"{splats:,.0f}",
            ]
        )
    without = [text.partition(" is left out")[0] for text in results["without_effect"]]
    return {
        "columns": ["instead", "PSNR, dB", "gain, dB", "sure", "s to equal", "steps", "splats"],
        "rows": rows,
        "note": f"{results['capture']}: {results['minutes'] * 60:g} seconds of the clock a run, "
        f"{seeds} seeds, held-out photos"
        + (", after a fit of their exposures" if results["exposures_fitted"] else "")
        + ". Gain: over the recipe, the mean and the least and most over seeds; sure, where its 95 % "
        "interval by Student's t has no 0. Seconds to equal: until the PSNR that the recipe ends with; "
        "never, where a seed did not come there."
        + (f" Without effect on this capture: {', '.join(without)}." if without else ""),
    }


def splatview(*arguments: object) -> dict[str, Any]:
    """The JSON that a command prints."""
    command = [str(Path(sys.executable).with_name("splatview")), *map(str, arguments), "--json"]
    return json.loads(subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", type=Path)
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--seconds", type=float, default=300.0)
    parser.add_argument("--rounds", type=int, help="pairs of each shortcut, however long they take")
    parser.add_argument("--renderers")
    parser.add_argument("--name", help="of the files, in place of the scene's; then there is no bill")
    parser.add_argument("--train", type=Path, metavar="CAPTURE")
    parser.add_argument("--minutes", type=float, default=0.5)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--downscale", default="auto")
    parser.add_argument("--knobs")
    args = parser.parse_args()
    if args.train is not None:
        chosen = ["--knobs", args.knobs] if args.knobs else []
        counts = ["--minutes", args.minutes, "--seeds", args.seeds, "--downscale", args.downscale]
        ladder = splatview("ladder", "--train", args.train, *counts, *chosen)
        path = ROOT / FOLDER / f"training_ladder_{args.name or args.train.name}.json"
        write_results(path, {**ladder, "table": training_table(ladder)})
        return
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
