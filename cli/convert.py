"""`splatview convert`: a scene file to another format, what that costs said first."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

from splatview.cli.arguments import Parser
from splatview.scene.formats import check_saving, format_of, load_scene


def make_parser() -> Parser:
    parser = Parser(
        "convert",
        "Writes the scene IN as OUT, in the format of OUT's suffix, after it has said what comes back from\n"
        "there: the size, the quality over views from around the scene, and what the format cannot hold.\n"
        "OUT may be IN.",
    )
    parser.add_argument("scene", metavar="IN")
    parser.add_argument("output", metavar="OUT", type=Path)
    parser.add_argument("--json", action="store_true", help="the report for scripts, on standard output")
    return parser


def run(arguments: list[str]) -> int:
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    check_saving(args.output)
    gaussians = load_scene(args.scene)

    from splatview.renderers.conversion import Conversion, convert

    def tell(found: Conversion) -> None:
        for loss in found.lost:
            print(f"{args.output}: {loss}", file=sys.stderr)
        print(f"{args.output}: {found.splats:,} splats, {found.in_words}", file=sys.stderr)

    found = convert(gaussians, args.output, on_measured=tell)
    if args.json:
        known = format_of(args.output)
        report = {
            "format": known.suffix[1:] if known else "",
            "bytes": found.bytes,
            "psnr": None if found.psnr == math.inf else found.psnr,
            "max_error": found.max_error,
            "lost": list(found.lost),
        }
        print(json.dumps(report))
    return 0
