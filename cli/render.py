"""`splatview render`: a scene to a picture file, headless."""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as numpy_format

from splatview.cli.arguments import HELP as BACKGROUND_HELP
from splatview.cli.arguments import (
    Orbit,
    Parser,
    add_camera_options,
    add_knob_options,
    background,
    check_camera_options,
    check_knob_options,
    chosen_background,
    chosen_orbit,
    chosen_plan,
    count,
    knob_choices,
    not_negative,
    number,
    positive,
)
from splatview.cli.sequence import frame_targets, over_frames, refuse_if, source_of
from splatview.measure.knobs import Plan, path_to_view
from splatview.renderers import MODES, FrameRequest, Renderer, choices
from splatview.renderers.headless import make_headless
from splatview.renderers.quality import reduced
from splatview.scene import Camera, Gaussians, InputError, RenderSettings
from splatview.scene.depth_of_field import Aperture, check_camera, mean_picture
from splatview.scene.effects.overrides import settings_for
from splatview.scene.formats import load_scene
from splatview.scene.formats.io import atomic_write, target_of
from splatview.scene.formats.sequence import SceneSequence

# ---- Pictures to files: checked before the work, written whole or not at all.


SUFFIXES = (".png", ".npy")


def check_output(path: Path, suffixes: tuple[str, ...] = SUFFIXES) -> None:
    """Raises InputError where `path` could not be written, so that nobody waits for a picture in vain."""
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: pictures are written as {' or '.join(suffixes)}; give it that suffix")
    target_of(path)


def write_picture(image: np.ndarray, path: Path, *, alpha: bool = False) -> None:
    """Writes `image` (H, W, 4) float32 by the suffix: .npy as it is, .png as `eight_bit` makes it.

    Raises:
        InputError: the system refuses.
    """
    with atomic_write(path) as file:
        if path.suffix.lower() == ".npy":
            # np.save would write past the file object, and say of a full disk how many numbers went missing.
            image = np.ascontiguousarray(image)
            numpy_format.write_array_header_1_0(file, numpy_format.header_data_from_array_1_0(image))
            file.write(image.data)
        else:
            from PIL import Image

            Image.fromarray(eight_bit(image, alpha=alpha)).save(file, format="PNG")


def eight_bit(image: np.ndarray, *, alpha: bool = False) -> np.ndarray:
    """(H, W, 4) float -> uint8: RGB clipped to [0, 1] and rounded to nearest.

    With `alpha` (the picture has a black background) RGBA not premultiplied, as PNG wants it.
    """
    shown = image[..., :3]
    if alpha:
        cover = image[..., 3:]
        shown = np.divide(shown, cover, out=np.zeros_like(shown), where=cover > 0)
        shown = np.concatenate([shown, cover], axis=-1)
    return np.floor(np.clip(shown, 0, 1) * 255 + 0.5).astype(np.uint8)


WARM_UP_TURN = -1.0
"""Degrees by which the frame before the measured ones differs, so that nothing of it can be kept."""

LENS_SAMPLES = 64
"""Some 53 dB where the blur is 34 px wide, see `scene.aperture`."""


def make_parser() -> Parser:
    parser = Parser(
        "render",
        "Renders SCENE without a window.\n\n"
        "A .png is 8-bit RGB; a .npy is float32 (height, width, 4), RGB over the background and alpha.\n"
        "What the scene calls for (antialiased opacity, discs, SH degree) is read from it; options override."
        "\n\nA folder of scenes, or a glob in quotes ('frames/*.ply'), is a sequence: a picture of each\n"
        "frame by one camera. OUT is then a folder, or has a place for the number: frame_%%04d.png.",
    )
    parser.add_argument("scene", metavar="SCENE")
    parser.add_argument("-o", "--output", type=Path, metavar="OUT", help="picture to write, .png or .npy")
    add_camera_options(parser)
    add_picture_options(parser).add_argument(
        "--alpha", action="store_true", help="a .png with transparency instead of a background"
    )
    add_knob_options(parser)
    group = parser.add_argument_group("measuring")
    group.add_argument("--stats", action="store_true", help="print times and counts as one JSON object")
    group.add_argument("--frames", type=count, default=1, metavar="N", help="render N frames, write the last")
    group.add_argument(
        "--turn",
        type=number,
        default=0.0,
        metavar="DEG",
        help="turn the eye about the target before each (of a sequence: before each after the first)",
    )
    return parser


