"""Sequences without a window: pictures of all frames, and what the frames hold."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from splatview.cli.arguments import Orbit, chosen_background, chosen_orbit, chosen_plan
from splatview.cli.main import make_console
from splatview.renderers.headless import make_headless
from splatview.scene import InputError
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats.io import target_of
from splatview.scene.formats.sequence import SceneSequence, read_ahead
from splatview.scene.framing import robust_bounds

NUMBER = re.compile(r"%0?[0-9]*d")
"""Place of a frame's number in a file name, as in ffmpeg's: %04d."""


def frame_targets(output: Path, sequence: SceneSequence, suffixes: tuple[str, ...]) -> list[Path]:
    """The file of each frame: `output` with numbers from 1, or in a folder the names of the scenes.

    Raises:
        InputError: it names one file for all of them, or cannot be written to.
    """
    folder, name = output.parent, output.name
    if "%" in name:
        if len(NUMBER.findall(name)) != 1 or name.count("%") != 1:
            raise InputError(
                f"{output}: give one place for the frame's number, as in frame_%04d{suffixes[0]}"
            )
        if output.suffix.lower() not in suffixes:
            raise InputError(f"{output}: files are written as {' or '.join(suffixes)}; give it that suffix")
        targets = [folder / (name % (i + 1)) for i in range(len(sequence))]
    elif output.suffix.lower() in suffixes and not os.path.isdir(output):
        raise InputError(
            f"{output}: is one file, and {sequence.name} has {len(sequence):,} frames; give a folder, or"
            f" number them: {output.stem}_%04d{output.suffix}"
        )
    else:
        folder = output
        stems = [path.name.split(".")[0] or path.name for path in sequence.paths]
        if len(set(stems)) < len(stems):
            digits = max(4, len(str(len(stems))))
            stems = [f"frame_{i + 1:0{digits}}" for i in range(len(stems))]
        targets = [output / f"{stem}{suffixes[0]}" for stem in stems]
    if not os.path.lexists(folder):
        try:
            folder.mkdir()
        except OSError as error:
            raise InputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    target_of(targets[0])
    return targets


@contextmanager
def counted(title: str, count: int) -> Iterator[Progress]:
    """A bar for `count` frames on standard error; its only task is the first."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    console = make_console()
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        bar.add_task(title, total=count)
        yield bar


def refuse_if(problems: list[InputError], count: int, done: str) -> None:
    """Raises InputError where frames could not be read, after all others."""
    if problems:
        what = f"{len(problems):,} of {count:,} frames cannot be read"
        first = f"; the first: {problems[0]}" if len(problems) > 1 else f": {problems[0]}"
        raise InputError(f"{what}, {done}{first}")


def render_sequence(args: argparse.Namespace, sequence: SceneSequence) -> int:
    """A picture of each frame by one camera, that of the first frame; with --turn the eye goes on by as much
    before each one that follows. Frames that cannot be read are left out and told of at the end."""
    from splatview.cli.render import SUFFIXES, chosen_aperture, chosen_settings, render_frames, write_picture

    if args.stats or args.frames != 1:
        raise InputError("--stats and --frames measure one scene; name one of the sequence's files")
    targets = frame_targets(args.output, sequence, SUFFIXES)
    behind = chosen_background(args.background, args.up)
    renderer = make_headless(args.renderer, mode=args.mode)
    still = argparse.Namespace(**{**vars(args), "turn": 0.0})
    orbit: Orbit | None = None
    problems: list[InputError] = []
    written = 0
    try:
        with counted("Rendering", len(sequence)) as bar:
            for i, (_, found) in enumerate(read_ahead(sequence.paths)):
                bar.update(bar.task_ids[0], completed=i, description=sequence.labels[i])
                if isinstance(found, InputError):
                    problems.append(found)
                    continue
                orbit = orbit or chosen_orbit(args, found)
                camera = orbit.turned(args.turn * i) if args.turn else orbit.camera
                settings = replace(chosen_settings(args, found), background=behind)
                plan = chosen_plan(args, settings, renderer.name)
                aperture = chosen_aperture(args, camera)
                here = replace(orbit, camera=camera)
                image, _ = render_frames(still, renderer, found, here, plan, aperture)
                write_picture(image, targets[i], alpha=args.alpha)
                written += 1
    except KeyboardInterrupt:
        print(f"splatview: stopped; {written:,} of {len(sequence):,} pictures are written", file=sys.stderr)
        raise
    refuse_if(problems, len(sequence), f"the other {written:,} are rendered")
    size = f"{orbit.camera.width}x{orbit.camera.height}" if orbit else ""
    print(f"{args.output}: {written:,} pictures, {size}, by {renderer.name}", file=sys.stderr)
    return 0


