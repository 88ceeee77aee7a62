"""`splatview stability`: hard cases on every renderer of this machine, against the float64 reference."""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table

from splatview.cli.arguments import Parser
from splatview.cli.main import make_console
from splatview.cli.render import write_picture
from splatview.measure.hard_cases import CASES, find_case
from splatview.measure.hard_cases.case import HardCase
from splatview.measure.hard_cases.run import (
    CaseRenderer,
    CaseResult,
    Precision,
    draw_case,
    error_of,
    run_case,
)
from splatview.measure.machine import describe_machine
from splatview.renderers import BACKENDS, FrameRequest, Renderer, choices, make_renderer, on_this_gl
from splatview.renderers.cpu import ReferenceRenderer
from splatview.renderers.gl import context
from splatview.renderers.headless import announce_compiling
from splatview.scene import Camera, Gaussians, InputError, RenderSettings

NAMES = choices("stability")

PRECISIONS: tuple[Precision, ...] = ("float32", "float16")
"""Precisions of blending that the catalogue has bounds for."""

GL_NAMES = tuple(name for name in NAMES if BACKENDS[name].gl_version is not None)


@contextmanager
def case_renderers(names: Sequence[str] = NAMES) -> Iterator[list[CaseRenderer]]:
    """The backends called `names`, each in every precision that the catalogue knows of; freed at the end.

    Raises:
        InputError: one of them needs OpenGL, and there is none.
    """
    made: dict[str, Renderer] = {}
    ctx = context.create_headless_context() if any(name in GL_NAMES for name in names) else None
    try:
        for name in names:
            backend = BACKENDS[name] if ctx is None else on_this_gl(name, ctx)
            old = ctx is not None and (backend.gl_version or 0) > ctx.version_code
            if backend.name not in made and not old and name != "reference":
                made[backend.name] = make_renderer(backend.name, ctx)
        cases = [
            case_renderer(name, renderer, blend)
            for name, renderer in made.items()
            for blend in PRECISIONS
            if blend in renderer.capabilities.precisions
        ]
        if "reference" in names:
            for dtype in (np.float64, np.float32):
                name = f"reference {np.dtype(dtype)}"
                cases.append(case_renderer(name, ReferenceRenderer(dtype), "float32"))
        yield cases
    finally:
        for renderer in made.values():
            renderer.close()
        if ctx is not None:
            ctx.release()


def case_renderer(name: str, renderer: Renderer, blend: Precision) -> CaseRenderer:
    """The renderer as the catalogue takes it."""

    def draw(gaussians: Gaussians, camera: Camera, settings: RenderSettings) -> np.ndarray:
        return renderer.render(FrameRequest(gaussians, camera, settings))

    return CaseRenderer(name=name, blend=blend, draw=draw)


def describe_gl() -> dict[str, str]:
    """Vendor, renderer and version of the OpenGL that is tested. Raises InputError where there is none."""
    ctx = context.create_headless_context()
    info = context.describe(ctx)
    context.discard(ctx)
    return {"vendor": info.vendor, "renderer": info.renderer, "version": info.version}


# ---- Pictures of a hard case for the eye: the reference, what a renderer made, and where they differ.


LONG_SIDE = 480
"""px at least: the pictures of cases are a few dozen pixels, each is shown as a square."""


def make_folder(folder: Path) -> None:
    """Raises InputError where there can be no such folder."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made ({error.strerror})") from error


def save_case(case: HardCase, renderers: list[CaseRenderer], folder: Path) -> list[Path]:
    """Writes reference, result and difference of every picture of `case`; returns the paths.

    In the difference white is the case's bound, or more.
    """
    written: list[Path] = []

    def write(image: np.ndarray, *words: str) -> None:
        path = folder / f"{'_'.join(file_word(word) for word in words if word)}.png"
        if path not in written:
            write_picture(enlarged_whole(image), path)
            written.append(path)

    for settings in case.settings:
        for index in range(len(case.cameras)):
            view = str(index) if len(case.cameras) > 1 else ""
            for renderer in renderers:
                drawn = draw_case(case, renderer, settings, index)
                write(drawn.truth, case.name, settings, view, "reference")
                words = (case.name, settings, view, renderer.name, renderer.blend)
                write(drawn.image, *words, "result")
                if drawn.image.shape == drawn.truth.shape:
                    error = error_of(drawn.image, drawn.truth, renderer.blend) / drawn.bound
                    shown = np.repeat(np.where(np.isfinite(error), error, 1.0)[..., None], 4, axis=2)
                    write(shown, *words, "difference")
    return written


def file_word(words: str) -> str:
    """As part of a file's name on any system."""
    return re.sub(r"[^\w.+-]+", "-", words).strip("-")


