"""`splatview convert`: a scene file to another format, or the same one cleanly written."""

from __future__ import annotations

import sys
from pathlib import Path

from splatview.cli.arguments import Parser
from splatview.scene.formats import FORMATS, check_saving, load_scene, save_scene


def run(arguments: list[str]) -> int:
    parser = Parser(
        "convert",
        "Writes the scene IN as OUT, in the format of OUT's suffix. All values, comments and properties\n"
        "that the format can hold stay as they are. OUT may be IN.",
    )
    parser.add_argument("scene", metavar="IN")
    parser.add_argument("output", metavar="OUT", type=Path)
    args = parser.parse(arguments)
    if args is None:
        return 0
    check_saving(args.output)
    gaussians = load_scene(args.scene)
    save_scene(gaussians, args.output)
    size = args.output.stat().st_size / 2**20
    for loss in FORMATS[args.output.suffix.lower()[1:]].lost:
        print(f"{args.output}: {loss}", file=sys.stderr)
    print(f"{args.output}: {len(gaussians):,} splats, {size:.1f} MiB", file=sys.stderr)
    return 0
