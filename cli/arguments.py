"""Command-line arguments that several commands share, and a parser whose errors are one line."""

from __future__ import annotations

import argparse
import math
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, NoReturn

import numpy as np

from splatview.cli.main import did_you_mean
from splatview.measure.knobs import KNOBS, Plan, apply_choices
from splatview.scene import Camera, Gaussians, InputError, Lens, RenderSettings, look_at
from splatview.scene.background import Background, Colour, Gradient
from splatview.scene.camera import orbited, stepped_back, through_lens, with_parallel_rays
from splatview.scene.errors import parse_bytes
from splatview.scene.first_view import first_view
from splatview.scene.formats import load_cameras
from splatview.scene.formats.panorama import load_panorama
from splatview.scene.framing import WORLD_UP, pivot, robust_bounds

DEFAULT_SIZE = (1280, 720)

LARGEST = 1e100
"""Coordinate: of larger ones the squares are infinite."""

MAX_SIDE = 1 << 16
MAX_PIXELS = 1 << 27
"""2 GiB as float32 RGBA: more is a slip of the finger."""


class Parser(argparse.ArgumentParser):
    """Raises InputError where argparse would print its usage and exit; `--help` works as ever."""

    def __init__(self, command: str, description: str, *, usage: str | None = None):
        super().__init__(
            prog=f"splatview {command}".strip(),
            usage=usage,
            description=description,
            allow_abbrev=False,
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        self._given: tuple[str, ...] = ()

    def error(self, message: str) -> NoReturn:
        wrong = re.search(r"^unrecognized arguments: .*?(--[^\s=]+)", message)
        hint = did_you_mean(wrong[1], self._option_string_actions) if wrong else ""
        # Taken for an option, or for the value of one that is missing.
        dashed = next((one for one in self._given if re.fullmatch(r"-[^-].*\.[A-Za-z]\w*", one)), None)
        if dashed:
            hint += f"; a name that begins with a dash is written ./{dashed}"
        raise InputError(f"{message}{hint} (see {self.prog} --help)")

    def parse(self, arguments: Sequence[str]) -> argparse.Namespace | None:
        """The options, or None where help was asked for and printed.

        Raises:
            InputError: the arguments are wrong.
        """
        self._given = tuple(arguments)
        try:
            return self.parse_args(with_joined_values(arguments))
        except SystemExit:
            return None


def with_joined_values(arguments: Sequence[str]) -> list[str]:
    """``--eye -1,2,3`` as ``--eye=-1,2,3``: argparse takes a value that begins with a minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        previous = joined[-1] if joined else ""
        if re.match(r"-\.?\d", argument) and re.fullmatch(r"--[a-z-]+", previous):
            joined[-1] = f"{previous}={argument}"
        else:
            joined.append(argument)
    return joined


def number(text: str) -> float:
    """A finite number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text!r} is not a number")
    return value


def positive(text: str) -> float:
    value = number(text)
    if not value > 0:
        raise argparse.ArgumentTypeError(f"must be more than 0, got {text}")
    return value


def not_negative(text: str) -> float:
    value = number(text)
    if not value >= 0:
        raise argparse.ArgumentTypeError(f"must be at least 0, got {text}")
    return value


def field_of_view(text: str) -> float:
    value = number(text)
    if not 0 < value < 180:
        raise argparse.ArgumentTypeError(f"must be between 0 and 180 degrees, got {text}")
    return value


def count(text: str) -> int:
    """A whole number of at least 1."""
    if not re.fullmatch(r"\+?\d{1,9}", text) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 1, got {text!r}")
    return int(text)


def downscale(text: str) -> int | Literal["auto"]:
    """The value of --downscale."""
    return "auto" if text == "auto" else count(text)


def memory(text: str) -> int:
    """Bytes: ``2GB``, ``800MiB``."""
    size = parse_bytes(text)
    if size is None:
        raise argparse.ArgumentTypeError(f"must be a size such as 2GB or 800MB, got {text!r}")
    return size


