"""Operations on the selection."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np

from splatview.edit import detectors as detecting
from splatview.edit import selectors as selecting
from splatview.edit.changes import Change, toggling
from splatview.edit.kernels import marks as kernels
from splatview.edit.operations.base import Operation
from splatview.edit.selectors.base import above_zero
from splatview.edit.selectors.region_growing import grow, shrink
from splatview.edit.serialization import from_json, quoted, to_json
from splatview.edit.state import SplatSet, State
from splatview.scene import InputError
from splatview.scene.edits import SELECTED
from splatview.scene.progress import NO_PROGRESS, Progress

Mode = Literal["set", "add", "remove", "intersect"]

MODES: dict[str, int] = {"set": 0b1010, "add": 0b1110, "remove": 0b0100, "intersect": 0b1000}
INVERT = 0b0110
"""Whether splats are selected afterwards that are selected and hit, only selected, only hit, neither: see
`kernels.selection_change`."""

VERBS = {"set": "Select", "add": "Add", "remove": "Deselect", "intersect": "Keep selected"}


@dataclass(frozen=True, kw_only=True)
class Select(Operation):
    """In JSON `by` is an object whose ``kind`` is a name in SELECTORS, its other keys the fields of that
    selector."""

    op: ClassVar[str] = "select"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Select splats by a shape, by colour, by a range of an attribute, ..."

    by: Any
    """One of SELECTORS: says which splats are hit."""
    mode: Mode = "set"

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise ValueError(f"mode must be one of {', '.join(MODES)}, got {self.mode!r}")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        hits = self.by.mask(state.gaussians, state.edits, state.tools, progress=progress)
        return selection(state, hits, MODES[self.mode], f"{VERBS[self.mode]} by {kind_of(self.by)}")

    def to_json(self) -> dict[str, Any]:
        return {"op": self.op, "by": {"kind": kind_of(self.by), **to_json(self.by)}, "mode": self.mode}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        return super().from_json({**data, **one_of(selecting.SELECTORS, data, "by")})


def kind_of(selector: Any) -> str:
    """The name of a selector or detector in its registry."""
    for kind, cls in (*selecting.SELECTORS.items(), *detecting.DETECTORS.items()):
        if type(selector) is cls:
            return kind
    raise ValueError(f"by must be a selector or a detector, got {type(selector).__name__}")


def one_of(registry: dict[str, type], data: dict[str, Any], key: str) -> dict[str, Any]:
    """{key: the object of `registry` that data[key] describes by ``kind``}; {} where there is no such key.

    Raises:
        InputError: it describes none.
    """
    if key not in data:
        return {}
    described = data[key]
    if not isinstance(described, dict) or "kind" not in described:
        raise InputError(f"{key} must be an object with a kind, one of {', '.join(sorted(registry))}")
    rest = dict(described)
    kind = rest.pop("kind")
    if not isinstance(kind, str) or kind not in registry:
        raise InputError(f"{key}: unknown kind {quoted(kind)}; there are {', '.join(sorted(registry))}")
    try:
        return {key: from_json(registry[kind], rest)}
    except InputError as error:
        raise InputError(f"{key}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class SelectAll(Operation):
    op: ClassVar[str] = "select_all"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Select everything that is shown and not locked"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return selection(state, np.ones(len(state.marks), bool), MODES["set"], "Select all")


@dataclass(frozen=True, kw_only=True)
class SelectNone(Operation):
    op: ClassVar[str] = "select_none"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Select nothing"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return toggling(state.selected, SELECTED, "Select none")


@dataclass(frozen=True, kw_only=True)
class SelectInverse(Operation):
    op: ClassVar[str] = "select_inverse"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Swap what is selected with what is not"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return selection(state, np.ones(len(state.marks), bool), INVERT, "Invert the selection")


def selection(state: State, hits: np.ndarray, mode: int, title: str) -> Change:
    """The change to the selection by `hits` (N,) bool; its title ends with what is selected afterwards."""
    hits = np.ascontiguousarray(hits, bool)
    visible = state.cropped_in()
    if not len(visible):
        visible = hits
    changed = kernels.selection_change(state.marks, hits, visible, mode)
    selected = np.count_nonzero(((state.marks & SELECTED) != 0) != changed)
    return toggling(SplatSet.of_mask(changed), SELECTED, f"{title}: {selected:,} selected")


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

    def _plan(self, grown: Callable[..., np.ndarray], state: State, mode: str, progress: Progress) -> Change:
        mask = (state.marks & SELECTED) != 0
        options = {"distance": self.distance, "neighbours": self.neighbours, "progress": progress}
        hits = grown(mask, state.gaussians, state.edits, **options)
        by = f"{self.neighbours} neighbours" if self.distance is None else f"{self.distance:g}"
        return selection(state, hits, MODES[mode], f"{self.op.capitalize()} by {by}")


class Grow(_ByNearness):
    op = "grow"
    alters_file = False
    summary = "Select also what is near the selection"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return self._plan(grow, state, "add", progress)


class Shrink(_ByNearness):
    op = "shrink"
    alters_file = False
    summary = "Deselect what is near to splats that are not selected"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return self._plan(shrink, state, "intersect", progress)
