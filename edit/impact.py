"""What an edit costs: how much the pictures change, measured before one accepts it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatview.edit.changes import Change, SaveOnce
from splatview.edit.document import Document
from splatview.edit.operations import Operation
from splatview.edit.progress import UNWATCHED, Tools, Watch
from splatview.edit.state import State
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import DELETED, HIDDEN, LOCKED, SELECTED, SceneEdits, shown

NO_LOSS = 100.0
"""dB: an error of 1e-5, a hundredth of what an 8-bit picture can show. Pictures that differ less count as
so far apart, or views that an edit does not touch would make every mean infinite."""


@dataclass(frozen=True, kw_only=True)
class ViewPrice:
    """How much one view changes."""

    camera: Camera
    psnr: float
    """dB, the picture after against the one before, RGB in [0, 1]; at most NO_LOSS."""
    largest_error: float
    """Of any pixel and channel, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class Price:
    """How much all views change."""

    count: int
    """Splats that are shown before and not after."""
    mean: float
    """dB, over views; NO_LOSS where nothing changes or there are no views."""
    worst: float
    """dB, of the view that changes most."""
    largest_error: float
    """0 to 1, over all views."""
    views: int
    """How many there were."""


def price(
    gaussians: Gaussians,
    before: SceneEdits,
    after: SceneEdits,
    tools: Tools,
    cameras: Sequence[Camera],
    *,
    watch: Watch = UNWATCHED,
) -> Price:
    """The loss of going from `before` to `after`, over the views of `cameras`. Raises Cancelled."""
    views = price_views(gaussians, before, after, tools, cameras, watch=watch)
    return price_of(shown_less(gaussians, before, after), views)


def price_views(
    gaussians: Gaussians,
    before: SceneEdits,
    after: SceneEdits,
    tools: Tools,
    cameras: Sequence[Camera],
    *,
    watch: Watch = UNWATCHED,
) -> Iterator[ViewPrice]:
    """View by view, so that a window can show what is known so far and stop when it wants.

    The edits must not change meanwhile; `with_deleted` makes some that do not. Raises Cancelled.
    """
    for i, camera in enumerate(cameras):
        watch.step(i / len(cameras))
        first = tools.picture(gaussians, camera, before)
        watch.step((i + 0.5) / len(cameras))
        yield compare(camera, first, tools.picture(gaussians, camera, after))
    watch.step(1.0)


def compare(camera: Camera, before: np.ndarray, after: np.ndarray) -> ViewPrice:
    """Of two pictures (H, W, 4) float32 of one view. NaN in a picture makes the result NaN."""
    difference = np.clip(before[..., :3], 0, 1) - np.clip(after[..., :3], 0, 1)
    error = float(np.mean(np.square(difference), dtype=np.float64))
    psnr = NO_LOSS if error == 0 else min(NO_LOSS, -10 * math.log10(error))
    return ViewPrice(
        camera=camera,
        psnr=math.nan if math.isnan(error) else psnr,
        largest_error=float(np.abs(difference).max(initial=0.0)),
    )


def price_of(count: int, views: Iterable[ViewPrice]) -> Price:
    """All in one; of the views so far, while there are more to come."""
    views = list(views)
    decibels = np.array([view.psnr for view in views] or [NO_LOSS])
    return Price(
        count=count,
        mean=float(decibels.mean()),
        worst=float(decibels.min()),
        largest_error=float(np.max([view.largest_error for view in views], initial=0.0)),
        views=len(views),
    )


def shown_less(gaussians: Gaussians, before: SceneEdits, after: SceneEdits) -> int:
    """How many splats are shown before and not after."""
    return int(np.count_nonzero(shown(gaussians, before) & ~shown(gaussians, after)))


def with_deleted(edits: SceneEdits, mask: np.ndarray) -> SceneEdits:
    """`edits` as if the splats in `mask` (N,) bool were deleted too; shares nothing that changes."""
    marks = edits.marks | np.where(mask, np.uint32(DELETED), np.uint32(0))
    return replace(
        edits,
        marks=marks,
        marks_version=edits.marks_version + 1,
        changes=(),
        flags=edits.flags | DELETED,
    )


def unchanging(edits: SceneEdits) -> SceneEdits:
    """`edits` as they are now, whatever the editor does next."""
    return replace(edits, marks=edits.marks.copy())


def decimate(
    gaussians: Gaussians,
    edits: SceneEdits,
    tools: Tools,
    cameras: Sequence[Camera],
    target: int,
    *,
    watch: Watch = UNWATCHED,
) -> np.ndarray:
    """Which splats to drop so that `target` of those shown stay, (N,) bool: those that contribute least.

    Of equal contributions the later splat goes. None where no more are shown. Raises Cancelled.

    Raises:
        ValueError: `target` is below 0, or there are no cameras.
    """
    if not target >= 0:
        raise ValueError(f"target must be at least 0, got {target}")
    if not cameras:
        raise ValueError("decimating needs at least one camera")
    from splatview.edit.detectors import contributions

    indices = np.flatnonzero(shown(gaussians, edits))
    mask = np.zeros(len(gaussians), bool)
    if target < len(indices):
        worth = contributions(gaussians, edits, tools, cameras, watch=watch)[indices]
        order = np.argsort(-np.nan_to_num(worth, nan=0.0), kind="stable")
        mask[indices[order[target:]]] = True
    return mask


# ---- What any operation costs: the pictures of the scene after it against those before, on one renderer.
#
# `price` knows deletions, which are a mask; repairs write other values, moves and grades other looks: here
# the change itself is made, on a copy of what it alters.


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
        first = document.tools.picture(before[0], camera, before[1])
        done += 1
        for name, (gaussians, edits) in afters.items():
            watch.step(done / work)
            views[name].append(compare(camera, first, document.tools.picture(gaussians, camera, edits)))
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
        return [self._document.tools.picture(gaussians, camera, edits) for camera in self._cameras]


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
