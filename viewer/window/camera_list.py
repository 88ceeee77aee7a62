"""Going to cameras that come from elsewhere: a loaded list, the clipboard."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np

from ...scene import Camera
from ...scene.errors import one_line
from ...scene.files.cameras import camera_values, is_orthographic, lens_of
from .core import Core
from .navigation import view_from_camera


def go_to_camera(core: Core, index: int) -> None:
    """Jumps to the loaded camera `index`, counted round the list."""
    if not core.cameras:
        core.tell("No cameras are loaded: File > Load a list of cameras")
        return
    core.camera_index = index % len(core.cameras)
    camera = core.cameras[core.camera_index]
    take_position(core, camera)
    core.tell(f"Camera {core.camera_index + 1} of {len(core.cameras)}: {camera.name or 'unnamed'}")


def step_camera(core: Core, step: int) -> None:
    """Next or previous: the first step goes to the first or last camera."""
    go_to_camera(core, core.camera_index + step if core.camera_index >= 0 or step > 0 else -1)


def take_position(core: Core, camera: Camera) -> None:
    """Looks as `camera` does; the turning point keeps its distance, the up axis stays."""
    width, height = core.picture_size
    view = core.destination
    if not core.through_lenses:
        camera = replace(camera, lens=None)
    core.go_to(view_from_camera(camera, distance=view.distance, up=view.up, width=width, height=height))


def copy_camera(core: Core) -> None:
    """Puts the view on the clipboard in the form that `splatview render --camera` reads."""
    core.clipboard_write = camera_text(core.camera)
    core.tell("The camera is on the clipboard")


def paste_camera(core: Core) -> None:
    try:
        camera = camera_from_text(core.clipboard_read())
    except ValueError as error:
        core.tell(f"There is no camera on the clipboard: {error}")
        return
    take_position(core, camera)


def camera_text(camera: Camera) -> str:
    """The camera as CAM.json has it."""
    return json.dumps(camera_values(camera))


def camera_from_text(text: str) -> Camera:
    """The camera that `text` describes.

    Raises:
        ValueError: it is no camera; the message says why.
    """
    try:
        data = json.loads(text)
        return Camera(
            width=int(data["width"]),
            height=int(data["height"]),
            fx=float(data["fx"]),
            fy=float(data["fy"]),
            cx=float(data["cx"]),
            cy=float(data["cy"]),
            world_to_camera=np.array(data["world_to_camera"], dtype=np.float64),
            lens=lens_of(data, "the clipboard"),
            orthographic=is_orthographic(data, "the clipboard"),
        )
    except json.JSONDecodeError:
        raise ValueError("it holds no JSON") from None
    except KeyError as error:
        raise ValueError(f"{error} is missing") from None
    except (TypeError, RecursionError, OverflowError):
        raise ValueError("it is not an object with the numbers of a camera") from None
    except ValueError as error:
        raise ValueError(one_line(str(error))) from None
