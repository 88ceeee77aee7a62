"""The view: an eye that looks at a target from a distance, its lens, and transitions between views.

Rotations are (3, 3) float64. A matrix that pyrr makes of an axis acts on rows, so it turns the camera's
axes, the rows of `R_camera_world`, from the right; one that it makes of a quaternion (xyzw) acts on columns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from pyrr import matrix33, matrix44, quaternion, vector3

from splatview.scene import Camera, look_at_matrix
from splatview.scene import Lens as Distortion


def orthonormal(R: np.ndarray) -> np.ndarray:
    """`R` without what rounding did to it: a thousand small turns must not shear the view."""
    return matrix33.create_from_quaternion(quaternion.create_from_matrix(R))


def between(start: np.ndarray, end: np.ndarray, share: float) -> np.ndarray:
    """The rotation at `share` (0 to 1) of the shortest turn from `start` to `end`."""
    # By the exponential: pyrr's slerp is a plain mean for turns below 36°, uneven by up to 0.06°, and its
    # power refuses turns of almost nothing.
    turn = quaternion.normalize(quaternion.create_from_matrix(end @ start.T))
    turn *= math.copysign(1.0, turn[3])
    half = math.atan2(vector3.length(turn[:3]), turn[3])
    part = quaternion.exp(np.append(turn[:3] * share / np.sinc(half / math.pi), 0.0))
    return orthonormal(matrix33.create_from_quaternion(part) @ start)


def unit(vector: np.ndarray) -> np.ndarray:
    """`vector` (3,) at length 1.

    Raises:
        ValueError: its length is zero or not finite, where pyrr has NaN or zeros.
    """
    length = vector3.length(vector)
    if not (0 < length < math.inf):
        raise ValueError(f"no direction in {vector}")
    return vector3.normalize(np.asarray(vector, dtype=np.float64))


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
        matrix = matrix44.create_from_matrix33(self.R_camera_world)
        matrix[:3, 3] = -self.R_camera_world @ self.eye  # acts on columns, which pyrr's translations do not
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


DURATION = 0.35
"""Seconds: long enough to follow with the eye, short enough not to wait for."""


@dataclass(frozen=True, kw_only=True)
class Transition:
    """From `start` to `end`, beginning at `began` seconds of the caller's clock."""

    start: View
    end: View
    began: float
    duration: float = DURATION

    def at(self, now: float) -> View:
        """The view at `now`; from `began + duration` on it is `end` itself."""
        share = (now - self.began) / self.duration if self.duration > 0 else 1.0
        if not share < 1:
            return self.end
        share = max(share, 0.0)
        share = share * share * (3 - 2 * share)
        start, end = self.start, self.end
        # By the logarithm, so that a zoom over many scales runs evenly.
        distance = math.exp((1 - share) * math.log(start.distance) + share * math.log(end.distance))
        fov_y = (1 - share) * start.lens.fov_y + share * end.lens.fov_y
        return replace(
            end,
            target=(1 - share) * start.target + share * end.target,
            distance=distance,
            R_camera_world=between(start.R_camera_world, end.R_camera_world, share),
            lens=replace(end.lens, fov_y=fov_y),
        )

    def done(self, now: float) -> bool:
        return now >= self.began + self.duration
