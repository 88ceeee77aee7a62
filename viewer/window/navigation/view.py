"""What the user steers: an eye that looks at a target from a distance, and how its rays go."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ....scene import Camera, look_at_matrix
from ....scene import Lens as Distortion
from .rotations import unit

MIN_FOV, MAX_FOV = 1.0, 160.0
"""Degrees: the range in which a pinhole picture is still of use."""


@dataclass(frozen=True, kw_only=True)
class Lens:
    """Intrinsics apart from the picture's size, so that a resized window keeps its view."""

    fov_y: float = 50.0
    """Vertical field of view in degrees."""
    shift: tuple[float, float] = (0.0, 0.0)
    """Principal point minus image centre, in focal lengths; not zero only in some photos."""
    squeeze: float = 1.0
    """fx / fy."""
    distortion: Distortion | None = None
    """Of a photo's lens; `fov_y` is then that of the pinhole with its focal length."""
    orthographic: bool = False
    """Parallel rays: what is at the target's distance is as large as by a pinhole of this angle."""


@dataclass(frozen=True, eq=False, kw_only=True)
class View:
    """Where the eye is and what it turns about."""

    target: np.ndarray
    """(3,) float64, world: the point that orbiting keeps in the centre."""
    distance: float
    """From the eye to the target, > 0, world units."""
    R_camera_world: np.ndarray
    """(3, 3) float64: rows are the camera's right, down and forward in world axes."""
    up: np.ndarray
    """(3,) float64 unit: the axis a turntable turns about."""
    lens: Lens = field(default_factory=Lens)

    @property
    def forward(self) -> np.ndarray:
        """(3,) float64: unit viewing direction in world axes."""
        return self.R_camera_world[2]

    @property
    def eye(self) -> np.ndarray:
        """(3,) float64: the camera's centre in world coordinates."""
        return self.target - self.distance * self.forward

    def camera(self, width: int, height: int) -> Camera:
        """The camera of this view for a picture of width x height px."""
        fy = height / 2 / math.tan(math.radians(self.lens.fov_y) / 2)
        fx = fy * self.lens.squeeze
        cx, cy = width / 2 + self.lens.shift[0] * fx, height / 2 + self.lens.shift[1] * fy
        if self.lens.orthographic:
            fx, fy = fx / self.distance, fy / self.distance
        matrix = np.eye(4)
        matrix[:3, :3] = self.R_camera_world
        matrix[:3, 3] = -self.R_camera_world @ self.eye
        return Camera(
            width=width,
            height=height,
            fx=fx,
            fy=fy,
            cx=cx,
            cy=cy,
            world_to_camera=matrix,
            lens=None if self.lens.orthographic else self.lens.distortion,
            orthographic=self.lens.orthographic,
        )


def fitted_lens(camera: Camera, width: int, height: int, *, distance: float) -> Lens:
    """A lens that shows all that `camera` shows in a picture of width x height px; where rays are parallel,
    from `distance`.

    At the camera's own aspect ratio it is the camera's lens exactly; otherwise more is seen on two sides.
    """
    squeeze = camera.fx / camera.fy
    nearness = 1 / distance if camera.orthographic else 1.0
    tan_y = nearness * camera.height / (2 * camera.fy)
    tan_x = nearness * camera.width / (2 * camera.fx)
    # A picture of this shape sees tan_y * width / height / squeeze to the side: enough for tan_x?
    tan_y = max(tan_y, tan_x * squeeze * height / width)
    return Lens(
        fov_y=min(max(math.degrees(2 * math.atan(tan_y)), MIN_FOV), MAX_FOV),
        shift=(
            nearness * (camera.cx - camera.width / 2) / camera.fx,
            nearness * (camera.cy - camera.height / 2) / camera.fy,
        ),
        squeeze=squeeze,
        distortion=camera.lens,
        orthographic=camera.orthographic,
    )


def view_from_camera(
    camera: Camera, *, distance: float, up: np.ndarray, width: int | None = None, height: int | None = None
) -> View:
    """The view that shows `camera`'s picture, turning about the point `distance` ahead of it.

    `width`, `height`: the picture it must fit into, px; the camera's own size where left out.
    """
    return View(
        target=camera.eye + distance * camera.forward,
        distance=distance,
        R_camera_world=camera.R_camera_world,
        up=unit(up),
        lens=fitted_lens(camera, width or camera.width, height or camera.height, distance=distance),
    )


def look_from(eye: np.ndarray, target: np.ndarray, up: np.ndarray, lens: Lens | None = None) -> View:
    """The level view from `eye` to `target`, both (3,) world, with the unit `up` upwards.

    Raises:
        ValueError: eye and target coincide or a value is not finite.
    """
    matrix = look_at_matrix(eye.tolist(), target.tolist(), up.tolist())
    return View(
        target=np.asarray(target, dtype=np.float64),
        distance=float(np.linalg.norm(target - eye)),
        R_camera_world=matrix[:3, :3],
        up=unit(up),
        lens=lens or Lens(),
    )
