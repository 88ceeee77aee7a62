"""`splatview [SCENE ...]`: the window, or a preview picture where there is no display."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from splatview.cli.arguments import DEFAULT_SIZE, Parser
from splatview.cli.main import no_window
from splatview.cli.render import check_output, write_picture
from splatview.renderers import FrameRequest, Renderer, choices
from splatview.renderers.headless import make_headless
from splatview.scene import Camera, Gaussians, InputError, concatenate
from splatview.scene import first_view as framing
from splatview.scene.effects.overrides import settings_for
from splatview.scene.formats import check_opening, load_scene
from splatview.scene.formats.sequence import SceneSequence, is_glob, read_ahead, resolve_all

if TYPE_CHECKING:
    from splatview.viewer.training.start import StartedTraining

DEFAULT_PREVIEW = Path("splatview-preview.png")


def run(arguments: list[str]) -> int:
    parser = Parser("", "Opens scenes in a window.", usage="splatview [SCENE ...] [options]")
    parser.add_argument("scenes", nargs="*", type=Path, metavar="SCENE")
    parser.add_argument("--renderer", choices=("auto", *choices("window")), default="auto")
    parser.add_argument("--merge", action="store_true", help="one scene of all, also where they are frames")
    parser.add_argument("-o", "--output", type=Path, default=DEFAULT_PREVIEW, metavar="FILE.png")
    args = parser.parse(arguments)
    if args is None:
        return 0
    for path in args.scenes:
        # os.path: unlike Path.exists it takes names that no file system would.
        if not os.path.lexists(path) and not is_glob(path):
            hint = "" if path.suffix or len(path.parts) > 1 else ", nor a command; see splatview --help"
            raise InputError(f"{path}: no such file{hint}")
    found = resolve_all(args.scenes, merge=args.merge)
    if not isinstance(found, SceneSequence):
        for path in found:
            check_opening(path)
    problem = no_window()
    if problem is None:
        from splatview.viewer.app import run_window

        return run_window(args.scenes, renderer=args.renderer, merge=args.merge, starter=start_training)
    check_output(args.output, (".png",))
    gaussians, camera = first_view(found)
    print(f"splatview: {problem}; writing a preview to {args.output} instead", file=sys.stderr)
    drawing = preview_renderer(args.renderer)
    request = FrameRequest(gaussians, camera, settings_for(gaussians))
    write_picture(drawing.render(request), args.output)
    print(f"{args.output}: {camera.width}x{camera.height}, by {drawing.name}", file=sys.stderr)
    return 0


def start_training(arguments: Sequence[str], report: Callable[[str], None]) -> StartedTraining:
    """A `viewer.training.start.Starter`."""
    from splatview.cli.train import start_from_window  # torch and numba come with it

    return start_from_window(arguments, report)


def first_view(paths: list[Path] | SceneSequence) -> tuple[Gaussians, Camera]:
    """The scenes, merged, or the first frame that can be read, or the demo; and a camera that shows it."""
    width, height = DEFAULT_SIZE
    if isinstance(paths, SceneSequence):
        frames = (found for _, found in read_ahead(paths.paths))
        first = next((found for found in frames if not isinstance(found, InputError)), None)
        if first is None:
            raise InputError(f"{paths.name}: none of its {len(paths):,} frames can be read")
        return first, framing.first_view(first, width, height).camera
    if not paths:
        from splatview.renderers.demo_cache import cached_demo
        from splatview.scene.demo import demo_camera

        return cached_demo(), demo_camera(width, height)
    gaussians = concatenate([load_scene(path) for path in paths])
    return gaussians, framing.first_view(gaussians, width, height).camera


def preview_renderer(name: str) -> Renderer:
    """`quads` by EGL unless another is asked for; where there is no EGL, `cpu`, saying so."""
    try:
        return make_headless("quads" if name == "auto" else name)
    except InputError as error:
        if name != "auto":
            raise
        print(f"splatview: {error}; rendering on the CPU", file=sys.stderr)
        return make_headless("cpu")
