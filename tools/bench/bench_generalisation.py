"""Held-out PSNR over many captures, with thirds of the photos held out in turn, at 1, 3 and 10 minutes.

    python tools/bench/bench_generalisation.py DATA MADE --checkout NAME=PATH ... [--captures NAME ...]
        [--minutes 1 3 10] [--splits 0 1 2] [--seeds 0 1 2] [--set NAME:FIELD=JSON ...] [--passing]
        [--layout pairs|marks|fits] [-o FILE]

DATA holds `captures` and `scenes`, MADE receives the rendered captures (see `capture_set`), and holds those
that `public_captures` has posed. Every run is a
process of a checkout with its own .venv; a minute is that of `generalisation_run.step_seconds`, so that runs
beside one another, or on a busy machine, end in the same figures. What a call has measured before is kept in
assets/benchmarks/generalisation.json, and only what is missing is run: the whole takes many hours.
`--set` gives a checkout's runs settings of their own: a rule is tried before it is made. With `--passing`
(and an output of its own) something passes before the scene in a fifth of the photos trained on.

Seeds are for captures of few photos far apart, where chance makes more than what is looked for: three runs of
a split of `miku 12 far` score between 18.7 and 20.6 dB.
"""

from __future__ import annotations

import argparse
import json
import subprocess
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import numpy as np
from capture_set import DRIFTING, NAMES, RENDERED, SPLITS, make_all, use_of

from splatview.measure.machine import FOLDER, write_results
from splatview.trainer.recipe import MEMBERS, STEPS_OF_A_MINUTE

RUN = Path(__file__).with_name("generalisation_run.py")

NOISE_DB = 0.05
"""By how much a longer run may be worse."""

NOTE = (
    "Mean PSNR of held-out thirds of the photos. Rules of the recipe were chosen on the captures marked so, "
    "and are only judged by the others. Held-out photos of miku, demo drift and captures of strangers, which "
    "differ in exposure, are measured after a fit of it. Haze: mean opacity where held-out photos are empty. "
    "Minutes of a model of what a step costs on two cores, so that no other work on the machine matters. "
    "Runs that their steps end are the same for longer marks, and not repeated."
)

Key = tuple[str, str, int, float, int]
"""Checkout's name, capture, split, minutes, seed."""

Round = tuple[int, int]
"""Split and seed."""


def known_runs(path: Path) -> dict[Key, dict[str, Any]]:
    """Those of earlier calls."""
    if not path.exists():
        return {}
    runs = json.loads(path.read_text(encoding="utf8"))["runs"]
    return {
        (run["of"], run["capture"], run["split"], run["minutes"], run["set"].get("seed", 0)): run
        for run in runs
    }


def rounds_of(
    runs: dict[Key, dict[str, Any]], capture: str, names: list[str], marks: list[float]
) -> list[Round]:
    """Splits and seeds of a capture that all these checkouts have run for all these minutes."""
    found = sorted({(split, seed) for _, its, split, _, seed in runs if its == capture})
    return [
        (split, seed)
        for split, seed in found
        if all((name, capture, split, mark, seed) in runs for name in names for mark in marks)
    ]


def in_words(rounds: list[Round]) -> str:
    """How many splits, and how many runs these are where it is not one each."""
    splits = len({split for split, _ in rounds})
    return str(splits) if len(rounds) == splits else f"{splits} ({len(rounds)} runs)"


def score(run: dict[str, Any]) -> float:
    """PSNR in dB, of all runs of a capture measured alike."""
    return run["psnr_fitted" if run["capture"] in DRIFTING else "psnr_plain"]


def mean_of_splits(rounds: list[Round], values: list[float]) -> float:
    """The mean over splits of the means over their seeds: one run with more seeds does not weigh more."""
    splits = sorted({split for split, _ in rounds})
    of_split = {s: [v for (split, _), v in zip(rounds, values, strict=True) if split == s] for s in splits}
    return float(np.mean([np.mean(found) for found in of_split.values()]))


