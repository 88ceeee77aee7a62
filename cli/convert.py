"""`splatview convert`: a scene file to another format, what that costs said first."""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from splatview.cli.arguments import Parser
from splatview.cli.main import make_console
from splatview.cli.sequence import frame_targets, over_frames, refuse_if, source_of
from splatview.scene import Gaussians, InputError
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats import (
    FORMATS,
    check_saving,
    format_of,
    load_cameras,
    load_scene,
    named_output,
)
from splatview.scene.formats.sequence import SceneSequence
from splatview.scene.frames import turn_matrix, turned
from splatview.scene.progress import Progress

if TYPE_CHECKING:
    from splatview.renderers.conversion import Conversion

MOST_VIEWS = 12
"""Of given cameras, evenly spread, that pictures are compared from."""

_OF_FILES = [known.suffix[1:] for known in FORMATS.values() if known.write and not known.folder]
FRAME_SUFFIXES = tuple(sorted(_OF_FILES, key=lambda suffix: suffix != "sog"))
"""Formats that frames of a sequence are written in, the one that is taken unless another is named first."""


def make_parser() -> Parser:
    parser = Parser(
        "convert",
        "Writes the scene IN as OUT, in the format of OUT's suffix, after it has said what comes back from\n"
        "there: the size, the quality over views from around the scene, and what the format cannot hold.\n"
        "OUT may be IN. A folder (or FOLDER/meta.json) becomes one of .sog, and FOLDER/lod-meta.json is\n"
        "streamed SOG of several levels of detail.\n\n"
        "A folder of scenes, or a glob in quotes ('frames/*.ply'), is a sequence: each frame becomes a file\n"
        "of its name in the folder OUT, or a numbered one (out/f_%04d.spz).",
    )
    parser.add_argument("scene", metavar="IN")
    parser.add_argument("output", metavar="OUT")
    parser.add_argument(
        "--target",
        metavar="40dB|5MB",
        help="search for the smallest file of this quality, or for the best picture in this size: coarser "
        "numbers, fewer SH bands, fewer splats",
    )
    parser.add_argument(
        "--format",
        metavar="SUFFIX",
        help=f"of a sequence's files in a folder: {', '.join(FRAME_SUFFIXES)} (default: {FRAME_SUFFIXES[0]})",
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
    source = source_of(args.scene)
    if isinstance(source, SceneSequence):
        return convert_sequence(args, source)
    if args.format is not None:
        raise InputError("--format is for the frames of a sequence; of one scene OUT's suffix says it")
    output = named_output(args.output)
    check_saving(output)
    turn, options = chosen_options(args)

    from splatview.renderers.conversion import convert

    def tell(found: Conversion) -> None:
        bar.stop()
        for loss in found.lost:
            print(f"{output}: {loss}", file=sys.stderr)
        if found.knobs:
            print(f"{output}: {found.knobs_in_words}", file=sys.stderr)
        print(f"{output}: {found.splats:,} splats, {found.in_words}", file=sys.stderr)

    # Of a terminal alone: in a log the lines above say all.
    console = make_console(quiet=not sys.stderr.isatty())
    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Bar(*columns, console=console, transient=True) as bar:
        doing = bar.add_task("reading", total=1.0)
        progress = Progress(report=lambda share: bar.update(doing, completed=share))
        gaussians = load_scene(source, progress=progress.part(0.0, 0.1))
        if turn is not None:
            gaussians = turned(gaussians, turn)
        bar.update(doing, description="searching" if args.target else "converting")
        found = convert(
            gaussians,
            output,
            **options,
            on_measured=tell,
            progress=progress.part(0.1, 1.0),
        )
    if args.json:
        print(json.dumps(report_of(found, output)))
    return 0


def chosen_options(args: argparse.Namespace) -> tuple[np.ndarray | None, dict[str, Any]]:
    """The turn of the scene, and what `convert` gets besides. Raises InputError before anything is read."""
    from splatview.renderers.rate_distortion import parse_target

    turn = turn_matrix(args.turn) if args.turn is not None else None
    cameras = load_cameras(args.cameras) if args.cameras is not None else None
    return turn, {
        "sh_degree": args.sh_degree,
        "target": parse_target(args.target) if args.target is not None else None,
        "cameras": cameras and cameras[:: -(-len(cameras) // MOST_VIEWS)],
    }


def report_of(found: Conversion, output: Path) -> dict[str, Any]:
    """The report for scripts."""
    known = format_of(output)
    return {
        "format": known.suffix[1:] if known else "",
        "bytes": found.bytes,
        "splats": found.splats,
        "psnr": None if found.psnr == math.inf else found.psnr,
        "max_error": found.max_error,
        "lost": list(found.lost),
        "knobs": dict(found.knobs),
    }


def convert_sequence(args: argparse.Namespace, sequence: SceneSequence) -> int:
    """Every frame as a file of its own; a target is that of each. What a frame does not bring back is told
    once, before the first that loses it is written; frames that fail are left out and told of at the end."""
    suffix = (args.format or "").lower().removeprefix(".")
    if suffix and suffix not in FRAME_SUFFIXES:
        raise InputError(f"--format {args.format}: frames are written as {', '.join(FRAME_SUFFIXES)}")
    turn, options = chosen_options(args)
    output, named = Path(args.output), f".{suffix or FRAME_SUFFIXES[0]}"
    known = (named,) if suffix and "%" in output.name else tuple(f".{one}" for one in FRAME_SUFFIXES)
    targets = frame_targets(output, sequence, known, suffix=named)

    from splatview.renderers.conversion import convert

    written: dict[int, Conversion] = {}
    told: set[str] = set()

    def write(i: int, found: Gaussians, on_share: Callable[[float], None]) -> None:
        def tell(measured: Conversion) -> None:
            for loss in measured.lost:
                if loss not in told:
                    print(f"{targets[i]}: {loss}", file=sys.stderr)
            told.update(measured.lost)

        scene = found if turn is None else turned(found, turn)
        progress = Progress(report=on_share)
        try:
            written[i] = convert(scene, targets[i], **options, on_measured=tell, progress=progress)
        except InputError as error:
            raise InputError(f"{sequence.paths[i]}: {error}") from None

    problems = over_frames(sequence, "Converting", write, made="frames")
    if args.json:
        frames = [{"file": str(targets[i]), **report_of(one, targets[i])} for i, one in written.items()]
        print(json.dumps({"sequence": sequence.name, "frames": frames}))
    refuse_if(problems, len(sequence), f"the other {len(written):,} are written")
    print(f"{args.output}: {len(written):,} frames, {in_words(list(written.values()))}", file=sys.stderr)
    return 0


def in_words(found: list[Conversion]) -> str:
    """Size and quality of all frames."""
    size = bytes_in_words(sum(one.bytes for one in found))
    lossy = [one.psnr for one in found if one.psnr != math.inf]
    if not lossy:
        return f"{size}, every number as it was"
    error = 255 * max(one.max_error for one in found)
    return f"{size}, {min(lossy):.1f} to {max(lossy):.1f} dB, largest error {error:.0f} of 255"
