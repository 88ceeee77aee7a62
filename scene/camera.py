"""A camera: intrinsics in pixels, a world-to-camera matrix with OpenCV's axes, and perhaps a lens.

Without a lens it is a pinhole. An orthographic camera has parallel rays instead, along its viewing
direction: its eye only says where the depth of 0 is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from splatview.scene.lens import Lens, distort, slopes_through, undistort


@dataclass(frozen=True, eq=False, kw_only=True)
class Camera:
    """Axes are OpenCV's: x right, y down, z forward. The centre of the top-left pixel is (0.5, 0.5).

    Raises:
        ValueError: a size below 1, a focal length that is not positive and finite, or a matrix that is
            not finite, not 4x4, or whose upper left 3x3 is no rotation (to 1e-3), or a lens before parallel
            rays.
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
    lens: Lens | None = None
    """None for a pinhole, which is also what a lens that changes nothing becomes."""
    orthographic: bool = False
    """Parallel rays: then fx and fy are px per world unit."""

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
        # Products of larger entries may overflow.
        is_rotation = (
            (np.abs(rotation) <= 2).all()
            and (np.abs(rotation @ rotation.T - np.eye(3)) <= 1e-3).all()
            and np.linalg.det(rotation) > 0
        )
        if not is_rotation:
            raise ValueError("camera world_to_camera must hold a rotation (orthonormal, no mirror, no scale)")
        matrix.flags.writeable = False
        object.__setattr__(self, "world_to_camera", matrix)
        if self.lens is not None and self.lens.is_pinhole:
            object.__setattr__(self, "lens", None)
        if self.lens is not None and self.orthographic:
            raise ValueError("an orthographic camera has no lens: its rays are parallel")

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
        """(3,) float64: the camera's centre in world coordinates, which R·eye + t takes to 0.

        By solving, as R may be a rotation to 1e-3 only (files store it rounded): with its transpose the eye
        of a camera 10⁶ units from the origin would be 10³ beside.
        """
        return -np.linalg.solve(self.R_camera_world, self.t_camera_world)

    @property
    def R_world_camera(self) -> np.ndarray:
        """(3, 3) float64: camera axes to world axes, the inverse of `R_camera_world`."""
        return np.linalg.inv(self.R_camera_world)

    @property
    def forward(self) -> np.ndarray:
        """(3,) float64: unit viewing direction in world axes."""
        return self.R_camera_world[2]

    def same_view(self, other: Camera) -> bool:
        """Whether both cameras make the same picture of any scene (names apart)."""
        return (
            (*self._intrinsics, self.lens, self.orthographic)
            == (*other._intrinsics, other.lens, other.orthographic)
        ) and np.array_equal(self.world_to_camera, other.world_to_camera)

    @property
    def _intrinsics(self) -> tuple[int, int, float, float, float, float]:
        return self.width, self.height, self.fx, self.fy, self.cx, self.cy

    @property
    def visible_slopes(self) -> tuple[float, float, float, float]:
        """Least x/z, least y/z, greatest x/z, greatest y/z of the rays that the picture sees."""
        if self.lens is not None:
            return slopes_through(self.lens, *self._intrinsics)
        left, top = -self.cx / self.fx, -self.cy / self.fy
        return left, top, (self.width - self.cx) / self.fx, (self.height - self.cy) / self.fy

    def slope_limits(self, margin: float | None) -> tuple[float, float, float, float]:
        """`visible_slopes`, wider by `margin` times half their range (image model, step 2). None: no
        limits."""
        if margin is None:
            return -math.inf, -math.inf, math.inf, math.inf
        left, top, right, bottom = self.visible_slopes
        beside, above = margin * (right - left) / 2, margin * (bottom - top) / 2
        return left - beside, top - above, right + beside, bottom + above

    def image_points(self, t: np.ndarray) -> np.ndarray:
        """Where points t (..., 3) in camera axes are seen: (..., 2) float64 px. Without meaning where z <= 0
        and rays are not parallel; NaN where the lens shows nothing."""
        t = np.asarray(t, dtype=np.float64)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            flat = t[..., :2] if self.orthographic else t[..., :2] / t[..., 2:]
            if self.lens is not None:
                beyond = ~((flat * flat).sum(axis=-1) < self.lens.form.valid_radius_squared)
                flat = distort(flat, self.lens)
                flat[beyond] = np.nan
            return flat * (self.fx, self.fy) + (self.cx, self.cy)

    def points_at(self, pixels: ArrayLike, depth: float) -> np.ndarray:
        """The inverse: points (..., 3) in camera axes at z = `depth` that are seen at pixels (..., 2)."""
        flat = (np.asarray(pixels, dtype=np.float64) - (self.cx, self.cy)) / (self.fx, self.fy)
        if self.lens is not None:
            flat = undistort(flat, self.lens)
        if not self.orthographic:
            flat = flat * depth
        return np.concatenate([flat, np.full((*flat.shape[:-1], 1), float(depth))], axis=-1)

    def about(self, origin: np.ndarray) -> Camera:
        """The same camera in a world whose origin is at `origin` (3,) of this one."""
        if not origin.any():
            return self
        matrix = self.world_to_camera.copy()
        matrix[:3, 3] += self.R_camera_world @ origin
        return replace(self, world_to_camera=matrix)

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
    # Where up is nearly parallel, rounding leaves a part along the view.
    right -= (right @ forward) * forward
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


