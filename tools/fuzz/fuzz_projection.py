"""Splats of every float32 pattern through each projection, against the float64 one.

    python tools/fuzz/fuzz_projection.py --seconds 60 [--json FILE] [--more] [--failures DIR] [--splats N]

Projections: that of `quads` (which `tiles` shares), that of `quads` on old OpenGL, and the CPU's, with its
gradients of random losses. A failure is a splat shown that must be culled, or culled that must be shown, a
record further from the float64 one than float32 can lose, or any NaN or infinity in records, pictures or
gradients. Blocks are drawn by a number, and those of failures are named. The exit code is 1 if there was any.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from patterns import RAYS, block_of
from projections import (
    COLOUR,
    MEAN_PX,
    RELATIVE,
    SENSITIVITY,
    STEPS,
    CpuProjection,
    GLProjection,
    Projection,
    truth_of,
    wrong_rows,
)
from results import add_to, read

from splatview.renderers.gl.context import create_headless_context

SPLATS = 100_000
"""A block: some tens of MiB."""


SEEN = {"pinhole": "", "parallel": ", parallel rays", "lens": ", through lenses"}
"""Of a row's name in the table."""


@dataclass
class Counts:
    """Of one projection."""

    splats: int = 0
    must_show: int = 0
    must_cull: int = 0
    undecided: int = 0
    """Those that rounding decides, or whose footprint ends at the picture's edge or beside it."""
    wrong: dict[str, int] = field(default_factory=dict)
    """Splats by what is wrong with them, and blocks with a NaN or infinity."""
    seconds: float = 0.0


def check_block(
    seed: int, splats: int, rays: str, projections: Mapping[str, Projection], table: dict[str, Counts]
) -> list[str]:
    """Adds one block to `table`, and says what is wrong in it, one line each."""
    block = block_of(seed, splats, rays=rays)
    truth = truth_of(block, seed)
    lines = []
    for projection_name, projection in projections.items():
        name = projection_name + SEEN[rays]
        counts = table.setdefault(name, Counts())
        started = time.perf_counter()
        projected = projection(block)
        counts.seconds += time.perf_counter() - started
        counts.splats += splats
        counts.must_show += int(np.count_nonzero(truth.must_show))
        counts.must_cull += int(np.count_nonzero(truth.must_cull))
        counts.undecided += truth.undecided
        wrong: dict[str, Any] = {**wrong_rows(projected, truth)}
        if not projected.finite:
            wrong["not finite"] = [0]
        for what, rows in wrong.items():
            counts.wrong[what] = counts.wrong.get(what, 0) + len(rows)
            lines.append(f"{name}: block {seed} of {splats}: {len(rows)} {what}, the first at {rows[0]}")
    return lines


def make_projections() -> dict[str, Projection]:
    """All of them, on a headless context."""
    ctx = create_headless_context(require=430)
    return {
        "quads, tiles": GLProjection(ctx, legacy=False),
        "quads (OpenGL 3.3)": GLProjection(ctx, legacy=True),
        "cpu, with gradients": CpuProjection(backward=True),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--splats", type=int, default=SPLATS, help="of a block")
    parser.add_argument("--rays", nargs="+", choices=RAYS, default=RAYS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--more", action="store_true", help="go on where the counts in the JSON file end")
    arguments = parser.parse_args()
    kept = read(arguments.json)
    seed, table = arguments.start, {}
    if arguments.more and "projections" in kept:
        seed = kept["next_block"]
        known = {one.name for one in fields(Counts)}
        table = {
            name: Counts(**{key: value for key, value in entry.items() if key in known})
            for name, entry in kept["projections"].items()
        }
    projections = make_projections()
    until = time.monotonic() + arguments.seconds
    failed = False
    while time.monotonic() < until:
        for rays in arguments.rays:
            for line in check_block(seed, arguments.splats, rays, projections, table):
                failed = True
                print(line, flush=True)
        seed += 1
        if arguments.json:
            entry = {
                "next_block": seed,
                "tolerances": {
                    "roundings": STEPS,
                    "times": SENSITIVITY,
                    "mean_px": MEAN_PX,
                    "conic_and_opacity": RELATIVE,
                    "colour": COLOUR,
                },
                "projections": {name: asdict(counts) for name, counts in table.items()},
            }
            add_to(arguments.json, entry)
    for name, counts in table.items():
        print(f"{name:20} {counts.splats:12,} splats, {counts.wrong or 'none wrong'}")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
