"""What any operation costs: the pictures of the scene after it against those before, on one renderer.

`price` knows deletions, which are a mask; repairs write other values, moves and grades other looks: here the
change itself is made, on a copy of what it alters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ..scene import Camera, Gaussians
from ..scene.edits import DELETED, HIDDEN, LOCKED, SELECTED, SceneEdits, shown
from .changes import Change, SaveOnce
from .document import Document
from .operations import Operation
from .price import Price, compare, price_of, unchanging
from .state import State
from .watch import UNWATCHED, Watch


def price_operations(
    document: Document,
    operations: Mapping[str, Operation],
    cameras: Sequence[Camera],
    *,
    watch: Watch = UNWATCHED,
) -> dict[str, Price]:
    """The price of each of `operations` by itself, by its key, over the views of `cameras`.

    The document is only read, so that this may run in a thread while nobody edits. Views are drawn once
    before, and once after each operation.

    Raises:
        InputError: an operation cannot be done here, or there is no renderer.
        Cancelled: the watch says so.
    """
    before = document.gaussians, unchanging(document.edits)
    planned = {name: document.plan(operation).change for name, operation in operations.items()}
    afters = {name: after(document, change) for name, change in planned.items()}
    views = {name: [] for name in operations}
    work = max(len(cameras) * (1 + len(afters)), 1)
    done = 0
    for camera in cameras:
        watch.step(done / work)
        first = document.tools.render(before[0], camera, before[1])
        done += 1
        for name, (gaussians, edits) in afters.items():
            watch.step(done / work)
            views[name].append(compare(camera, first, document.tools.render(gaussians, camera, edits)))
            done += 1
    watch.step(1.0)
    return {name: price_of(_shown_less(before, afters[name]), views[name]) for name in operations}


def after(document: Document, change: Change) -> tuple[Gaussians, SceneEdits]:
    """Scene and edits as `change`, planned for `document` as it is, would leave them; nothing is altered, and
    no file written."""
    state, now = State(document.gaussians), document.state
    state.marks = now.marks.copy()
    state.palette, state.crops = now.palette, now.crops
    for part in change.parts:
        if not isinstance(part, SaveOnce):
            part.apply(state)
    flags = int(np.bitwise_or.reduce(state.marks, initial=np.uint32(0)))
    edits = replace(
        document.edits,
        marks=state.marks,
        palette=state.palette,
        crops=state.crops,
        marks_version=document.edits.marks_version + 1,
        palette_version=document.edits.palette_version + 1,
        crops_version=document.edits.crops_version + 1,
        changes=(),
        flags=flags & (SELECTED | HIDDEN | DELETED | LOCKED),
    )
    return state.gaussians, edits


class StepPrices:
    """The price of one step after the other, of a document that is being replayed."""

    def __init__(self, document: Document, cameras: Sequence[Camera]) -> None:
        self._document, self._cameras = document, cameras
        self._before = document.gaussians, unchanging(document.edits)
        self._pictures = self._draw(self._before)

    def after_step(self) -> Price:
        """Of what was done since the last time. Raises InputError where there is no renderer."""
        now = self._document.gaussians, unchanging(self._document.edits)
        pictures = self._draw(now)
        views = [compare(*one) for one in zip(self._cameras, self._pictures, pictures, strict=True)]
        price = price_of(_shown_less(self._before, now), views)
        self._before, self._pictures = now, pictures
        return price

    def _draw(self, scene: tuple[Gaussians, SceneEdits]) -> list[np.ndarray]:
        gaussians, edits = scene
        return [self._document.tools.render(gaussians, camera, edits) for camera in self._cameras]


def _shown_less(before: tuple[Gaussians, SceneEdits], after: tuple[Gaussians, SceneEdits]) -> int:
    """How many splats of `before` are not shown any more; those that were added come behind them."""
    were, are = shown(*before), shown(*after)
    return int(np.count_nonzero(were & ~are[: len(were)])) if len(are) >= len(were) else len(were) - len(are)


def in_words(price: Price) -> str:
    """One line: how far the pictures stay from each other."""
    if price.largest_error == 0:
        return f"no pixel of {price.views} views changes"
    return (
        f"pictures stay at {price.mean:.1f} dB on average, {price.worst:.1f} dB at worst, over {price.views} "
        f"views; no pixel changes by more than {price.largest_error * 255:.0f}/255"
    )
