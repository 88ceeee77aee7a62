"""`splatview convert`: a scene file to another format, what that costs said first."""

from __future__ import annotations

import json
import math
import sys

from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from splatview.cli.arguments import Parser
from splatview.cli.main import make_console
from splatview.scene.formats import check_saving, format_of, load_cameras, load_scene, named_output
from splatview.scene.frames import turn_matrix, turned
from splatview.scene.progress import Progress

MOST_VIEWS = 12
"""Of given cameras, evenly spread, that pictures are compared from."""


def make_parser() -> Parser:
    parser = Parser(
        "convert",
        "Writes the scene IN as OUT, in the format of OUT's suffix, after it has said what comes back from\n"
        "there: the size, the quality over views from around the scene, and what the format cannot hold.\n"
        "OUT may be IN. A folder (or FOLDER/meta.json) becomes one of .sog, and FOLDER/lod-meta.json is\n"
        "streamed SOG of several levels of detail.",
    )
    parser.add_argument("scene", metavar="IN")
    parser.add_argument("output", metavar="OUT")
    parser.add_argument(
        "--target",
        metavar="40dB|5MB",
        help="search for the smallest file of this quality, or for the best picture in this size: coarser "
        "numbers, fewer SH bands, fewer splats",
    )
    parser.add_argument("--sh-degree", type=int, choices=range(4), help="the highest SH degree to keep")
    parser.add_argument(
        "--turn",
        metavar="over|AXIS DEG",
        help="turn the scene first, about its origin: over (upside down: x180), z90, x90,y-90, ...",
    )
    parser.add_argument(
        "--cameras",
        metavar="CAMS",
        help="measure from these cameras rather than from around the scene: for rooms, which are not seen "
        "from outside",
    )
    parser.add_argument("--json", action="store_true", help="the report for scripts, on standard output")
    return parser


def run(arguments: list[str]) -> int:
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    output = named_output(args.output)
    check_saving(output)
    turn = turn_matrix(args.turn) if args.turn is not None else None
    cameras = load_cameras(args.cameras) if args.cameras is not None else None

    from splatview.renderers.conversion import Conversion, convert
    from splatview.renderers.rate_distortion import parse_target

    target = parse_target(args.target) if args.target is not None else None

    def tell(found: Conversion) -> None:
        bar.stop()
        for loss in found.lost:
            print(f"{output}: {loss}", file=sys.stderr)
        if target is not None and found.knobs:
            print(f"{output}: {found.knobs_in_words}", file=sys.stderr)
        print(f"{output}: {found.splats:,} splats, {found.in_words}", file=sys.stderr)

    # Of a terminal alone: in a log the lines above say all.
    console = make_console(quiet=not sys.stderr.isatty())
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Bar(*columns, console=console, transient=True) as bar:
        doing = bar.add_task("reading", total=1.0)
        progress = Progress(report=lambda share: bar.update(doing, completed=share))
        gaussians = load_scene(args.scene, progress=progress.part(0.0, 0.1))
        if turn is not None:
            gaussians = turned(gaussians, turn)
        bar.update(doing, description="searching" if target is not None else "converting")
        found = convert(
            gaussians,
            output,
            sh_degree=args.sh_degree,
            target=target,
            cameras=cameras and cameras[:: -(-len(cameras) // MOST_VIEWS)],
            on_measured=tell,
            progress=progress.part(0.1, 1.0),
        )
    if args.json:
        known = format_of(output)
        report = {
            "format": known.suffix[1:] if known else "",
            "bytes": found.bytes,
            "splats": found.splats,
            "psnr": None if found.psnr == math.inf else found.psnr,
            "max_error": found.max_error,
            "lost": list(found.lost),
            "knobs": dict(found.knobs),
        }
        print(json.dumps(report))
    return 0