def index(text: str) -> int:
    """A whole number of at least 0."""
    if not re.fullmatch(r"\d{1,9}", text):
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 0, got {text!r}")
    return int(text)


def vector(text: str) -> tuple[float, float, float]:
    """x,y,z"""
    parts = text.split(",")
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} is not three numbers with commas between: 1,-2,0.5")
    x, y, z = (number(part) for part in parts)
    if max(abs(x), abs(y), abs(z)) > LARGEST:
        raise argparse.ArgumentTypeError(f"{text!r}: coordinates go to {LARGEST:g}")
    return x, y, z


def direction(text: str) -> tuple[float, float, float]:
    value = vector(text)
    if not any(value):
        raise argparse.ArgumentTypeError("0,0,0 is no direction")
    return value


def colour(text: str) -> tuple[float, float, float]:
    value = vector(text)
    if not all(0 <= part <= 1 for part in value):
        raise argparse.ArgumentTypeError(f"{text!r}: red, green and blue go from 0 to 1")
    return value


def size(text: str) -> tuple[int, int]:
    """WIDTHxHEIGHT in pixels."""
    match = re.fullmatch(r"(\d{1,6})[xX×](\d{1,6})", text)
    if not match:
        raise argparse.ArgumentTypeError(f"{text!r} is not a size in pixels such as 1280x720")
    width, height = int(match[1]), int(match[2])
    if not (width >= 1 and height >= 1):
        raise argparse.ArgumentTypeError(f"{text}: a picture is at least 1x1 pixels")
    if not (max(width, height) <= MAX_SIDE and width * height <= MAX_PIXELS):
        raise argparse.ArgumentTypeError(f"{text} is more than {MAX_PIXELS / 1e6:.0f} megapixels can hold")
    return width, height


# ---- What `--background` takes: a colour, a gradient, or a picture all around.


HELP = (
    "r,g,b (0 to 1 each); gradient:TOP,BOTTOM with colours as #rrggbb or names (or six numbers); or a "
    "picture that is equirectangular (default: 0,0,0)"
)


def background(text: str) -> Colour | Gradient | Path:
    """The option's value; pictures are read later, by `chosen_background`."""
    if text.startswith("gradient:"):
        return _gradient(text.removeprefix("gradient:"))
    if text.startswith("#"):
        return _named(text)
    if re.fullmatch(r"[-+.\d,eE ]*|nan.*|inf.*", text):
        return colour(text)
    return Path(text)


def chosen_background(
    value: Colour | Gradient | Path | None, up: tuple[float, float, float] | None
) -> Background:
    """The background itself, with `up` upwards; black where none was asked for.

    Raises:
        InputError: it is a picture that cannot be read.
    """
    if value is None:
        return 0.0, 0.0, 0.0
    if isinstance(value, Path):
        return load_panorama(value, up=up or WORLD_UP)
    if isinstance(value, Gradient) and up is not None:
        return Gradient(top=value.top, bottom=value.bottom, up=up)
    return value


def _gradient(text: str) -> Gradient:
    parts = text.split(",")
    if len(parts) == 6:
        return Gradient(top=colour(",".join(parts[:3])), bottom=colour(",".join(parts[3:])))
    if len(parts) != 2:
        raise argparse.ArgumentTypeError(
            f"gradient:{text} is not two colours, the upper first: gradient:#88b0e0,#404038"
        )
    return Gradient(top=_named(parts[0]), bottom=_named(parts[1]))


def _named(text: str) -> Colour:
    from PIL import ImageColor

    try:
        r, g, b = (value / 255 for value in ImageColor.getrgb(text.strip())[:3])
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no colour such as #88b0e0 or white") from None
    return r, g, b


# ---- Which camera the options ask for, and how it moves on for the next frame.


DEFAULT_FOV = 50.0

NO_LENS_OPTION = Lens(model="PINHOLE")
"""What `--lens` is where it is not given: None says that a camera's own is left out."""


