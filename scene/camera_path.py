"""A camera path: keyframes in time, and the smooth way of the camera through them.

Each quantity goes through its keyframes as a cubic Hermite curve with three-point tangents (Catmull-Rom for
uneven times): C1, the same backwards, and of constant speed where the steps are equal. Tangents are no longer
than three times either neighbouring slope (Fritsch and Carlson's bound, by length), so that a camera which
rests between two equal keyframes does not overshoot. Rotations do so on their group: Bézier curves of slerps
with angular velocities for tangents (Shoemake 1985). What a turntable does, equal turns about one axis, is an
even circle to rounding.

Turned by slerps alone a camera tilts between two level views; its roll is therefore interpolated by itself,
except where a keyframe looks along the up axis and has none. Dropped: screw motions, which need no target,
but look back while walking on a semicircle; look-at targets alone, which turn unevenly.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, get_args

import numpy as np

from splatview.scene.camera import Camera, orbited

Motion = Literal["orbit", "fly"]
"""What goes through the keyframes smoothly besides rotation and lens: the target, about which the eye then
swings, or the eye itself."""

MOTIONS: tuple[Motion, ...] = get_args(Motion)

STEEPEST = math.cos(math.radians(3.0))
"""Cosine between the viewing direction and the up axis beyond which a keyframe has no roll."""

QUARTERS = 4
"""Keyframes of a turntable."""

TURNTABLE_SECONDS = 6.0
"""Of one turn, where nothing else is said."""

MOST_SECONDS = 24 * 3600.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Pose:
    """A camera without the size of its picture.

    Raises:
        ValueError: a number is not finite, the distance not positive, the field of view not between 0 and 180
            degrees, or the rotation none (to 1e-3).
    """

    target: np.ndarray
    """(3,) float64, world: a point on the viewing axis, which an orbit keeps."""
    distance: float
    """From the eye to the target, > 0, world units."""
    R_camera_world: np.ndarray
    """(3, 3) float64: rows are the camera's right, down and forward in world axes."""
    fov_y: float = 50.0
    """Vertical field of view in degrees."""

    def __post_init__(self) -> None:
        R = self.R_camera_world
        if not (np.isfinite(self.target).all() and 0 < self.distance < math.inf):
            raise ValueError("a target or its distance is not finite and positive")
        if not 0 < self.fov_y < 180:
            raise ValueError(f"a field of view must be between 0 and 180 degrees, not {self.fov_y:g}")
        if not ((abs(R) <= 2).all() and (abs(R @ R.T - np.eye(3)) <= 1e-3).all() and np.linalg.det(R) > 0):
            raise ValueError("a rotation is none (orthonormal, no mirror, no scale)")

    @property
    def eye(self) -> np.ndarray:
        """(3,) float64: the camera's centre, world."""
        return self.target - self.distance * self.R_camera_world[2]

    def camera(self, width: int, height: int) -> Camera:
        """The pinhole camera of width x height px."""
        focal = height / 2 / math.tan(math.radians(self.fov_y) / 2)
        matrix = np.eye(4)
        matrix[:3, :3] = self.R_camera_world
        matrix[:3, 3] = -self.R_camera_world @ self.eye
        return Camera(
            width=width,
            height=height,
            fx=focal,
            fy=focal,
            cx=width / 2,
            cy=height / 2,
            world_to_camera=matrix,
        )