def add_picture_options(parser: Parser) -> argparse._ArgumentGroup:
    """What `chosen_settings` and `chosen_aperture` read, background, renderer and mode; returns the group of
    what a picture is."""
    lens = parser.add_argument_group("depth of field (off where no aperture is given)")
    lens.add_argument("--aperture", type=positive, metavar="A", help="diameter of the lens, world units")
    lens.add_argument("--focus", type=positive, metavar="D", help="distance that is sharp, world units")
    lens.add_argument(
        "--lens-samples",
        type=count,
        metavar="N",
        help=f"pictures averaged, each from a point of the lens (default: {LENS_SAMPLES})",
    )
    group = parser.add_argument_group("picture")
    group.add_argument("--background", type=background, metavar="BACK", help=BACKGROUND_HELP)
    group.add_argument("--renderer", choices=("auto", *choices("render")), default="auto")
    group.add_argument(
        "--mode",
        choices=tuple(MODES),
        default="splats",
        help="what of the scene is drawn: every one by quads and cpu",
    )
    group.add_argument(
        "--antialiased",
        action=argparse.BooleanOptionalAction,
        help="opacity made up for the blur (default: as the file says)",
    )
    group.add_argument(
        "--footprint",
        choices=("auto", "ellipsoid", "disc"),
        default="auto",
        help="solid splats, or flat ones that each pixel's ray meets (default: auto, as the file says)",
    )
    group.add_argument("--blur", type=not_negative, metavar="PX2", help="variance added to footprints")
    group.add_argument("--near", type=positive, metavar="Z", help="nearest depth drawn (default: 0.01)")
    return group


def run(arguments: list[str]) -> int:
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    check_camera_options(args)
    source = source_of(args.scene)
    is_sequence = isinstance(source, SceneSequence)
    check_picture_options(args, is_sequence=is_sequence)
    if is_sequence:
        return render_sequence(args, source)
    behind = chosen_background(args.background, args.up)
    gaussians = load_scene(source)
    orbit = chosen_orbit(args, gaussians)
    aperture = chosen_aperture(args, orbit.camera)
    renderer = make_headless(args.renderer, mode=args.mode, knobs=knob_choices(args))
    settings = replace(chosen_settings(args, gaussians), background=behind)
    plan = chosen_plan(args, settings, renderer.name)
    image, stats = render_frames(args, renderer, gaussians, orbit, plan, aperture)
    if args.output:
        write_picture(image, args.output, alpha=args.alpha)
        print(f"{args.output}: {image.shape[1]}x{image.shape[0]}, by {renderer.name}", file=sys.stderr)
    if args.stats:
        print(json.dumps(stats))
    return 0


def render_sequence(args: argparse.Namespace, sequence: SceneSequence) -> int:
    """A picture of each frame by one camera, that of the first frame; with --turn the eye goes on by as much
    before each one that follows. Frames that cannot be read are left out and told of at the end."""
    if args.stats or args.frames != 1:
        raise InputError("--stats and --frames measure one scene; name one of the sequence's files")
    behind = chosen_background(args.background, args.up)
    targets = frame_targets(args.output, sequence, SUFFIXES)
    renderer = make_headless(args.renderer, mode=args.mode, knobs=knob_choices(args))
    still = argparse.Namespace(**{**vars(args), "turn": 0.0})
    orbit: Orbit | None = None

    def draw(i: int, found: Gaussians, _: object) -> None:
        nonlocal orbit
        orbit = orbit or chosen_orbit(args, found)
        camera = orbit.turned(args.turn * i) if args.turn else orbit.camera
        settings = replace(chosen_settings(args, found), background=behind)
        plan = chosen_plan(args, settings, renderer.name)
        aperture = chosen_aperture(args, camera)
        here = replace(orbit, camera=camera)
        image, _ = render_frames(still, renderer, found, here, plan, aperture)
        write_picture(image, targets[i], alpha=args.alpha)

    problems = over_frames(sequence, "Rendering", draw, made="pictures")
    written = len(sequence) - len(problems)
    refuse_if(problems, len(sequence), f"the other {written:,} are rendered")
    size = f"{orbit.camera.width}x{orbit.camera.height}" if orbit else ""
    print(f"{args.output}: {written:,} pictures, {size}, by {renderer.name}", file=sys.stderr)
    return 0