def describe_sequence(sequence: SceneSequence, *, as_json: bool) -> int:
    """Number and bytes of the splats of every frame, and bounds of all. Each frame is read whole: a damaged
    one is found here and not in the middle of a film."""
    frames: list[dict[str, Any]] = []
    problems: list[InputError] = []
    low = high = None
    with counted("Reading", len(sequence)) as bar:
        for i, (path, found) in enumerate(read_ahead(sequence.paths)):
            bar.update(bar.task_ids[0], completed=i, description=sequence.labels[i])
            entry: dict[str, Any] = {"file": str(path)}
            frames.append(entry)
            if isinstance(found, InputError):
                problems.append(found)
                entry["error"] = str(found)
                continue
            entry |= {"count": len(found), "sh_degree": found.sh_degree, "bytes": found.nbytes}
            entry["file_bytes"] = file_bytes(path)
            centre, radius = robust_bounds(found.means)
            low = centre - radius if low is None else low.clip(max=centre - radius)
            high = centre + radius if high is None else high.clip(min=centre + radius)
    read = [entry for entry in frames if "error" not in entry]
    counts = [entry["count"] for entry in read] or [0]
    receipt = {
        "sequence": sequence.name,
        "frames": frames,
        "count": {"min": min(counts), "max": max(counts)},
        "bytes": sum(entry["bytes"] for entry in read),
        "file_bytes": sum(entry["file_bytes"] for entry in read),
        "bounds": None
        if low is None or high is None
        else {"min": [float(value) for value in low], "max": [float(value) for value in high]},
        "left_out": sequence.left_out,
    }
    print(json.dumps(receipt, indent=1, allow_nan=False) if as_json else as_text(sequence, receipt))
    refuse_if(problems, len(sequence), "the others can")
    return 0


def file_bytes(path: Path) -> int:
    """Size of a file, or of the files in a folder."""
    if not path.is_dir():
        return path.stat().st_size
    return sum(entry.stat().st_size for entry in os.scandir(path) if entry.is_file())


def as_text(sequence: SceneSequence, receipt: dict[str, Any]) -> str:
    """The receipt for people."""
    least, most = receipt["count"]["min"], receipt["count"]["max"]
    counts = f"{most:,} splats each" if least == most else f"{least:,} to {most:,} splats"
    lines = [
        f"{sequence.name}: {sequence.in_words}",
        f"  {counts}; {bytes_in_words(receipt['file_bytes'])} in files, {bytes_in_words(receipt['bytes'])} in"
        " memory",
    ]
    if receipt["bounds"] is not None:
        low, high = (", ".join(f"{v:.4g}" for v in receipt["bounds"][key]) for key in ("min", "max"))
        lines.append(f"  most of it from ({low}) to ({high})")
    wide = max(map(len, sequence.labels))
    for i, (label, entry) in enumerate(zip(sequence.labels, receipt["frames"], strict=True), 1):
        if "error" in entry:
            what = "cannot be read"
        else:
            size = bytes_in_words(entry["file_bytes"])
            what = f"{entry['count']:>12,} splats  SH {entry['sh_degree']}  {size:>10}"
        lines.append(f"{i:>7}  {label:{wide}}  {what}")
    return "\n".join(lines)
