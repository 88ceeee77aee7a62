"""Operations on the appearance of splats: size, opacity, colour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from splatview.edit.changes import Change, Rewrite, splats_in_words
from splatview.edit.operations.base import (
    Operation,
    Scope,
    adjusting,
    check_scope,
    require_rewrite,
    splats_of,
)
from splatview.edit.state import SplatSet, State
from splatview.scene.edits import PALETTE_SHIFT, Adjustment, Four
from splatview.scene.progress import NO_PROGRESS, Progress

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
"""Luminance of red, green and blue (ITU-R BT.709)."""

STOPS = 0.5
"""Powers of two by which a temperature or tint of 1 makes a channel brighter or darker."""


@dataclass(frozen=True, kw_only=True)
class Grade:
    """A colour grade as one affine map of display colours, which spherical harmonics carry exactly. The
    defaults change nothing.

    The steps, in this order, on rgb with 0 black and 1 white:

    - levels: (rgb - black) / (white - black) - temperature t and tint m: channel gains 2^(t/2), 2^(-m/2),
    2^(-t/2), divided by the luminance of their sum, so that greys keep their brightness; a warm t adds red, a
    positive m takes green - saturation s: Y + s·(rgb - Y), Y the luminance, of display values as editors take
    it - contrast c: ½ + c·(rgb - ½) - brightness b: rgb + b

    Raises:
        ValueError: a number is out of range; the message names it.
    """

    brightness: float = 0.0
    """-1 to 1, added."""
    contrast: float = 1.0
    """0 to 10."""
    saturation: float = 1.0
    """0 (grey) to 10."""
    temperature: float = 0.0
    """-1 (cold) to 1 (warm)."""
    tint: float = 0.0
    """-1 (green) to 1 (magenta)."""
    black: float = 0.0
    """The level that becomes 0, -1 to 2."""
    white: float = 1.0
    """The level that becomes 1, -1 to 2, at least 0.001 above black."""

    def __post_init__(self) -> None:
        ranges = {
            "brightness": (-1, 1),
            "contrast": (0, 10),
            "saturation": (0, 10),
            "temperature": (-1, 1),
            "tint": (-1, 1),
            "black": (-1, 2),
            "white": (-1, 2),
        }
        for name, (low, high) in ranges.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} must be in {low} to {high}, got {getattr(self, name)}")
        if not self.white - self.black >= 0.001:
            raise ValueError(f"white must be at least 0.001 above black, got {self.white} and {self.black}")

    @property
    def matrix(self) -> np.ndarray:
        """(3, 4) float64: A beside b of rgb' = A·rgb + b."""
        span = self.white - self.black
        levels = _affine(np.eye(3) / span, np.full(3, -self.black / span))
        gains = np.exp2(np.array([self.temperature, -self.tint, -self.temperature]) * STOPS)
        balance = _affine(np.diag(gains / (LUMINANCE @ gains)), np.zeros(3))
        grey = np.tile(LUMINANCE, (3, 1))
        saturation = _affine(grey + self.saturation * (np.eye(3) - grey), np.zeros(3))
        contrast = _affine(np.eye(3) * self.contrast, np.full(3, 0.5 - 0.5 * self.contrast))
        brightness = _affine(np.eye(3), np.full(3, self.brightness))
        return (brightness @ contrast @ saturation @ balance @ levels)[:3]


def _affine(A: np.ndarray, b: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = A, b
    return matrix


How = Literal["scale", "set"]


def _check_how(how: str) -> None:
    if how not in ("scale", "set"):
        raise ValueError(f"how must be scale or set, got {how!r}")


@dataclass(frozen=True, kw_only=True)
class Opacity(Operation):
    op: ClassVar[str] = "opacity"
    summary: ClassVar[str] = "Set the opacity of splats, or multiply it"

    value: float
    """The opacity, 0 to 1, or the factor, 0 to 1000."""
    how: How = "scale"
    scope: Scope = "selection"

    def __post_init__(self) -> None:
        check_scope(self.scope)
        _check_how(self.how)
        high = 1 if self.how == "set" else 1000
        if not 0 <= self.value <= high:
            raise ValueError(f"value must be in 0 to {high} to {self.how} opacities, got {self.value:g}")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        value = float(self.value)
        opacity = (0.0, value, 0.0, 1.0) if self.how == "set" else (value, 0.0, 0.0, 1.0)
        verb = f"Opacity {value:g}:" if self.how == "set" else f"Opacity x {value:g}:"
        return adjusting(state, self.scope, Adjustment(opacity=opacity), verb)


@dataclass(frozen=True, kw_only=True)
class Size(Operation):
    """Setting gives each splat that size and leaves it its shape; it makes a new array of log-scales,
    where everything else about sizes is an adjustment."""

    op: ClassVar[str] = "size"
    summary: ClassVar[str] = "Set the size of splats, or multiply it, each about its own centre"

    value: float
    """The factor, or the geometric mean of the three standard deviations in world units; 1e-9 to 1e9."""
    how: How = "scale"
    scope: Scope = "selection"

    def __post_init__(self) -> None:
        check_scope(self.scope)
        _check_how(self.how)
        if not 1e-9 <= self.value <= 1e9:
            raise ValueError(f"value must be in 1e-9 to 1e9, got {self.value:g}")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        if self.how == "scale":
            adjustment = Adjustment(size=float(self.value))
            return adjusting(state, self.scope, adjustment, f"Size x {self.value:g}:")
        splats = splats_of(state, self.scope)
        require_rewrite(state, "log_scales", len(splats))
        at = splats.indices
        before = state.gaussians.log_scales[at]
        factors = np.array([entry.scale * entry.size for entry in state.palette])
        target = math.log(self.value) - np.log(factors)[state.marks[at] >> PALETTE_SHIFT]
        with np.errstate(invalid="ignore"):
            values = before.astype(np.float64)
            values += (target - values.mean(axis=1))[:, None]
        # Splats of non-finite scales have no shape to keep.
        finite = np.isfinite(values).all(axis=1)
        mask = np.zeros(len(state.marks), bool)
        mask[at[finite]] = True
        part = Rewrite(
            "log_scales", SplatSet.of_mask(mask), before[finite], values[finite].astype(np.float32)
        )
        count = int(finite.sum())
        return Change(
            title=f"Size {self.value:g}: {splats_in_words(count)}",
            count=count,
            parts=(part,) if count else (),
        )


@dataclass(frozen=True, kw_only=True)
class ColourGrade(Operation):
    op: ClassVar[str] = "grade"
    summary: ClassVar[str] = "Brightness, contrast, saturation, temperature, tint and levels"

    grade: Grade
    scope: Scope = "scene"

    def __post_init__(self) -> None:
        check_scope(self.scope)

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        first, second, third = (_four(row) for row in self.grade.matrix)
        return adjusting(state, self.scope, Adjustment(colour=(first, second, third)), "Grade colours of")


def _four(row: np.ndarray) -> Four:
    a, b, c, d = row.tolist()
    return (a, b, c, d)