def enlarged_whole(image: np.ndarray) -> np.ndarray:
    """`image` (h, w, 4) float32 with each pixel a square, so that the longer side has LONG_SIDE px or more;
    what is not finite becomes magenta."""
    factor = max(1, -(-LONG_SIDE // max(image.shape[:2])))
    shown = np.where(np.isfinite(image).all(axis=2, keepdims=True), image, (1.0, 0.0, 1.0, 1.0))
    return shown.astype(np.float32).repeat(factor, axis=0).repeat(factor, axis=1)


EXIT_FAILED = 1


def make_parser() -> Parser:
    parser = Parser(
        "stability",
        f"Draws {len(CASES)} hard cases (NaN, needles, splats on the near plane, ...) with every renderer\n"
        "that works here, on this machine's own GPU and driver, and compares each picture with the float64\n"
        "reference. Exit code 1 if a case fails.",
    )
    parser.add_argument(
        "--renderer", choices=NAMES, metavar="R", help=f"only this one: {', '.join(NAMES)} (default: all)"
    )
    parser.add_argument("--case", metavar="NAME", help="only this case")
    parser.add_argument(
        "--save",
        type=Path,
        metavar="DIR",
        help="write reference, result and difference of --case, or of the cases that fail",
    )
    parser.add_argument("--all", action="store_true", help="a line for every case, not only for every theme")
    parser.add_argument("--list", action="store_true", help="print the cases and what is hard about them")
    parser.add_argument("--json", action="store_true", help="results as one JSON object")
    return parser


def run(arguments: list[str]) -> int:
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    cases = [find_case(args.case)] if args.case is not None else list(CASES)
    if args.list:
        print_cases(cases, as_json=args.json)
        return 0
    if args.save is not None:
        make_folder(args.save)
    names = (args.renderer,) if args.renderer else working_renderers()
    for name in names:
        announce_compiling(name)
    written: list[Path] = []
    with case_renderers(names) as renderers:
        if not renderers:
            raise InputError(f"--renderer {args.renderer} does not work with the OpenGL here")
        results = run_with_progress(cases, renderers)
        if args.save is not None:
            failed = {id(result.case) for result in results if not result.passed}
            for case in cases:
                if args.case is not None or id(case) in failed:
                    written += save_case(case, renderers, args.save)
    if args.json:
        print(json.dumps(as_json(results, names)))
    else:
        print_results(make_console(stderr=False), results, every=args.all or args.case is not None)
    if args.save is not None:
        print(f"{args.save}: {len(written)} pictures", file=sys.stderr)
    return 0 if all(result.passed for result in results) else EXIT_FAILED


def working_renderers() -> tuple[str, ...]:
    """Those that can be had here; says on standard error which cannot."""
    try:
        describe_gl()
    except InputError as error:
        print(f"splatview: only the renderers without OpenGL are tested: {error}", file=sys.stderr)
        return tuple(name for name in NAMES if name not in GL_NAMES)
    return NAMES


def run_with_progress(cases: Sequence[HardCase], renderers: Sequence[CaseRenderer]) -> list[CaseResult]:
    results: list[CaseResult] = []
    columns = (BarColumn(), MofNCompleteColumn(), TextColumn("{task.description}", markup=False))
    with Progress(*columns, console=make_console(), transient=True) as progress:
        task = progress.add_task("", total=len(cases))
        for case in cases:
            progress.update(task, description=case.name)
            for renderer in renderers:
                results += run_case(case, renderer)
            progress.advance(task)
    return results


def as_json(results: Sequence[CaseResult], names: Sequence[str]) -> dict[str, Any]:
    return {
        "machine": describe_machine(),
        "opengl": describe_gl() if any(name in GL_NAMES for name in names) else None,
        "passed": sum(result.passed for result in results),
        "failed": sum(not result.passed for result in results),
        "cases": [
            {
                "case": result.case.name,
                "theme": result.case.theme,
                "renderer": result.renderer,
                "settings": result.settings,
                "passed": result.passed,
                # JSON has no NaN and no infinity.
                "error": result.error if math.isfinite(result.error) else None,
                "bound": result.bound,
                "not_finite": result.not_finite,
                "excluded": result.excluded,
                "failures": list(result.failures),
            }
            for result in results
        ],
    }


def print_results(console: Console, results: Sequence[CaseResult], *, every: bool) -> None:
    """Failures first, then the themes, or every row."""
    failed = [result for result in results if not result.passed]
    if failed:
        console.print(rows_table("Failed", failed, "bold red"))
    if every:
        passed = [result for result in results if result.passed]
        if passed:
            console.print(rows_table("Passed", passed))
    else:
        console.print(themes_table(results))
    if every and len({result.case.name for result in results}) == 1:
        console.print(f"{results[0].case.what}")
    if any(result.excluded for result in results):
        console.print("Left out: pixels where an alpha sits on its cut or depths tie.")
    cases = len({result.case.name for result in results})
    renderers = len({result.renderer for result in results})
    counted = f"{cases} case{'s' * (cases > 1)} on {renderers} renderer{'s' * (renderers > 1)}"
    said, style = (f"{len(failed)} of {len(results)} failed", "red") if failed else ("all passed", "green")
    console.print(f"{counted}, {len(results)} comparisons: {said}", style=style)


def rows_table(title: str, results: Sequence[CaseResult], style: str | None = None) -> Table:
    table = Table("case", "renderer", "settings", title=title, title_style=style, title_justify="left")
    for column in ("error", "bound", "left out"):
        table.add_column(column, justify="right", no_wrap=True)
    wrong = any(result.failures for result in results)
    if wrong:
        table.add_column("what is wrong")
    for result in results:
        table.add_row(
            result.case.name,
            result.renderer,
            result.settings,
            f"{result.error:.1e}",
            f"{result.bound:.1e}",
            str(result.excluded or ""),
            *(["; ".join(result.failures)] if wrong else []),
        )
    return table


def themes_table(results: Sequence[CaseResult]) -> Table:
    """A line a theme: how many rows passed, and the largest errors by precision."""
    table = Table(title="Hard cases by theme, and their largest errors", title_justify="left")
    table.add_column("theme", no_wrap=True)
    for column in ("cases", "passed", "float32", "float16", "left out"):
        table.add_column(column, justify="right", no_wrap=True)
    for theme, cells in theme_cells(results):
        passed = all(result.passed for result in results if result.case.theme == theme)
        table.add_row(theme, *cells, style=None if passed else "red")
    return table


def theme_cells(results: Sequence[CaseResult]) -> list[tuple[str, list[str]]]:
    """By theme: cases, rows passed, largest error in float32 and in float16, pixels left out."""
    lines = []
    for theme in dict.fromkeys(result.case.theme for result in results):
        here = [result for result in results if result.case.theme == theme]
        passed = sum(result.passed for result in here)
        worst = []
        for blend in ("float32", "float16"):
            errors = [result.error for result in here if result.settings.endswith(blend)]
            worst.append(f"{np.max(errors):.1e}" if errors else "")
        count = len({result.case.name for result in here})
        excluded = sum(result.excluded for result in here)
        lines.append((theme, [str(count), f"{passed} of {len(here)}", *worst, str(excluded or "")]))
    return lines


def print_cases(cases: Sequence[HardCase], *, as_json: bool) -> None:
    if as_json:
        print(json.dumps([{"case": c.name, "theme": c.theme, "what": c.what} for c in cases]))
        return
    table = Table("theme", "case", "what is hard")
    for case in cases:
        table.add_row(case.theme, case.name, case.what)
    make_console(stderr=False).print(table)
