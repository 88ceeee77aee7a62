"""`splatview edit`: a recipe applied to a scene, headless, with the bytes that the window would export."""

from __future__ import annotations

import json
import os
import sys
import time
from argparse import Namespace
from dataclasses import asdict
from pathlib import Path

from splatview.cli.arguments import Parser, positive
from splatview.cli.sequence import edit_sequence, source_of
from splatview.edit.changes import Change
from splatview.edit.document import Document, exported
from splatview.edit.impact import StepImpacts, in_words
from splatview.edit.operations import OPERATIONS, Operation
from splatview.edit.operations.merge_split import Split
from splatview.edit.recipe import Recipe, check_scene, load_recipe, replay
from splatview.edit.sample_views import sample_cameras
from splatview.renderers.cpu import CpuRenderer
from splatview.scene import Gaussians, InputError
from splatview.scene.formats import check_saving, load_scene, save_scene
from splatview.scene.formats.sequence import SceneSequence
from splatview.scene.progress import Progress

VIEWS = 8
"""That a price is measured in."""

PROGRESS_SECONDS = 2.0
"""Steps that take longer say how far they are."""


def make_parser() -> Parser:
    parser = Parser(
        "edit",
        "Applies the steps of a recipe to SCENE and writes what comes of it. SCENE itself is not changed,\n"
        "unless OUT names it. Of a folder of scenes, or a glob in quotes, every frame is edited; OUT is\n"
        "then another folder, or has a place for the number: frame_%%04d.ply. The window saves recipes;\n"
        "they are JSON:\n\n"
        '  {"splatview_recipe": 1, "steps": [\n'
        '    {"op": "select", "by": {"kind": "sphere", "centre": [0, 0, 0], "radius": 2}},\n'
        '    {"op": "select_inverse"}, {"op": "delete"}]}\n\n'
        "Operations:\n" + "".join(f"  {name:16}{cls.summary}\n" for name, cls in OPERATIONS.items()),
    )
    parser.add_argument("scene", metavar="SCENE")
    parser.add_argument("--recipe", metavar="R.json", required=True, type=Path)
    parser.add_argument(
        "-o", "--output", metavar="OUT", type=Path, help="the edited scene, in the format of its suffix"
    )
    parser.add_argument(
        "--dry-run", action="store_true", help="only print what each step would do; write nothing"
    )
    parser.add_argument(
        "--any-scene", action="store_true", help="apply it although it was made for another scene"
    )
    parser.add_argument(
        "--prices",
        action="store_true",
        help=f"also tell what each step costs: how far {VIEWS} views after it are from those before",
    )
    parser.add_argument(
        "--force", action="store_true", help="let files that the recipe splits off replace existing ones"
    )
    parser.add_argument(
        "--memory",
        metavar="GIB",
        type=positive,
        default=0.0,
        help="memory that the steps may take beyond SCENE itself (default: half of what is free)",
    )
    parser.add_argument("--json", action="store_true", help="the report for scripts, on standard output")
    return parser


def run(arguments: list[str]) -> int:
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    if args.output is None and not args.dry_run:
        raise InputError("nothing to do: give -o OUT or --dry-run (see splatview edit --help)")
    source = source_of(args.scene)
    if isinstance(source, SceneSequence):
        return edit_sequence(args, source)
    if args.output is not None and not args.dry_run:
        check_saving(args.output)
    recipe = load_recipe(args.recipe)
    targets = _split_targets(recipe, args) if args.output is not None else {}
    gaussians = load_scene(source)
    parts: list[tuple[Gaussians, Path]] = []

    def hold(scene: Gaussians, path: Path) -> None:
        parts.append((scene, path))
        document.budget -= scene.nbytes

    document = Document(
        gaussians,
        name=Path(args.scene).name,
        folder=recipe.folder,
        tools=CpuRenderer(),
        save=hold,
        budget=args.memory * 2**30,
    )
    steps: list[dict[str, object]] = []
    prices = None
    if args.prices:
        prices = StepImpacts(document, sample_cameras(gaussians, document.edits, VIEWS))

    def report(number: int, operation: Operation, change: Change) -> None:
        steps.append({"op": operation.op, "title": change.title, "count": change.count})
        notes = list(change.notes)
        if prices is not None:
            price = prices.after_step()
            notes.append(in_words(price))
            steps[-1]["price"] = asdict(price)
        out = sys.stdout if args.dry_run and not args.json else sys.stderr
        print(f"step {number} of {len(recipe.steps)}: {change.title}", file=out)
        for note in notes:
            print(f"  {note}", file=out)

    try:
        check_scene(recipe, document, any_scene=args.any_scene)
        replay(recipe, document, on_step=report, progress=Progress(report=_printer()), undo=False)
        scene = exported(document)
    except InputError as error:
        raise InputError(f"{args.recipe}: {error}") from None
    if args.output is not None and not args.dry_run:
        _write(scene, args.output, [(part, targets[path]) for part, path in parts])
    summary = {"scene": args.scene, "count": len(gaussians), "kept": len(scene), "steps": steps}
    if args.json:
        print(json.dumps(summary, indent=1))
    elif args.dry_run:
        print(f"{len(scene):,} of {len(gaussians):,} splats would be written")
    else:
        print(f"{args.output}: {len(scene):,} of {len(gaussians):,} splats", file=sys.stderr)
    return 0


def _split_targets(recipe: Recipe, args: Namespace) -> dict[Path, Path]:
    """The files that steps of the recipe name -> where they are written: in the folder of OUT.

    Recipes come from strangers: none may write elsewhere, over SCENE, or over another file unasked.

    Raises:
        InputError: a step would.
    """
    targets = {}
    folder = args.output.absolute().parent
    real_folder = Path(os.path.realpath(folder))
    for number, step in enumerate(recipe.steps, 1):
        if not isinstance(step, Split):
            continue
        where = f"{args.recipe}: step {number} (split): {step.path}"
        target = folder / step.path
        if not Path(os.path.realpath(target)).is_relative_to(real_folder):
            raise InputError(f"{where}: is outside {folder}, where OUT is; name a file in that folder")
        if os.path.exists(target) and os.path.exists(args.scene) and target.samefile(args.scene):
            raise InputError(f"{where}: is SCENE itself; give another name in the recipe")
        if os.path.lexists(target) and not args.force:
            raise InputError(f"{where}: exists already in {folder}; remove it, or overwrite it with --force")
        targets[Path(recipe.folder or os.curdir, step.path)] = target
    return targets


def _write(scene: Gaussians, output: Path, parts: list[tuple[Gaussians, Path]]) -> None:
    """All files, only now that nothing can go wrong with the steps any more."""
    paths = [output, *(path for _, path in parts)]
    if len(set(map(os.path.realpath, paths))) < len(paths):
        raise InputError(f"{output}: two of the recipe's files would have one name")
    for path in paths:
        check_saving(path)
    for part, path in parts:
        save_scene(part, path)
        print(f"{path}: {len(part):,} splats split off", file=sys.stderr)
    save_scene(scene, output)


def _printer():
    """A progress callback that prints every PROGRESS_SECONDS."""
    last = time.monotonic()

    def progress(share: float) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= PROGRESS_SECONDS:
            last = now
            print(f"{share:.0%} done", file=sys.stderr)

    return progress
