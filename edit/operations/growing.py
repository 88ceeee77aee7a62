"""Growing and shrinking the selection by nearness."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ...scene.edits import SELECTED
from ..changes import Change
from ..selecting import grow, shrink
from ..selecting.checks import above_zero
from ..watch import UNWATCHED, Watch
from .operation import Operation
from .select import MODES, selection

if TYPE_CHECKING:
    from ..document import Document


@dataclass(frozen=True, kw_only=True)
class _ByNearness(Operation):
    distance: float | None = None
    """Between the means of splats, world units, above 0."""
    neighbours: int | None = None
    """Instead: two splats are near where one is among so many nearest of the other."""

    def __post_init__(self) -> None:
        if (self.distance is None) == (self.neighbours is None):
            raise ValueError("give either distance or neighbours")
        if self.distance is not None:
            above_zero("distance", self.distance)
        if self.neighbours is not None and not 1 <= self.neighbours <= 64:
            raise ValueError(f"neighbours must be in 1 to 64, got {self.neighbours}")

    @property
    def _by(self) -> str:
        if self.distance is not None:
            return f"by {self.distance:g}"
        return f"by {self.neighbours} neighbours"


@dataclass(frozen=True, kw_only=True)
class Grow(_ByNearness):
    op: ClassVar[str] = "grow"
    summary: ClassVar[str] = "Select also what is near the selection"

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        mask = (document.marks & SELECTED) != 0
        mask = grow(
            mask,
            document.gaussians,
            document.edits,
            distance=self.distance,
            neighbours=self.neighbours,
            watch=watch,
        )
        return selection(document, mask, MODES["add"], f"Grow {self._by}")


@dataclass(frozen=True, kw_only=True)
class Shrink(_ByNearness):
    op: ClassVar[str] = "shrink"
    summary: ClassVar[str] = "Deselect what is near to splats that are not selected"

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        mask = (document.marks & SELECTED) != 0
        mask = shrink(
            mask,
            document.gaussians,
            document.edits,
            distance=self.distance,
            neighbours=self.neighbours,
            watch=watch,
        )
        return selection(document, mask, MODES["intersect"], f"Shrink {self._by}")