def check_picture_options(args: argparse.Namespace, *, is_sequence: bool = False) -> None:
    """Raises InputError for what cannot work, before anything is loaded. Where a sequence's pictures go is
    left to `render_sequence`."""
    if args.output is None and not args.stats:
        raise InputError("nothing to do: give -o OUT.png or --stats (see splatview render --help)")
    if args.output is not None and not is_sequence:
        check_output(args.output)
    if args.alpha:
        folder = is_sequence and args.output is not None and not args.output.suffix
        if args.output is None or not (folder or args.output.suffix.lower() == ".png"):
            raise InputError("--alpha is for .png files; a .npy always has alpha")
        if args.background is not None:
            raise InputError("--alpha leaves the background out; drop --background or --alpha")
    check_drawing_options(args)


def check_drawing_options(args: argparse.Namespace) -> None:
    """Raises InputError for what of `add_picture_options` and the shortcuts cannot work."""
    if args.aperture is not None and args.focus is None:
        raise InputError("--aperture needs --focus, the distance that is sharp")
    if args.aperture is None and (args.focus is not None or args.lens_samples is not None):
        raise InputError("--focus and --lens-samples go with --aperture, the diameter of the lens")
    backends = MODES[args.mode].backends
    if args.renderer not in ("auto", *backends):
        raise InputError(f"--mode {args.mode} needs --renderer {' or '.join(backends)}")
    check_knob_options(args)


def chosen_settings(args: argparse.Namespace, gaussians: Gaussians) -> RenderSettings:
    """What the scene calls for, with the options' changes; the background apart."""
    settings = settings_for(gaussians)
    changes: dict[str, Any] = {
        name: value
        for name, value in (
            ("antialiased", args.antialiased),
            ("blur", args.blur),
            ("near", args.near),
        )
        if value is not None
    }
    model = settings.model if args.footprint == "auto" else settings.model.with_footprint(args.footprint)
    settings = replace(settings, model=replace(model, **changes))
    # The truth leaves out nothing, not even what cannot be seen.
    if args.sh_degree is not None or args.renderer == "reference":
        settings = replace(settings, sh_degree=None)
    return settings


def chosen_aperture(args: argparse.Namespace, camera: Camera) -> Aperture | None:
    """The lens that was asked for, or None. Raises InputError where this camera can have none."""
    if args.aperture is None:
        return None
    check_camera(camera)
    return Aperture(diameter=args.aperture, focus=args.focus)


def render_frames(
    args: argparse.Namespace,
    renderer: Renderer,
    gaussians: Gaussians,
    orbit: Orbit,
    plan: Plan,
    aperture: Aperture | None = None,
) -> tuple[np.ndarray, dict[str, Any]]:
    """The last picture, and the figures of all. Times are wall-clock up to the pixels in memory.

    Of a picture through a lens, counts and stages are those of its last part.
    With --stats one frame is drawn first and not counted: it compiles and allocates.
    """

    if args.stats:
        draw_picture(args, renderer, gaussians, orbit.turned(WARM_UP_TURN), plan)
    image = np.empty(0, np.float32)
    totals: list[float] = []
    stages: dict[str, list[float]] = {}
    visible = 0
    path = [args.turn * frame for frame in range(1, args.frames + 1)]
    if args.frames == 1 and not args.turn:
        path = path_to_view(plan.settings)
    renderer.forget_order()
    for degrees in path:
        camera = orbit.turned(degrees) if degrees else orbit.camera
        start = time.perf_counter()
        image = draw_picture(args, renderer, gaussians, camera, plan, aperture)
        totals.append(1e3 * (time.perf_counter() - start))
        if args.stats:
            latest = renderer.stats(wait=True)
            visible = latest.visible
            for stage, value in latest.ms.items():
                stages.setdefault(stage, []).append(value)
    ms = {
        "total": statistics.median(totals),
        "min": min(totals),
        "max": max(totals),
        "stages": {stage: statistics.median(values) for stage, values in stages.items()},
    }
    return image, {
        "renderer": renderer.name,
        "size": [orbit.camera.width, orbit.camera.height],
        "splats": len(gaussians),
        "visible": visible,
        "frames": len(path),
        "ms": ms,
    }


def draw_picture(
    args: argparse.Namespace,
    renderer: Renderer,
    gaussians: Gaussians,
    camera: Camera,
    plan: Plan,
    aperture: Aperture | None = None,
) -> np.ndarray:
    """(H, W, 4) float32: one picture, of a pinhole or the mean of many from all over a lens."""

    def draw(camera: Camera) -> np.ndarray:
        request = FrameRequest.by_plan(gaussians, camera, plan, mode=args.mode)
        return renderer.render(reduced(request)).astype(np.float32, copy=False)

    if aperture is None:
        return draw(camera)
    return mean_picture(draw, camera, aperture, args.lens_samples or LENS_SAMPLES)
