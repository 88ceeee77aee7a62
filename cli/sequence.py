"""Sequences without a window: what the frames hold, and work that is done to each of them, with files for
each."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bar

from splatview.cli.main import make_console
from splatview.scene import Gaussians, InputError
from splatview.scene.errors import bytes_in_words
from splatview.scene.formats import FORMATS, save_scene
from splatview.scene.formats.io import target_of
from splatview.scene.formats.sequence import SceneSequence, is_glob, read_ahead, resolve
from splatview.scene.framing import robust_bounds

NUMBER = re.compile(r"%0?[0-9]*d")
"""Place of a frame's number in a file name, as in ffmpeg's: %04d."""


def source_of(scene: str) -> SceneSequence | Path:
    """What SCENE names: a sequence, or the path of one scene. Raises InputError where a glob matches none."""
    found = resolve(Path(scene))
    if isinstance(found, Path) and is_glob(found):
        raise InputError(f"{scene}: nothing matches it")
    return found


def frame_targets(
    output: Path, sequence: SceneSequence, suffixes: tuple[str, ...], suffix: str | None = None
) -> list[Path]:
    """The file of each frame: `output` with numbers from 1 and one of `suffixes`, or in a folder, which is
    made, the names of the scenes, with `suffix`; None: their own where it is one of `suffixes`, else the
    first of these.

    Raises:
        InputError: it names one file for all of them, or a frame itself, or cannot be written to.
    """
    folder, name = output.parent, output.name
    if "%" in name:
        if len(NUMBER.findall(name)) != 1 or name.count("%") != 1:
            raise InputError(
                f"{output}: give one place for the frame's number, as in frame_%04d{suffixes[0]}"
            )
        if not name.lower().endswith(suffixes):
            raise InputError(f"{output}: files are written as {' or '.join(suffixes)}; give it that suffix")
        targets = [folder / (name % (i + 1)) for i in range(len(sequence))]
    elif output.name.lower().endswith(suffixes) and not os.path.isdir(output):
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
        ends = [suffix or own_suffix(path, suffixes) for path in sequence.paths]
        targets = [output / f"{stem}{end}" for stem, end in zip(stems, ends, strict=True)]
    if not os.path.lexists(folder):
        try:
            folder.mkdir()
        except OSError as error:
            raise InputError(f"{folder}: cannot be made: {error.strerror or error}") from None
    target_of(targets[0])
    own = {os.path.realpath(path) for path in sequence.paths}
    taken = next((target for target in targets if os.path.realpath(target) in own), None)
    if taken is not None:
        raise InputError(f"{taken}: is a frame of the sequence itself; give another folder")
    return targets


def own_suffix(path: Path, suffixes: tuple[str, ...]) -> str:
    """That of `path` where it is among `suffixes`, else the first of these."""
    fitting = [suffix for suffix in suffixes if path.name.lower().endswith(suffix)]
    return max(fitting, key=len, default=suffixes[0])


def over_frames(
    sequence: SceneSequence,
    title: str,
    work: Callable[[int, Gaussians, Callable[[float], None]], object],
    *,
    made: str = "",
) -> dict[int, InputError]:
    """Does `work` with the number and the splats of every frame, one after another, behind a bar on standard
    error; it may report its share of the frame. What it or reading raises is that frame's own: the others are
    done all the same. Who interrupts it is told how many of the things `made` there are.

    Returns:
        The frames that failed, with their reasons.
    """
    problems: dict[int, InputError] = {}
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    console, done = make_console(), 0
    try:
        with Bar(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
            task = bar.add_task(title, total=len(sequence))
            for i, (_, found) in enumerate(read_ahead(sequence.paths)):
                bar.update(task, completed=i, description=sequence.labels[i])
                try:
                    if isinstance(found, InputError):
                        raise found
                    work(i, found, lambda share, i=i: bar.update(task, completed=i + share))
                    done += 1
                except InputError as error:
                    problems[i] = error
    except KeyboardInterrupt:
        if made:
            print(f"splatview: stopped; {done:,} of {len(sequence):,} {made} are written", file=sys.stderr)
        raise
    return problems


def refuse_if(problems: Mapping[int, InputError], count: int, done: str) -> None:
    """Raises InputError where frames failed, after all others."""
    if problems:
        what = f"{len(problems):,} of {count:,} frames failed"
        first = next(iter(problems.values()))
        raise InputError(f"{what}, {done}{'; the first' if len(problems) > 1 else ''}: {first}")


def describe_sequence(sequence: SceneSequence, *, as_json: bool) -> int:
    """Number and bytes of the splats of every frame, and bounds of all. Each frame is read whole: a damaged
    one is found here and not in the middle of a film."""
    frames: list[dict[str, Any]] = [{"file": str(path)} for path in sequence.paths]
    lows, highs = [], []

    def describe(i: int, found: Gaussians, _: object) -> None:
        frames[i] |= {"count": len(found), "sh_degree": found.sh_degree, "bytes": found.nbytes}
        frames[i]["file_bytes"] = file_bytes(sequence.paths[i])
        centre, radius = robust_bounds(found.means)
        lows.append(centre - radius)
        highs.append(centre + radius)

    problems = over_frames(sequence, "Reading", describe)
    for i, problem in problems.items():
        frames[i]["error"] = str(problem)
    read = [entry for entry in frames if "error" not in entry]
    counts = [entry["count"] for entry in read] or [0]
    receipt = {
        "sequence": sequence.name,
        "frames": frames,
        "count": {"min": min(counts), "max": max(counts)},
        "bytes": sum(entry["bytes"] for entry in read),
        "file_bytes": sum(entry["file_bytes"] for entry in read),
        "bounds": {"min": np.min(lows, axis=0).tolist(), "max": np.max(highs, axis=0).tolist()}
        if lows
        else None,
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


def edit_sequence(args: argparse.Namespace, sequence: SceneSequence) -> int:
    """The steps of a recipe, done to every frame. What they choose they choose in each frame anew; steps that
    name splats by their numbers are for one scene only. Frames that fail are left out and told of."""
    from splatview.edit.document import Document, exported
    from splatview.edit.operations.merge_split import Split
    from splatview.edit.recipe import check_scene, load_recipe, replay
    from splatview.renderers.cpu import CpuRenderer

    if args.dry_run or args.prices or args.json:
        raise InputError("--dry-run, --prices and --json are for one scene; name one of the sequence's files")
    recipe = load_recipe(args.recipe)
    if any(isinstance(step, Split) for step in recipe.steps):
        raise InputError(f"{args.recipe}: splits files off, the same for every frame; leave that step out")
    suffixes = tuple(known.suffix for known in FORMATS.values() if known.write)
    targets = frame_targets(args.output, sequence, suffixes)

    def edit(i: int, found: Gaussians, _: object) -> None:
        path = sequence.paths[i]
        document = Document(
            found,
            name=path.name,
            folder=recipe.folder,
            tools=CpuRenderer(),
            budget=args.memory * 2**30,
        )
        try:
            check_scene(recipe, document, any_scene=True)
            replay(recipe, document, undo=False)
            save_scene(exported(document), targets[i])
        except InputError as error:
            raise InputError(f"{path}: {error}") from None

    problems = over_frames(sequence, "Editing", edit, made="frames")
    written = len(sequence) - len(problems)
    refuse_if(problems, len(sequence), f"the other {written:,} are written")
    print(f"{args.output}: {written:,} frames", file=sys.stderr)
    return 0