def add_camera_options(parser: Parser) -> None:
    group = parser.add_argument_group("camera (default: one that shows the whole scene)")
    group.add_argument("--camera", metavar="FILE", help="camera JSON, cameras.json, or a COLMAP folder")
    group.add_argument("--camera-index", type=index, metavar="I", help="which of the file's cameras, from 0")
    group.add_argument("--camera-name", metavar="NAME", help="which of the file's cameras, by its name")
    group.add_argument("--eye", type=vector, metavar="X,Y,Z", help="where the camera is, world units")
    group.add_argument("--target", type=vector, metavar="X,Y,Z", help="what it looks at")
    group.add_argument(
        "--up",
        type=direction,
        metavar="X,Y,Z",
        help="what is upwards in the picture (default: 0,-1,0, which is up in trained scenes)",
    )
    group.add_argument(
        "--fov", type=field_of_view, metavar="DEG", help="vertical field of view (default: 50)"
    )
    group.add_argument(
        "--lens",
        type=lens_or_none,
        default=NO_LENS_OPTION,
        metavar="MODEL:K,..",
        help="one of COLMAP's lenses with its distortion, OPENCV_FISHEYE:0.1,0,0,0 say, at the same vertical "
        "field of view; none: leave out the camera's own",
    )
    group.add_argument(
        "--orthographic",
        action="store_true",
        help="parallel rays; what is as far away as the target stays as large",
    )
    group.add_argument("--size", type=size, metavar="WxH", help="pixels (default: the camera's, or 1280x720)")


def lens_or_none(text: str) -> Lens | None:
    """MODEL:K1,K2,.. or none."""
    if text == "none":
        return None
    model, _, numbers = text.partition(":")
    try:
        return Lens(
            model=model.upper(), parameters=tuple(number(part) for part in numbers.split(",") if numbers)
        )
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None


def check_camera_options(args: argparse.Namespace) -> None:
    """Raises InputError for options that contradict each other, before anything is loaded."""
    by_file = args.camera is not None
    if by_file and (args.eye or args.target):
        raise InputError("--camera and --eye/--target both say where the camera is; give one of them")
    if (args.eye is None) != (args.target is None):
        given, missing = ("--eye", "--target") if args.eye else ("--target", "--eye")
        raise InputError(f"{given} needs {missing} as well")
    if args.eye is not None and args.eye == args.target:
        raise InputError("--eye and --target are the same point")
    if by_file and (args.up or args.fov):
        raise InputError("--up and --fov go with --eye and --target; the camera file has its own")
    if args.up and args.eye is None:
        raise InputError("--up goes with --eye and --target")
    if not by_file and (args.camera_index is not None or args.camera_name is not None):
        raise InputError("--camera-index and --camera-name choose from the file that --camera names")
    if args.camera_index is not None and args.camera_name is not None:
        raise InputError("--camera-index and --camera-name both choose a camera; give one of them")
    if args.orthographic and args.lens not in (None, NO_LENS_OPTION):
        raise InputError("--orthographic has no lens: its rays are parallel; drop --lens or --orthographic")


@dataclass(frozen=True, eq=False)
class Orbit:
    """A camera and the axis about which it turns from frame to frame."""

    camera: Camera
    target: np.ndarray
    up: np.ndarray

    def turned(self, degrees: float) -> Camera:
        """The eye turned `degrees` about the target's axis `up`; what it sees turns along."""
        return self.turned_from(self.camera, degrees)

    def turned_from(self, camera: Camera, degrees: float) -> Camera:
        """Likewise, of another camera."""
        return orbited(camera, self.target, self.up, degrees)


