"""Operations that delete what detectors find, or all but the splats that matter most."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from ...scene import Camera, InputError
from ...scene.edits import DELETED, HIDDEN, LOCKED
from .. import detecting
from ..changes import Change, splats_in_words
from ..json_form import to_json
from ..watch import UNWATCHED, Watch
from .operation import Operation
from .scope import deleting
from .select import kind_of, one_of

if TYPE_CHECKING:
    from ..document import Document


@dataclass(frozen=True, kw_only=True)
class Prune(Operation):
    """In JSON `by` is an object whose ``kind`` is a name in DETECTORS, its other keys that one's fields."""

    op: ClassVar[str] = "prune"
    summary: ClassVar[str] = "Delete floaters, needles, giants, faint or unseen splats above a threshold"

    by: Any
    """One of DETECTORS."""
    threshold: float
    """What scores above it is deleted."""
    cameras: tuple[Camera, ...] = ()
    """Views, for detectors that look at pictures; none: views from around the scene."""

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        scores = document.scores(self.by, self.cameras, watch=watch)
        doomed = self.by.mask(scores, self.threshold) & editable(document)
        title = f"Prune {splats_in_words(int(np.count_nonzero(doomed)))} by {kind_of(self.by)}"
        return deleting(document, doomed, title)

    def to_json(self) -> dict[str, Any]:
        by = {"kind": kind_of(self.by), **to_json(self.by)}
        return {"op": self.op, "by": by, "threshold": self.threshold, "cameras": to_json(self.cameras)}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        return super().from_json({**data, **one_of(detecting.DETECTORS, data, "by")})


@dataclass(frozen=True, kw_only=True)
class Decimate(Operation):
    op: ClassVar[str] = "decimate"
    summary: ClassVar[str] = "Delete the splats that contribute least to the views until so many are left"

    keep: int
    """Splats left; hidden, locked and cropped ones count, but are not deleted."""
    cameras: tuple[Camera, ...] = ()
    """The views that decide; none: views from around the scene."""

    def __post_init__(self) -> None:
        if not self.keep >= 1:
            raise ValueError(f"keep must be at least 1, got {self.keep}")

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        return deleting(document, self.doomed(document, watch), f"Decimate to {splats_in_words(self.keep)}")

    def doomed(self, document: Document, watch: Watch = UNWATCHED) -> np.ndarray:
        """Which splats it would delete, (N,) bool: of equal contributions the later ones.

        Raises:
            InputError: too many cannot be deleted, or there is no renderer.
            Cancelled: the watch says so.
        """
        at = np.flatnonzero(editable(document))[::-1]
        excess = document.counts.kept - self.keep
        if excess > len(at):
            raise InputError(
                f"keep {self.keep:,}: {document.counts.kept - len(at):,} splats are hidden, locked or "
                "cropped away and cannot be deleted"
            )
        doomed = np.zeros(len(document.marks), bool)
        if excess > 0:
            worth = document.contributions(self.cameras, watch=watch)[at]
            doomed[at[np.argsort(worth, kind="stable")[:excess]]] = True
        return doomed


def editable(document: Document) -> np.ndarray:
    """(N,) bool: in sight and not locked."""
    free = (document.marks & (HIDDEN | DELETED | LOCKED)) == 0
    visible = document.cropped_in()
    return free & visible if len(visible) else free