@dataclass(frozen=True, eq=False, kw_only=True)
class Keyframe:
    """A pose at a time."""

    time: float
    """Seconds from the path's beginning, >= 0."""
    pose: Pose


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraPath:
    """Keyframes, in the order of their times, and how the camera goes through them.

    Raises:
        ValueError: there are no keyframes, two at the same time, one before 0 or after the end, or a loop has
            no time left for the way from the last to the first.
    """

    keyframes: tuple[Keyframe, ...]
    duration: float
    """Seconds until the path ends or, in a loop, is where it began. Before the first keyframe and after the
    last the camera rests, but in a loop."""
    loop: bool = False
    motion: Motion = "orbit"
    up: np.ndarray = field(default_factory=lambda: np.array((0.0, -1.0, 0.0)))
    """(3,) float64 unit, world: what the roll is measured against."""

    def __post_init__(self) -> None:
        keys = tuple(sorted(self.keyframes, key=lambda key: key.time))
        object.__setattr__(self, "keyframes", keys)
        if not keys:
            raise ValueError("a camera path has at least one keyframe")
        if not 0 <= self.duration <= MOST_SECONDS:
            raise ValueError(f"a camera path takes 0 to {MOST_SECONDS:.0f} seconds, not {self.duration:g}")
        for before, after in pairwise(keys):
            if not before.time < after.time:
                raise ValueError(f"two keyframes are at the same time, {after.time:g} s")
        if not (keys[0].time >= 0 and keys[-1].time <= self.duration):
            raise ValueError(f"a keyframe is outside of the path's {self.duration:g} s")
        if self.loop and not keys[-1].time - keys[0].time < max(self.duration, 1e-9):
            raise ValueError("a loop needs time from its last keyframe back to the first: make it longer")
        length = float(np.linalg.norm(self.up))
        if not 0 < length < math.inf:
            raise ValueError("the up axis has no direction")
        object.__setattr__(self, "up", np.asarray(self.up, np.float64) / length)

    def frame_times(self, fps: float) -> np.ndarray:
        """(n,) float64 seconds of a film's frames."""
        return frame_times(self.duration, fps, loop=self.loop)

    def lasting(self, seconds: float) -> CameraPath:
        """The same way in another time; a single keyframe is held."""
        factor = seconds / self.duration if self.duration > 0 else 1.0
        keys = (replace(key, time=min(key.time * factor, seconds)) for key in self.keyframes)
        return replace(self, keyframes=tuple(keys), duration=seconds)

    def pose(self, time: float) -> Pose:
        """The camera at `time`, in seconds."""
        keys = self.keyframes
        if len(keys) == 1:
            return keys[0].pose
        knots = self._knots
        if self.loop:
            time = knots[0] + (time - knots[0]) % self.duration
        place = int(np.clip(np.searchsorted(knots, time, side="right") - 1, 0, len(knots) - 2))
        step = knots[place + 1] - knots[place]
        share = min(max((time - knots[place]) / step, 0.0), 1.0)
        R = matrix_of(self._turns.at(place, share, step))
        point, (zoom, fov_y, roll) = (
            self._points.at(place, share, step),
            (float(curve.at(place, share, step)[0]) for curve in self._numbers),
        )
        if self._has_roll:
            R = rolled(R, roll - roll_of(R, self.up))
        distance = math.exp(zoom)
        target = point if self.motion == "orbit" else point + distance * R[2]
        return Pose(target=target, distance=distance, R_camera_world=R, fov_y=fov_y)

    @cached_property
    def _knots(self) -> np.ndarray:
        times = [key.time for key in self.keyframes]
        return np.array([*times, times[0] + self.duration] if self.loop else times)

    @cached_property
    def _poses(self) -> list[Pose]:
        """Of the knots: in a loop the first comes again."""
        poses = [key.pose for key in self.keyframes]
        return [*poses, poses[0]] if self.loop else poses

    @cached_property
    def _has_roll(self) -> bool:
        return all(abs(float(pose.R_camera_world[2] @ self.up)) < STEEPEST for pose in self._poses)

    @cached_property
    def _points(self) -> Curve:
        poses = self._poses
        points = np.array([pose.target if self.motion == "orbit" else pose.eye for pose in poses])
        return Curve(points, self._knots, loop=self.loop)

    @cached_property
    def _numbers(self) -> tuple[Curve, Curve, Curve]:
        """Logarithm of the distance, field of view in degrees, roll in radians."""
        poses = self._poses
        rolls = [roll_of(pose.R_camera_world, self.up) if self._has_roll else 0.0 for pose in poses]
        columns = (
            [math.log(pose.distance) for pose in poses],
            [pose.fov_y for pose in poses],
            np.unwrap(rolls),
        )
        zoom, fov_y, roll = (
            Curve(np.array(column)[:, None], self._knots, loop=self.loop) for column in columns
        )
        return zoom, fov_y, roll

    @cached_property
    def _turns(self) -> RotationCurve:
        quats = [quaternion(pose.R_camera_world) for pose in self._poses]
        return RotationCurve(quats, self._knots, loop=self.loop)