def chosen_orbit(args: argparse.Namespace, gaussians: Gaussians) -> Orbit:
    """The camera of the options, or one that frames the scene.

    Raises:
        InputError: the camera file is at fault, or the lens does not see as much as was asked for.
    """
    orbit = _pinhole_orbit(args, gaussians)
    camera = orbit.camera
    if args.lens is None:
        camera = replace(camera, lens=None)
    elif args.lens != NO_LENS_OPTION:
        if camera.orthographic:
            raise InputError(f"{args.camera}: has parallel rays, which go through no lens; drop --lens")
        try:
            camera = through_lens(replace(camera, lens=None), args.lens)
        except ValueError as error:
            raise InputError(f"{error}; give a smaller --fov") from None
    if args.orthographic and not camera.orthographic:
        depth = float((orbit.target - camera.eye) @ camera.forward)
        camera = stepped_back(with_parallel_rays(camera, depth), *robust_bounds(gaussians.means))
    return replace(orbit, camera=camera)


def _pinhole_orbit(args: argparse.Namespace, gaussians: Gaussians) -> Orbit:
    """Before the options about rays. Raises InputError: the camera file is at fault."""
    if args.camera is not None:
        camera = camera_from_file(args)
        if args.size:
            camera = camera.resized(*args.size)
        elif camera.width * camera.height > MAX_PIXELS:
            raise InputError(f"{args.camera}: a picture of {camera.width}x{camera.height}; give a --size")
        return orbit_of(camera, robust_bounds(gaussians.means)[0])
    width, height = args.size or DEFAULT_SIZE
    fov = args.fov or DEFAULT_FOV
    if args.eye is not None:
        up = args.up or WORLD_UP
        camera = look_at(args.eye, args.target, up=up, fov_y=fov, width=width, height=height)
        return Orbit(camera, np.array(args.target), np.array(up))
    view = first_view(gaussians, width, height, fov_y=fov)
    return Orbit(view.camera, view.target, view.up)


def orbit_of(camera: Camera, centre: np.ndarray) -> Orbit:
    """About the point of the camera's viewing axis that is nearest to the scene's `centre`."""
    return Orbit(camera, pivot(camera, centre), -camera.R_camera_world[1])


def camera_from_file(args: argparse.Namespace) -> Camera:
    cameras = load_cameras(args.camera, on_note=lambda note: print(f"splatview: {note}", file=sys.stderr))
    if args.camera_name is not None:
        for camera in cameras:
            if camera.name == args.camera_name:
                return camera
        raise InputError(
            f"{args.camera}: no camera is called {args.camera_name!r}; "
            f"there are {len(cameras)}, the first is {cameras[0].name!r}"
        )
    which = args.camera_index or 0
    if which >= len(cameras):
        raise InputError(
            f"{args.camera}: has {len(cameras)} cameras, --camera-index goes to {len(cameras) - 1}"
        )
    return cameras[which]


# ---- The knobs of the accuracy ladder as command-line options.


def add_knob_options(parser: Parser) -> None:
    group = parser.add_argument_group(
        "shortcuts (exact values first; `splatview ladder` measures what each costs and saves)"
    )
    for knob in KNOBS:
        values = ", ".join(value.text for value in knob.values)
        owners = ", ".join(name for name in knob.renderers if name != "reference")
        group.add_argument(
            knob.option,
            metavar=knob.name.rpartition("-")[2].upper(),
            help=f"{values} ({owners}): {knob.changes}".replace("%", "%%"),
        )


def knob_choices(args: argparse.Namespace) -> dict[str, str]:
    """Knob -> value as typed, of those that were given."""
    given = {knob.name: getattr(args, knob.name.replace("-", "_")) for knob in KNOBS}
    return {name: text for name, text in given.items() if text is not None}


def check_knob_options(args: argparse.Namespace) -> None:
    """Raises InputError for what cannot work, as far as that is known before the renderer is."""
    for name, text in knob_choices(args).items():
        if args.renderer == "auto":
            next(knob for knob in KNOBS if knob.name == name).value(text)
        else:
            apply_choices(Plan(), {name: text}, args.renderer)


def chosen_plan(args: argparse.Namespace, settings: RenderSettings, renderer: str) -> Plan:
    """The options' plan for the renderer called `renderer`, as "auto" chose it.

    Raises:
        InputError: it does not have a knob that was asked for.
    """
    return apply_choices(Plan(settings=settings), knob_choices(args), renderer)
