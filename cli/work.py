"""`splatview bill`: what one picture takes in evaluations, arithmetic and bytes, beside a NeRF."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from rich.table import Table

from splatview.cli.arguments import Parser, add_camera_options, check_camera_options, chosen_orbit
from splatview.cli.main import make_console
from splatview.cli.render import check_output, write_picture
from splatview.measure.metrics import heat
from splatview.measure.work import as_json, bill_of, rows, sums
from splatview.scene.effects.overrides import settings_for
from splatview.scene.formats import load_scene


def make_parser() -> Parser:
    parser = Parser(
        "bill",
        "Counts what a picture of SCENE takes: splats evaluated a pixel, operations, bytes, storage; and\n"
        "what the method that splatting replaced, a NeRF, would pay for the same picture, sums included.",
    )
    parser.add_argument("scene", metavar="SCENE")
    add_camera_options(parser)
    group = parser.add_argument_group("bill")
    group.add_argument(
        "--heatmap",
        type=Path,
        metavar="OUT.png",
        help="evaluations of each pixel as a picture, by brightness",
    )
    group.add_argument("--json", action="store_true", help="numbers as one JSON object")
    return parser


def run(arguments: list[str]) -> int:
    from splatview.raster import Workspace, parameters_of
    from splatview.raster.contributions import count_work

    args = make_parser().parse(arguments)
    if args is None:
        return 0
    check_camera_options(args)
    if args.heatmap is not None:
        check_output(args.heatmap)
    gaussians = load_scene(args.scene)
    camera = chosen_orbit(args, gaussians).camera
    work = count_work(parameters_of(gaussians), camera, settings_for(gaussians), Workspace())
    bill = bill_of(gaussians, work)
    brightest = float(work.evaluations.max())
    if args.heatmap is not None:
        write_picture(heat_map(work.evaluations), args.heatmap)
    if args.json:
        print(json.dumps({"scene": Path(args.scene).name, **as_json(bill), "most": brightest}))
        return 0
    title = f"{Path(args.scene).name}, {len(gaussians):,} splats, {camera.width}x{camera.height}"
    table = Table("what a picture takes", title=title)
    for column in ("splats", "a NeRF"):
        table.add_column(column, justify="right")
    for row in rows(bill):
        table.add_row(*row)
    console = make_console(stderr=False)
    console.print(table)
    for line in sums(bill):
        console.print(line)
    if args.heatmap is not None:
        console.print(
            f"{args.heatmap}: black is no splat, pale yellow {brightest:.0f}, the brightness their root",
            highlight=False,
        )
    return 0


def heat_map(evaluations: np.ndarray) -> np.ndarray:
    """(H, W) counts -> picture (H, W, 4) float32. By the root: few pixels take most, and the rest would be
    black."""
    share = np.sqrt(evaluations / max(float(evaluations.max()), 1.0))
    return np.concatenate([heat(share), np.ones((*share.shape, 1))], axis=-1).astype(np.float32)