def run_one(
    checkout: Path, key: Key, data: Path, made: Path, fields: list[str], *more: str
) -> dict[str, Any]:
    """One run's figures. `more`: arguments. Raises SystemExit where it fails."""
    name, capture, split, minutes, seed = key
    fields = [*fields, f"seed={seed}"] if seed else fields
    command = [str(checkout / ".venv" / "bin" / "python"), str(RUN), capture, str(data), str(made)]
    command += ["--split", str(split), "--minutes", str(minutes), *more]
    command += ["--set", *fields] if fields else []
    # Its own folder: `splatview` of the checkout must not be hidden by this one.
    done = subprocess.run(command, check=False, cwd=checkout, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{name}: {capture}: {done.stderr.strip().splitlines()[-1]}")
    return {"of": name, **json.loads(done.stdout.splitlines()[-1])}


def same_run(runs: dict[Key, dict[str, Any]], key: Key) -> dict[str, Any] | None:
    """The run of a shorter mark that would only be repeated: its steps ended it, and limited its splats too,
    see `automatic_limit`, and if it trained several scenes it had time for all of them. Both are then the
    same to the bit."""
    name, capture, split, minutes, seed = key
    for shorter in sorted({mark for *_, mark, _ in runs if mark < minutes}):
        run = runs.get((name, capture, split, shorter, seed))
        scenes = run.get("scenes", 0) if run else 0  # 0: one alone, however many minutes there are
        if (
            run
            and scenes in (0, MEMBERS + 1)
            and run["seconds"] < 60 * shorter
            and run["iteration"] <= STEPS_OF_A_MINUTE * shorter * max(scenes, 1)
        ):
            return run | {"minutes": minutes, "same_as": shorter}
    return None


def table(runs: dict[Key, dict[str, Any]], names: list[str]) -> dict[str, Any]:
    """A row for each capture and mark: means over splits, by checkout, and the last one's gain over the
    first."""
    columns = ["capture", "rules", "photos", "minutes", *names]
    columns += [f"{names[-1]} - {names[0]}, dB"] if len(names) > 1 else []
    has_sky = any("unseen_error" in run for run in runs.values())
    columns += ["wrong sky", "wrong unseen sky", "unseen sky empty"] if has_sky else ["haze"]
    rows = []
    for capture in NAMES:
        for minutes in sorted({key[3] for key in runs if key[1] == capture}):
            rounds = rounds_of(runs, capture, names, [minutes])
            if not rounds:
                continue
            by_name = [[runs[name, capture, s, minutes, seed] for s, seed in rounds] for name in names]
            means = [float(np.mean([score(run) for run in found])) for found in by_name]
            row = [capture, use_of(capture), str(by_name[0][0]["photos"]), f"{minutes:g}"]
            row += [f"{mean:.2f}" for mean in means]
            if len(names) > 1:
                gains = [score(b) - score(a) for a, b in zip(by_name[0], by_name[-1], strict=True)]
                spread = f" ({min(gains):+.2f} to {max(gains):+.2f})" if len(gains) > 1 else ""
                row.append(f"{np.mean(gains):+.2f}{spread}")
            if has_sky:
                row += [sky_cell(by_name, kind) for kind in ("sky_error", "unseen_error", "unseen_empty")]
            else:
                haze = [run["haze"] for run in by_name[-1] if run["haze"] is not None]
                row.append(f"{np.mean(haze):.4f}" if haze else "")
            rows.append(row)
    return {"columns": columns, "rows": rows, "note": f"{NOTE} {SKY_NOTE}" if has_sky else NOTE}


SKY_NOTE = (
    "Wrong sky: mean absolute difference of colours, 0 to 1, in the sky of held-out photos and in directions "
    "of it that no photo trained on shows; empty: share of the latter with an opacity below a half."
)


def sky_cell(by_name: list[list[dict[str, Any]]], kind: str) -> str:
    """The means of a figure of the sky, by checkout."""
    means = [[run[kind] for run in found if kind in run] for found in by_name]
    return ", ".join(f"{np.mean(values):.3f}" if values else "" for values in means)


def table_of_fits(runs: dict[Key, dict[str, Any]], names: list[str]) -> dict[str, Any]:
    """A row for each capture and mark that all checkouts have run: PSNR after a fit of exposures and as
    pictures are, by checkout, each over its own splits and seeds, and what the last gains over the first."""
    rows = []
    for capture in NAMES:
        for minutes in sorted({key[3] for key in runs if key[1] == capture}):
            rounds = {name: rounds_of(runs, capture, [name], [minutes]) for name in names}
            if not all(rounds.values()):
                continue
            found = {
                name: [runs[name, capture, split, minutes, seed] for split, seed in its]
                for name, its in rounds.items()
            }
            means = [
                [
                    mean_of_splits(rounds[name], [run[kind] for run in its])
                    for kind in ("psnr_fitted", "psnr_plain")
                ]
                for name, its in found.items()
            ]
            gains = [last - first for first, last in zip(means[0], means[-1], strict=True)]
            row = [capture, use_of(capture), str(found[names[-1]][0]["photos"]), f"{minutes:g}"]
            row += [", ".join(in_words(its) for its in rounds.values())]
            row += [", ".join(f"{value:.2f}" for value in pair) for pair in means]
            rows.append([*row, ", ".join(f"{gain:+.2f}" for gain in gains)])
    columns = ["capture", "rules", "photos", "minutes", "splits", *names, "gain"]
    return {"columns": columns, "rows": rows, "note": FITS_NOTE}


FITS_NOTE = (
    "Mean PSNR in dB of held-out thirds of the photos, after a fit of their exposures and as they are, over "
    "splits, each the mean of its seeds, and the gain. Minutes of a model of what a step costs on two cores."
)


def row_by_marks(
    runs: dict[Key, dict[str, Any]],
    capture: str,
    name: str,
    rounds: list[Round],
    its_marks: list[float],
    marks: list[float],
) -> list[str]:
    """The cells of a capture, of which a checkout has run `rounds` at `its_marks`, but for the checkout's."""
    by_mark = {m: [runs[name, capture, s, m, seed] for s, seed in rounds] for m in its_marks}
    scores = {m: mean_of_splits(rounds, [score(run) for run in found]) for m, found in by_mark.items()}
    last = by_mark[its_marks[-1]]
    haze = [run["haze"] for run in last if run["haze"] is not None]
    gains = [later - sooner for sooner, later in pairwise(scores[m] for m in its_marks)]
    return [
        capture,
        use_of(capture),
        str(last[0]["photos"]),
        in_words(rounds),
        *(f"{scores[m]:.2f}" if m in scores else "" for m in marks),
        f"{min(gains):+.2f}" if gains else "",
        f"{np.mean(haze):.4f}" if haze else "",
    ]


def table_by_marks(runs: dict[Key, dict[str, Any]], names: list[str]) -> dict[str, Any]:
    """A row for each capture and checkout, a column for each mark: means over the splits and seeds that the
    checkout has run at all marks of the row. Where there are more without the last marks, these have a row of
    their own before it."""
    marks = sorted({minutes for _, _, _, minutes, _ in runs})
    rows = []
    for capture, name in product(NAMES, names):
        its_marks = [m for m in marks if rounds_of(runs, capture, [name], [m])]
        prefixes = [its_marks[: end + 1] for end in range(len(its_marks))]
        found = [rounds_of(runs, capture, [name], prefix) for prefix in prefixes]
        for prefix, (rounds, longer) in zip(prefixes, pairwise([*found, []]), strict=True):
            if len(rounds) > len(longer) and (len(prefix) > 1 or not longer):
                first, *rest = row_by_marks(runs, capture, name, rounds, prefix, marks)
                rows.append([first, *([name] if len(names) > 1 else []), *rest])
    columns = ["capture", *(["recipe"] if len(names) > 1 else []), "rules", "photos", "splits"]
    columns += [*(f"{m:g} min, dB" for m in marks), "least gain by time, dB", "haze"]
    return {"columns": columns, "rows": rows, "note": NOTE}


LAYOUTS = {"pairs": table, "marks": table_by_marks, "fits": table_of_fits}
"""Of tables: checkouts side by side, how they fare in time, and after a fit of exposures and without."""


def worse_with_time(runs: dict[Key, dict[str, Any]], name: str) -> list[str]:
    """A line for each capture that a longer run of a checkout makes worse, by the mean over common splits."""
    lines = []
    for capture in NAMES:
        marks = sorted({key[3] for key in runs if key[0] == name and key[1] == capture})
        for short, long in pairwise(marks):
            rounds = rounds_of(runs, capture, [name], [short, long])
            gains = [
                score(runs[name, capture, s, long, seed]) - score(runs[name, capture, s, short, seed])
                for s, seed in rounds
            ]
            change = mean_of_splits(rounds, gains) if rounds else 0.0
            if not change >= -NOISE_DB:
                lines.append(f"{name}: {capture}: {change:+.2f} dB from {short:g} to {long:g} minutes")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=Path)
    parser.add_argument("made", type=Path)
    parser.add_argument("--checkout", action="append", required=True, metavar="NAME=PATH")
    parser.add_argument("--captures", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--minutes", type=float, nargs="+", default=[1.0, 3.0, 10.0])
    parser.add_argument("--splits", type=int, nargs="+", default=list(range(SPLITS)))
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME:FIELD=JSON")
    parser.add_argument(
        "--passing", action="store_true", help="something passes before a fifth of the photos"
    )
    parser.add_argument(
        "--layout",
        choices=LAYOUTS,
        help="of the table: checkouts side by side (pairs), how they fare in time (marks), or after a fit of"
        " exposures and without (fits); default: marks for one checkout, else pairs",
    )
    parser.add_argument("-o", "--output", type=Path, default=FOLDER / "generalisation.json")
    options = parser.parse_args()
    checkouts = dict(pair.split("=", 1) for pair in options.checkout)
    make_all(options.data, options.made, [name for name in options.captures if name in RENDERED])
    runs = known_runs(options.output)
    every = product(options.seeds, options.splits, options.minutes, options.captures, checkouts.items())
    for seed, split, minutes, capture, (name, path) in every:
        key = name, capture, split, minutes, seed
        if key in runs:
            continue
        fields = [f.split(":", 1)[1] for f in options.set if f.startswith(f"{name}:")]
        more = ["--passing"] if options.passing else []
        runs[key] = same_run(runs, key) or run_one(
            Path(path).resolve(), key, options.data.resolve(), options.made.resolve(), fields, *more
        )
        # Another call may have been at other captures meanwhile.
        runs = known_runs(options.output) | runs
        print(name, capture, split, minutes, f"{score(runs[key]):.2f}", flush=True)
        layout = LAYOUTS[options.layout or ("marks" if len(checkouts) == 1 else "pairs")]
        made = layout(runs, list(checkouts))
        write_results(options.output, {"runs": list(runs.values()), "table": made})
    for name in checkouts:
        print(*worse_with_time(runs, name), sep="\n")


if __name__ == "__main__":
    main()