HELD_ALIKE = 0.9
"""Length of the mean of unit vectors from which on cameras are held the same way."""


def likely_ups(cameras: Sequence[Camera], least: float) -> list[np.ndarray]:
    """Directions (3,), world, unit, that may be up, the likeliest first: the mean of the cameras' ups, where
    its length is above `least`. Else, where all stand on the same side, as portraits are stored, that side
    and its opposite; first the one that the cameras look down from, as most do. None, where they point
    everywhere."""
    right, down, ahead = np.mean([camera.R_camera_world for camera in cameras], axis=0)
    if (length := float(np.linalg.norm(down))) > least:
        return [-down / length]
    if not (length := float(np.linalg.norm(right))) > HELD_ALIKE:
        return []
    side = right / length
    return [side, -side] if ahead @ side <= 0 else [-side, side]


ROOM = 10.0
"""Scene radii before the scene at which the eye of parallel rays stands at least: what is behind it is cut
off, and where it stands changes nothing else."""


def with_parallel_rays(camera: Camera, depth: float) -> Camera:
    """What lies `depth` (> 0, world units) ahead is as large as before; no lens."""
    return replace(camera, lens=None, orthographic=True, fx=camera.fx / depth, fy=camera.fy / depth)


def stepped_back(camera: Camera, centre: np.ndarray, radius: float) -> Camera:
    """An orthographic camera with room before its eye for all of a scene about `centre` (3,), world: the same
    picture, but that nothing of the scene is behind the eye."""
    depth = float((centre - camera.eye) @ camera.forward)
    back = max(ROOM * radius - depth, 0.0)
    matrix = camera.world_to_camera.copy()
    matrix[2, 3] += back
    return replace(camera, world_to_camera=matrix)


def through_lens(camera: Camera, lens: Lens) -> Camera:
    """Through the lens, with the focal length that keeps the vertical angle of view.

    Raises:
        ValueError: the lens does not see that far from its axis.
    """
    slope = camera.height / (2 * camera.fy)
    angle = math.degrees(2 * math.atan(slope))
    if not slope < lens.valid_radius:
        raise ValueError(
            f"the lens {lens} sees at most {math.degrees(2 * math.atan(lens.valid_radius)):.4g} degrees, "
            f"not the {angle:.4g} asked for"
        )
    factor = slope / float(distort(np.array([0.0, slope]), lens)[1])
    return replace(camera, lens=lens, fx=camera.fx * factor, fy=camera.fy * factor)


def orbited(camera: Camera, target: np.ndarray, up: np.ndarray, degrees: float) -> Camera:
    """The eye turned about the axis `up` (3,) through `target` (3,); what it sees turns along."""
    angle, axis = math.radians(degrees), up / np.linalg.norm(up)
    K = np.cross(np.eye(3), axis)
    # Rodrigues' formula; np.cross(I, axis) is the transpose of the cross-product matrix of the axis.
    R = np.eye(3) - math.sin(angle) * K + (1 - math.cos(angle)) * (K @ K)
    eye = target + R @ (camera.eye - target)
    matrix = np.eye(4)
    matrix[:3, :3] = camera.R_camera_world @ R.T
    matrix[:3, 3] = -matrix[:3, :3] @ eye
    return replace(camera, world_to_camera=matrix)
