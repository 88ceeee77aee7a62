"""Which camera the options ask for, and how it moves on for the next frame."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace

import numpy as np

from ...scene import Camera, Gaussians, InputError, Lens, look_at
from ...scene.files import load_cameras
from ...scene.framing import WORLD_UP, frame_camera, robust_bounds
from ...scene.other_rays import stepped_back, through_lens, with_parallel_rays
from ...scene.turning import turned_about
from .arguments import DEFAULT_SIZE, MAX_PIXELS, Parser, direction, field_of_view, index, number, size, vector

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
        return turned_about(camera, self.target, self.up, degrees)


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
        centre, _ = robust_bounds(gaussians.means)
        # Turn about the point of the viewing axis that is nearest to the scene.
        depth = float((centre - camera.eye) @ camera.forward)
        target = camera.eye + camera.forward * (depth if depth > 0 else 1.0)
        return Orbit(camera, target, -camera.R_camera_world[1])
    width, height = args.size or DEFAULT_SIZE
    fov = args.fov or DEFAULT_FOV
    if args.eye is not None:
        up = args.up or WORLD_UP
        camera = look_at(args.eye, args.target, up=up, fov_y=fov, width=width, height=height)
        return Orbit(camera, np.array(args.target), np.array(up))
    centre, _ = robust_bounds(gaussians.means)
    camera = frame_camera(gaussians, width, height, fov_y=fov)
    return Orbit(camera, centre, np.array(WORLD_UP))


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
