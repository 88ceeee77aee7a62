"""`splatview film`: a camera's way through a scene to a video, a GIF or a folder of pictures, headless."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.progress import Progress as Bar

from splatview.cli.arguments import (
    DEFAULT_FOV,
    DEFAULT_SIZE,
    MAX_PIXELS,
    NO_LENS_OPTION,
    Orbit,
    Parser,
    add_camera_options,
    add_knob_options,
    check_camera_options,
    chosen_background,
    chosen_orbit,
    chosen_plan,
    knob_choices,
    positive,
)
from splatview.cli.main import make_console
from splatview.cli.render import (
    add_picture_options,
    check_drawing_options,
    chosen_aperture,
    chosen_settings,
    draw_picture,
    eight_bit,
)
from splatview.cli.sequence import over_frames, refuse_if, source_of
from splatview.renderers.headless import make_headless
from splatview.scene import Camera, Gaussians, InputError
from splatview.scene.camera import orbited
from splatview.scene.camera_path import TURNTABLE_SECONDS, CameraPath, frame_times
from splatview.scene.camera_path_files import load_camera_path
from splatview.scene.film import CODECS, Write, check_film, film_writer
from splatview.scene.first_view import turntable_view
from splatview.scene.formats import load_scene
from splatview.scene.formats.sequence import SceneSequence

DEFAULT_FPS = 30.0

MOST_FRAMES = 1_000_000


def make_parser() -> Parser:
    parser = Parser(
        "film",
        "Renders SCENE along the way of a camera, by the same renderers as splatview render.\n\n"
        "The way is that of a file (--path): one that the window's Film panel saved, nerfstudio's\n"
        "camera_path.json, or an animation of SuperSplat's experience settings. Without one the camera goes\n"
        "round the scene once, evenly (--turntable), from the camera of the options below.\n\n"
        "OUT is a .mp4, a .webm or a .gif, which need PyAV (pip install av), or a name without suffix: a\n"
        "new folder, for frame_00001.png and so on, whose pictures are the same to the bit each time.\n\n"
        "Of a sequence (a folder of scenes, or a glob in quotes) each scene is a frame of the film.",
    )
    parser.add_argument("scene", metavar="SCENE")
    parser.add_argument("-o", "--output", type=Path, metavar="OUT", required=True, help="the film to write")
    group = parser.add_argument_group("film")
    way = group.add_mutually_exclusive_group()
    way.add_argument("--path", type=Path, metavar="FILE.json", help="the camera's way")
    way.add_argument(
        "--turntable", action="store_true", help="once round what the first view shows (without --path)"
    )
    group.add_argument(
        "--seconds",
        type=positive,
        metavar="S",
        help=f"length (default: the path's; {TURNTABLE_SECONDS:g} for a turntable)",
    )
    group.add_argument(
        "--fps", type=positive, help=f"frames a second (default: the path file's, or {DEFAULT_FPS:g})"
    )
    group.add_argument(
        "--codec",
        choices=CODECS,
        help="of a video (default: av1 in .mp4, vp9 in .webm); h264 plays everywhere, and has patents",
    )
    add_camera_options(parser)
    add_picture_options(parser)
    add_knob_options(parser)
    return parser


def run(arguments: list[str]) -> int:
    args = make_parser().parse(arguments)
    if args is None:
        return 0
    check_camera_options(args)
    check_drawing_options(args)
    source = source_of(args.scene)
    sequence = source if isinstance(source, SceneSequence) else None
    if sequence is not None and args.seconds is not None:
        raise InputError("--seconds is for one scene: a sequence lasts its frames; choose --fps")
    path, fps = path_of_file(args) if args.path is not None else (None, args.fps or DEFAULT_FPS)
    size = args.size or DEFAULT_SIZE
    check_film(args.output, size=size, fps=fps, codec=args.codec)
    behind = chosen_background(args.background, args.up)
    gaussians = load_scene(source.paths[0] if isinstance(source, SceneSequence) else source)
    count = None if sequence is None else len(sequence)
    if path is not None:
        cameras = path_cameras(path, fps, size, count)
    else:
        seconds = (args.seconds or TURNTABLE_SECONDS) if count is None else count / fps
        cameras = turntable_cameras(turntable_orbit(args, gaussians), seconds, fps)
        size = cameras[0].width, cameras[0].height  # a camera file may have its own
    renderer = make_headless(args.renderer, mode=args.mode, knobs=knob_choices(args))
    chosen_aperture(args, cameras[0])

    def picture(scene: Gaussians, camera: Camera) -> np.ndarray:
        settings = replace(chosen_settings(args, scene), background=behind)
        plan = chosen_plan(args, settings, renderer.name)
        return eight_bit(draw_picture(args, renderer, scene, camera, plan, chosen_aperture(args, camera)))

    problems: dict[int, InputError] = {}
    try:
        with film_writer(args.output, size=size, fps=fps, codec=args.codec) as write:
            if sequence is not None:
                problems = film_sequence(sequence, cameras, picture, write)
            else:
                film_scene(gaussians, cameras, picture, write)
    except KeyboardInterrupt:
        print(f"splatview: stopped; {args.output} is not written", file=sys.stderr)
        raise
    refuse_if(problems, len(cameras), "in their place the frame before is shown")
    length = f"{len(cameras):,} frames, {len(cameras) / fps:.4g} s"
    print(f"{args.output}: {length} of {size[0]}x{size[1]}, by {renderer.name}", file=sys.stderr)
    return 0


Draw = Callable[[Gaussians, Camera], np.ndarray]
"""(H, W, 3) uint8 picture of a scene."""


def film_scene(gaussians: Gaussians, cameras: list[Camera], picture: Draw, write: Write) -> None:
    """A frame by each of the cameras, behind a bar on standard error."""
    console = make_console()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    left = TimeRemainingColumn()
    with Bar(*columns, left, console=console, transient=True, disable=not console.is_terminal) as bar:
        for camera in bar.track(cameras, description="Filming"):
            write(picture(gaussians, camera))


def film_sequence(
    sequence: SceneSequence, cameras: list[Camera], picture: Draw, write: Write
) -> dict[int, InputError]:
    """Each scene of the sequence by the camera of its number. In place of one that cannot be read the picture
    before is shown, so that time goes on; these are returned with their reasons."""
    shown: np.ndarray | None = None
    written = 0

    def draw(i: int, found: Gaussians, _: object) -> None:
        nonlocal shown, written
        latest = picture(found, cameras[i])
        for _ in range(written, i):
            write(latest if shown is None else shown)
        write(latest)
        shown, written = latest, i + 1

    problems = over_frames(sequence, "Filming", draw)
    for _ in range(written, len(cameras)):
        if shown is not None:
            write(shown)
    return problems


def path_cameras(path: CameraPath, fps: float, size: tuple[int, int], count: int | None) -> list[Camera]:
    """A camera for each frame, or `count` of them, for whose time the path is stretched."""
    if count is not None:
        path = path.lasting(max(count - (not path.loop), 1) / fps)
    times = checked_times(path.duration, fps, loop=path.loop)
    return [path.pose(time).camera(*size) for time in times[:count]]


def path_of_file(args: argparse.Namespace) -> tuple[CameraPath, float]:
    """The path of --path and the film's frame rate; its size becomes the option's where that is not given.

    Raises:
        InputError: the file is at fault, or options say otherwise where the camera is.
    """
    if args.camera or args.eye or args.fov or args.orthographic or args.lens != NO_LENS_OPTION:
        raise InputError("--path says where the camera is; of the camera options only --size goes with it")
    width, height = args.size or DEFAULT_SIZE
    found = load_camera_path(args.path, aspect=width / height)
    if args.size is None and found.size is not None:
        if found.size[0] * found.size[1] > MAX_PIXELS:
            raise InputError(f"{args.path}: pictures of {found.size[0]}x{found.size[1]}; give a --size")
        args.size = found.size
    path = found.path if args.seconds is None else found.path.lasting(args.seconds)
    return path, args.fps or found.fps or DEFAULT_FPS


def turntable_orbit(args: argparse.Namespace, gaussians: Gaussians) -> Orbit:
    """The camera of the options and its axis; without any, one that has the scene in view from all around.

    Raises:
        InputError: see `chosen_orbit`.
    """
    if args.camera is None and args.eye is None:
        view = turntable_view(gaussians, *(args.size or DEFAULT_SIZE), fov_y=args.fov or DEFAULT_FOV)
        eye, target, up = (tuple(part.tolist()) for part in (view.camera.eye, view.target, view.up))
        args = argparse.Namespace(**{**vars(args), "eye": eye, "target": target, "up": up})
    return chosen_orbit(args, gaussians)


def turntable_cameras(orbit: Orbit, seconds: float, fps: float) -> list[Camera]:
    """Once round the orbit's axis: its own camera, lens and all, from all around."""
    times = checked_times(seconds, fps, loop=True)
    return [orbited(orbit.camera, orbit.target, orbit.up, 360.0 * time / seconds) for time in times]


def checked_times(seconds: float, fps: float, *, loop: bool) -> list[float]:
    """Seconds of the frames. Raises InputError where they are too many."""
    if not seconds * fps <= MOST_FRAMES:
        raise InputError(f"{seconds:g} s at {fps:g} frames a second are more than {MOST_FRAMES:,} frames")
    return frame_times(seconds, fps, loop=loop).tolist()