def frame_times(seconds: float, fps: float, *, loop: bool) -> np.ndarray:
    """(n,) float64 seconds of a film's frames: both ends of an open way are frames, a loop's end is its
    beginning and none."""
    steps = max(round(seconds * fps), 1 if loop else 0)
    return np.arange(steps + (not loop)) * (seconds / max(steps, 1))


@dataclass(frozen=True, eq=False)
class Curve:
    """A cubic Hermite curve through `values` (n, k) at `knots` (n,), n > 1."""

    values: np.ndarray
    knots: np.ndarray
    loop: bool = field(kw_only=True)

    @cached_property
    def tangents(self) -> np.ndarray:
        steps = np.diff(self.knots)
        return tangents(np.diff(self.values, axis=0) / steps[:, None], steps, loop=self.loop)

    def at(self, place: int, share: float, step: float) -> np.ndarray:
        """(k,) at the `share` of the piece after knot `place`, which lasts `step` seconds."""
        start, end = self.values[place], self.values[place + 1]
        into, out = step * self.tangents[place], step * self.tangents[place + 1]
        # As the straight way and what bends it: exact at both ends and where nothing bends.
        bend = (1 - share) * (into - (end - start)) - share * (out - (end - start))
        return start + share * (end - start) + share * (1 - share) * bend


Quaternion = tuple[float, float, float, float]
"""(w, x, y, z) of unit length; its negative is the same rotation. Plain numbers: a pose is made of a dozen of
them, for which numpy's arrays took ten times as long."""


@dataclass(frozen=True, eq=False)
class RotationCurve:
    """The same through rotations; angular velocities are in the axes of the camera."""

    quats: Sequence[Quaternion]
    knots: np.ndarray
    loop: bool = field(kw_only=True)

    @cached_property
    def tangents(self) -> np.ndarray:
        steps = np.diff(self.knots)
        turns = [rotation_vector(product(b, conjugate(a))) for a, b in pairwise(self.quats)]
        return tangents(np.array(turns) / steps[:, None], steps, loop=self.loop)

    def at(self, place: int, share: float, step: float) -> Quaternion:
        start, end = self.quats[place], self.quats[place + 1]
        points = [
            start,
            product(exponential(self.tangents[place] * step / 3), start),
            product(exponential(-self.tangents[place + 1] * step / 3), end),
            end,
        ]
        while len(points) > 1:  # de Casteljau
            points = [slerp(a, b, share) for a, b in pairwise(points)]
        return points[0]


def tangents(slopes: np.ndarray, steps: np.ndarray, *, loop: bool) -> np.ndarray:
    """(n + 1, k) per second at the knots between and around n pieces of `slopes` (n, k) and `steps` (n,)
    seconds."""
    before, after = np.roll(slopes, 1, axis=0), slopes
    last, next_ = np.roll(steps, 1)[:, None], steps[:, None]
    found = bounded((last * after + next_ * before) / (last + next_), before, after)
    found = np.concatenate([found, found[:1]])
    if not loop:
        # The parabola through the first three knots, or the straight way between two.
        found[0], found[-1] = slopes[0], slopes[-1]
        ends = 2 * slopes[[0, -1]] - found[[1, -2]]
        found[[0, -1]] = bounded(ends, slopes[[0, -1]], slopes[[0, -1]])
    return found


