"""A pinhole camera: intrinsics in pixels and a world-to-camera matrix, OpenCV axes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """Axes are OpenCV's: x right, y down, z forward. The centre of the top-left pixel is (0.5, 0.5).

    Raises:
        ValueError: a size below 1, a focal length that is not positive and finite, or a matrix that is
            not finite, not 4x4, or whose upper left 3x3 is no rotation (to 1e-3).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    world_to_camera: np.ndarray
    """(4, 4) float64, acts on column vectors."""
    name: str = ""
    """What a camera list calls it, a photo's file name say."""

    def __post_init__(self) -> None:
        if not (self.width >= 1 and self.height >= 1):
            raise ValueError(f"camera size must be at least 1x1, got {self.width}x{self.height}")
        for name in ("fx", "fy"):
            if not (0 < getattr(self, name) < math.inf):
                raise ValueError(f"camera {name} must be positive and finite, got {getattr(self, name)}")
        for name in ("cx", "cy"):
            if not math.isfinite(getattr(self, name)):
                raise ValueError(f"camera {name} must be finite, got {getattr(self, name)}")
        matrix = np.array(self.world_to_camera, dtype=np.float64)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise ValueError("camera world_to_camera must be a finite 4x4 matrix")
        if not (matrix[3] == (0, 0, 0, 1)).all():
            raise ValueError("camera world_to_camera must have the last row 0 0 0 1")
        rotation = matrix[:3, :3]
        if not (np.abs(rotation @ rotation.T - np.eye(3)) <= 1e-3).all() or not np.linalg.det(rotation) > 0:
            raise ValueError("camera world_to_camera must hold a rotation (orthonormal, no mirror, no scale)")
        matrix.flags.writeable = False
        object.__setattr__(self, "world_to_camera", matrix)

    @property
    def R_camera_world(self) -> np.ndarray:
        """(3, 3) float64: world axes to camera axes."""
        return self.world_to_camera[:3, :3]

    @property
    def t_camera_world(self) -> np.ndarray:
        """(3,) float64: the world's origin in camera axes."""
        return self.world_to_camera[:3, 3]

    @property
    def eye(self) -> np.ndarray:
        """(3,) float64: the camera's centre in world coordinates."""
        return -self.R_camera_world.T @ self.t_camera_world

    @property
    def forward(self) -> np.ndarray:
        """(3,) float64: unit viewing direction in world axes."""
        return self.R_camera_world[2]

    def same_view(self, other: Camera) -> bool:
        """Whether both cameras make the same picture of any scene (names apart)."""
        return (
            (self.width, self.height, self.fx, self.fy, self.cx, self.cy)
            == (other.width, other.height, other.fx, other.fy, other.cx, other.cy)
        ) and np.array_equal(self.world_to_camera, other.world_to_camera)

    def resized(self, width: int, height: int) -> Camera:
        """The same view on width x height pixels; intrinsics scale by the exact ratios."""
        sx, sy = width / self.width, height / self.height
        return replace(
            self,
            width=width,
            height=height,
            fx=self.fx * sx,
            fy=self.fy * sy,
            cx=self.cx * sx,
            cy=self.cy * sy,
        )


def look_at_matrix(eye: ArrayLike, target: ArrayLike, up: ArrayLike) -> np.ndarray:
    """World-to-camera matrix (4, 4) float64 of an eye that looks at `target` with `up` upwards in the image.

    Where `up` is parallel to the viewing direction the least aligned world axis takes its place.

    Raises:
        ValueError: a value is not finite, or eye and target coincide.
    """
    eye_w, target_w, up_w = (np.asarray(v, dtype=np.float64) for v in (eye, target, up))
    if not (np.isfinite(eye_w).all() and np.isfinite(target_w).all() and np.isfinite(up_w).all()):
        raise ValueError("eye, target and up must be finite")
    forward = target_w - eye_w
    distance = np.linalg.norm(forward)
    if not distance > 0:
        raise ValueError("eye and target are the same point")
    forward /= distance
    right = np.cross(forward, up_w)
    if not np.linalg.norm(right) > 1e-9 * np.linalg.norm(up_w):
        right = np.cross(forward, np.eye(3)[np.argmin(np.abs(forward))])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    matrix = np.eye(4)
    matrix[:3, :3] = (right, down, forward)
    matrix[:3, 3] = -matrix[:3, :3] @ eye_w
    return matrix


def look_at(
    eye: ArrayLike,
    target: ArrayLike,
    *,
    up: ArrayLike = (0.0, 1.0, 0.0),
    fov_y: float = 50.0,
    width: int = 1280,
    height: int = 720,
) -> Camera:
    """A camera at `eye` that looks at `target`.

    `fov_y` is the vertical field of view in degrees, 0 < fov_y < 180; a ValueError says so otherwise.
    """
    if not 0 < fov_y < 180:
        raise ValueError(f"field of view must be between 0 and 180 degrees, got {fov_y}")
    focal = height / 2 / math.tan(math.radians(fov_y) / 2)
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=width / 2,
        cy=height / 2,
        world_to_camera=look_at_matrix(eye, target, up),
    )
