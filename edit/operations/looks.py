"""Operations that change how splats look where they are: size, opacity, colour."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np

from ...scene.adjustment import Adjustment, Four
from ...scene.edits import PALETTE_SHIFT
from ..changes import Change, Rewrite, splats_in_words
from ..grade import Grade
from ..runs import SplatSet
from ..watch import UNWATCHED, Watch
from .operation import Operation
from .scope import Scope, adjusting, check_scope, splats_of

if TYPE_CHECKING:
    from ..document import Document

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

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        value = float(self.value)
        opacity = (0.0, value, 0.0, 1.0) if self.how == "set" else (value, 0.0, 0.0, 1.0)
        verb = f"Opacity {value:g}:" if self.how == "set" else f"Opacity x {value:g}:"
        return adjusting(document, self.scope, Adjustment(opacity=opacity), verb)


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

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        if self.how == "scale":
            adjustment = Adjustment(size=float(self.value))
            return adjusting(document, self.scope, adjustment, f"Size x {self.value:g}:")
        splats = splats_of(document, self.scope)
        at = splats.indices
        before = document.gaussians.log_scales[at]
        factors = np.array([entry.scale * entry.size for entry in document.palette])
        wanted = math.log(self.value) - np.log(factors)[document.marks[at] >> PALETTE_SHIFT]
        with np.errstate(invalid="ignore"):
            values = before.astype(np.float64)
            values += (wanted - values.mean(axis=1))[:, None]
        # What is not finite has no shape to keep.
        sound = np.isfinite(values).all(axis=1)
        chosen = np.zeros(len(document.marks), bool)
        chosen[at[sound]] = True
        part = Rewrite(
            "log_scales", SplatSet.of_mask(chosen), before[sound], values[sound].astype(np.float32)
        )
        count = int(sound.sum())
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

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        first, second, third = (_four(row) for row in self.grade.matrix)
        return adjusting(document, self.scope, Adjustment(colour=(first, second, third)), "Grade colours of")


def _four(row: np.ndarray) -> Four:
    a, b, c, d = row.tolist()
    return (a, b, c, d)