def bounded(wanted: np.ndarray, before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Tangents (n, k) no longer than three times either slope beside them."""
    most = 3 * np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
    length = np.linalg.norm(wanted, axis=1)
    return wanted * np.minimum(1.0, most / np.maximum(length, 1e-300))[:, None]


def product(a: Quaternion, b: Quaternion) -> Quaternion:
    """The rotation `b`, then `a`."""
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def conjugate(quat: Quaternion) -> Quaternion:
    w, x, y, z = quat
    return w, -x, -y, -z


def exponential(vector: np.ndarray) -> Quaternion:
    """The turn by |vector| radians about `vector` (3,)."""
    x, y, z = (0.5 * float(part) for part in vector)
    half = math.hypot(x, y, z)
    factor = math.sin(half) / half if half > 0 else 1.0
    return math.cos(half), factor * x, factor * y, factor * z


def rotation_vector(quat: Quaternion) -> np.ndarray:
    """(3,) the inverse, of at most half a turn."""
    w, x, y, z = quat
    sine = math.hypot(x, y, z)
    angle = 2 * math.atan2(sine, abs(w))
    return math.copysign(angle / sine if sine > 0 else 2.0, w) * np.array((x, y, z))


def slerp(a: Quaternion, b: Quaternion, share: float) -> Quaternion:
    """The shortest turn from `a` to `b`, evenly."""
    if sum(p * q for p, q in zip(a, b, strict=True)) < 0:
        b = (-b[0], -b[1], -b[2], -b[3])
    apart = math.hypot(*(q - p for p, q in zip(a, b, strict=True)))
    angle = 2 * math.atan2(apart, math.hypot(*(q + p for p, q in zip(a, b, strict=True))))
    sine = math.sin(angle)
    from_a = math.sin((1 - share) * angle) / sine if sine > 0 else 1 - share
    from_b = math.sin(share * angle) / sine if sine > 0 else share
    w, x, y, z = (from_a * p + from_b * q for p, q in zip(a, b, strict=True))
    return w, x, y, z


def quaternion(R: np.ndarray) -> Quaternion:
    """Of a rotation (3, 3), to rounding."""
    (a, b, c), (d, e, f), (g, h, i) = R.tolist()
    # Four times the products of the largest part with all: no difference of large numbers is divided by.
    w, x, y, z = max(
        (1 + a + e + i, h - f, c - g, d - b),
        (h - f, 1 + a - e - i, b + d, c + g),
        (c - g, b + d, 1 - a + e - i, f + h),
        (d - b, c + g, f + h, 1 - a - e + i),
        key=max,
    )
    length = math.hypot(w, x, y, z)
    return w / length, x / length, y / length, z / length


def matrix_of(quat: Quaternion) -> np.ndarray:
    """(3, 3) float64, a rotation to rounding."""
    length = math.hypot(*quat)
    w, x, y, z = (part / length for part in quat)
    return np.array(
        (
            (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
            (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
            (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
        )
    )


def roll_of(R: np.ndarray, up: np.ndarray) -> float:
    """Radians about its viewing axis by which a camera is off the level; `up` is no viewing axis."""
    x, _, z = R.tolist()
    right = cross(z, up.tolist())
    return math.atan2(dot(x, cross(z, right)), dot(x, right))


def cross(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def dot(a: Sequence[float], b: Sequence[float]) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def rolled(R: np.ndarray, angle: float) -> np.ndarray:
    """The camera turned about its viewing axis, so that `roll_of` grows by `angle`."""
    cos, sin = math.cos(angle), math.sin(angle)
    return np.array((cos * R[0] + sin * R[1], cos * R[1] - sin * R[0], R[2]))


def turntable(pose: Pose, up: np.ndarray, seconds: float) -> CameraPath:
    """One turn of the eye about the axis `up` (3,) through the pose's target, evenly."""
    camera = pose.camera(1, 1)
    keys = []
    for quarter in range(QUARTERS):
        turned = orbited(camera, pose.target, up, 360.0 * quarter / QUARTERS).R_camera_world
        keys.append(Keyframe(time=seconds * quarter / QUARTERS, pose=replace(pose, R_camera_world=turned)))
    return CameraPath(keyframes=tuple(keys), duration=seconds, loop=True, motion="orbit", up=up)
