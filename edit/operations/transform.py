"""Operations that move splats: transforms, and setting a scene upright."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from splatview.edit.changes import Change
from splatview.edit.kernels.marks import positions_of
from splatview.edit.operations.base import Operation, Scope, adjusting, check_scope, splats_of
from splatview.edit.state import State
from splatview.scene import InputError
from splatview.scene.edits import IDENTITY_ROTATION, Adjustment, Four, Vector
from splatview.scene.framing import WORLD_UP
from splatview.scene.progress import NO_PROGRESS, Progress
from splatview.scene.projection import rotation_matrices

SAMPLE = 200_000
"""Splats sampled to find the side of the ground on which the scene is."""


@dataclass(frozen=True, kw_only=True)
class Transform(Operation):
    """x' = pivot + translation + scale·R·(x - pivot); rotation turns spherical harmonics along."""

    op: ClassVar[str] = "transform"
    summary: ClassVar[str] = "Move, turn and scale the selection or the whole scene"

    scope: Scope = "selection"
    rotation: Four = IDENTITY_ROTATION
    """wxyz of any length above 0."""
    translation: Vector = (0.0, 0.0, 0.0)
    """World units."""
    scale: float = 1.0
    """Above 0."""
    pivot: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_scope(self.scope)
        check_similarity(self.rotation, self.scale)
        check_places(translation=self.translation, pivot=self.pivot)

    @property
    def adjustment(self) -> Adjustment:
        return similarity(
            unit_quat(np.array(self.rotation)), np.array(self.translation), self.scale, np.array(self.pivot)
        )

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return adjusting(state, self.scope, self.adjustment, "Transform")


@dataclass(frozen=True, kw_only=True)
class Orient(Operation):
    op: ClassVar[str] = "orient"
    summary: ClassVar[str] = "Turn the whole scene so that a direction in it points up (to -y)"

    up: Vector
    """The direction, as the scene is now."""
    pivot: Vector = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        check_places(up=self.up, pivot=self.pivot)
        if not any(self.up):
            raise ValueError("up must not be 0, 0, 0: that is no direction")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        rotation = turn_between(np.array(self.up), np.array(WORLD_UP))
        adjustment = similarity(rotation, np.zeros(3), 1.0, np.array(self.pivot))
        return adjusting(state, "scene", adjustment, "Set up axis of")


@dataclass(frozen=True, kw_only=True)
class Ground(Operation):
    """The side of the plane on which most splats are becomes its upper side."""

    op: ClassVar[str] = "ground"
    summary: ClassVar[str] = "Turn and shift the whole scene so that three points lie on the ground, y = 0"

    points: tuple[Vector, Vector, Vector]

    def __post_init__(self) -> None:
        for i, point in enumerate(self.points):
            check_places(**{f"points[{i}]": point})
        first, second, third = np.array(self.points, np.float64)
        sides = (second - first, third - first, third - second)
        area = np.linalg.norm(np.cross(sides[0], sides[1]))
        if not area > 1e-6 * max(float(side @ side) for side in sides):
            raise ValueError("points must not lie on one line")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        first, second, third = np.array(self.points, np.float64)
        normal = np.cross(second - first, third - first)
        normal /= np.linalg.norm(normal)
        centre = (first + second + third) / 3
        if self._above(state, normal, centre) < 0:
            normal = -normal
        shift = np.array([0.0, -centre[1], 0.0])
        adjustment = similarity(turn_between(normal, np.array(WORLD_UP)), shift, 1.0, centre)
        return adjusting(state, "scene", adjustment, "Set on the ground")

    def _above(self, state: State, normal: np.ndarray, centre: np.ndarray) -> float:
        """Above 0 where the scene is on the side to which `normal` points."""
        splats = splats_of(state, "scene").indices
        splats = splats[:: max(1, len(splats) // SAMPLE)]
        with np.errstate(invalid="ignore", over="ignore"):
            heights = (positions_of(state.gaussians, state.edits)[splats] - centre) @ normal
        balance = int((heights > 0).sum()) - int((heights < 0).sum())
        return balance or float(normal @ np.array(WORLD_UP))


def check_similarity(rotation: Four, scale: float) -> None:
    """Raises ValueError where `rotation` is no quaternion wxyz, or `scale` no usable factor."""
    if not 1e-100 < math.hypot(*rotation) < 1e100:
        raise ValueError(f"rotation must be a quaternion wxyz that is not zero, got {list(rotation)}")
    if not 1e-9 <= scale <= 1e9:
        name = "above 0" if not scale > 0 else "in 1e-9 to 1e9"
        raise ValueError(f"scale must be {name}, got {scale:g}")


def check_places(**vectors: Vector) -> None:
    """Raises ValueError for coordinates too large to compute with."""
    for name, values in vectors.items():
        if not (len(values) == 3 and all(abs(value) <= 1e15 for value in values)):
            raise ValueError(f"{name} must be three numbers of at most 1e15, got {list(values)}")


def unit_quat(quat: np.ndarray) -> np.ndarray:
    scaled = quat / np.abs(quat).max()
    return scaled / np.linalg.norm(scaled)


def similarity(rotation: np.ndarray, shift: np.ndarray, scale: float, pivot: np.ndarray) -> Adjustment:
    """x' = pivot + shift + scale·R·(x - pivot)."""
    w, x, y, z = rotation.tolist()
    tx, ty, tz = (pivot + shift - scale * (rotation_matrices(rotation[None])[0] @ pivot)).tolist()
    try:
        return Adjustment(rotation=(w, x, y, z), scale=float(scale), translation=(tx, ty, tz))
    except ValueError as error:
        raise InputError(str(error)) from None


def turn_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """The shortest rotation, wxyz, that takes the direction `start` to `end`."""
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    half = a + b
    length = float(np.linalg.norm(half))
    if not length > 1e-9:
        # Opposite: half a turn about any axis across.
        axis = np.cross(a, np.eye(3)[int(np.argmin(np.abs(a)))])
        return np.array([0.0, *(axis / np.linalg.norm(axis))])
    half /= length
    return unit_quat(np.array([float(a @ half), *np.cross(a, half)]))
