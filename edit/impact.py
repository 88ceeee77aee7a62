"""Impact of an edit: the change of the pictures by it, measured before one accepts it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from splatview.edit.changes import Change, SaveOnce
from splatview.edit.document import Document
from splatview.edit.operations import Operation
from splatview.edit.state import State
from splatview.edit.tools import Tools
from splatview.scene import Camera, Gaussians
from splatview.scene.edits import DELETED, PREVIEW, SceneEdits, shown
from splatview.scene.progress import NO_PROGRESS, Progress

NO_LOSS = 100.0
"""PSNR in dB of an error of 1e-5, a hundredth of what an 8-bit picture can show; greater values are cut to
it, or views that an edit does not touch would make every mean infinite."""

EditedScene = tuple[Gaussians, SceneEdits]


@dataclass(frozen=True, kw_only=True)
class ViewImpact:
    """Change of one view."""

    camera: Camera
    psnr: float
    """PSNR in dB of the picture after against the one before, RGB in [0, 1]; at most NO_LOSS."""
    largest_error: float
    """Largest error of any pixel and channel, 0 to 1."""


@dataclass(frozen=True, kw_only=True)
class Impact:
    """Change of all views."""

    count: int
    """Splats that are shown before and not after."""
    mean: float
    """Mean PSNR over views, dB; NO_LOSS where nothing changes or there are no views."""
    worst: float
    """PSNR of the view that changes most, dB."""
    largest_error: float
    """Largest error over all views, 0 to 1."""
    views: int
    """Number of views."""

    @classmethod
    def of(cls, before: EditedScene, after: EditedScene, views: Iterable[ViewImpact]) -> Impact:
        views = list(views)
        psnrs = np.array([view.psnr for view in views] or [NO_LOSS])
        return cls(
            count=_shown_less(before, after),
            mean=float(psnrs.mean()),
            worst=float(psnrs.min()),
            largest_error=float(np.max([view.largest_error for view in views], initial=0.0)),
            views=len(views),
        )


def measure_impact(
    gaussians: Gaussians,
    before: SceneEdits,
    after: SceneEdits,
    tools: Tools,
    cameras: Sequence[Camera],
    *,
    progress: Progress = NO_PROGRESS,
) -> Impact:
    """The impact of going from `before` to `after`, over the views of `cameras`.

    The edits must not change meanwhile; `with_deleted` and `frozen` make some that do not. Raises Cancelled.
    """
    views = []
    for i, camera in enumerate(cameras):
        progress.step(i / len(cameras))
        first = tools.picture(gaussians, camera, before)
        progress.step((i + 0.5) / len(cameras))
        views.append(compare(camera, first, tools.picture(gaussians, camera, after)))
    progress.step(1.0)
    return Impact.of((gaussians, before), (gaussians, after), views)


def compare(camera: Camera, before: np.ndarray, after: np.ndarray) -> ViewImpact:
    """The impact on one view by its pictures (H, W, 4) float32; NaN for NaN in a picture."""
    difference = np.clip(before[..., :3], 0, 1) - np.clip(after[..., :3], 0, 1)
    error = float(np.mean(np.square(difference), dtype=np.float64))
    psnr = NO_LOSS if error == 0 else min(NO_LOSS, -10 * math.log10(error))
    return ViewImpact(
        camera=camera,
        psnr=math.nan if math.isnan(error) else psnr,
        largest_error=float(np.abs(difference).max(initial=0.0)),
    )


def with_deleted(edits: SceneEdits, mask: np.ndarray) -> SceneEdits:
    """`edits` with the splats in `mask` (N,) bool deleted too; shares nothing that changes."""
    marks = edits.marks | np.where(mask, np.uint32(DELETED), np.uint32(0))
    return replace(
        edits,
        marks=marks,
        marks_version=edits.marks_version + 1,
        changes=(),
        flags=edits.flags | DELETED,
    )


def frozen(edits: SceneEdits) -> SceneEdits:
    """A copy of `edits` that later edits do not change."""
    return replace(edits, marks=edits.marks.copy())


def operation_impacts(
    document: Document,
    operations: Mapping[str, Operation],
    cameras: Sequence[Camera],
    *,
    progress: Progress = NO_PROGRESS,
) -> dict[str, Impact]:
    """The impact of each of `operations` by itself, by its key, over the views of `cameras`.

    The document is only read, so this may run in a thread while nothing is edited. Views are drawn once
    before, and once after each operation.

    Raises:
        InputError: an operation cannot be done here, or there is no renderer.
        Cancelled: nobody waits for it any more.
    """
    before = document.gaussians, frozen(document.edits)
    afters = {
        name: after(document, document.plan(operation).change) for name, operation in operations.items()
    }
    views = {name: [] for name in operations}
    work = max(len(cameras) * (1 + len(afters)), 1)
    done = 0
    for camera in cameras:
        progress.step(done / work)
        first = document.tools.picture(before[0], camera, before[1])
        done += 1
        for name, (gaussians, edits) in afters.items():
            progress.step(done / work)
            views[name].append(compare(camera, first, document.tools.picture(gaussians, camera, edits)))
            done += 1
    progress.step(1.0)
    return {name: Impact.of(before, afters[name], views[name]) for name in operations}


def after(document: Document, change: Change) -> EditedScene:
    """Scene and edits after `change`, planned for `document` as it is; nothing is altered, and no file
    written."""
    state = State(document.gaussians)
    state.marks = document.marks.copy()
    state.palette, state.crops = document.palette, document.crops
    state.files, state.owners = document.files, document.owners
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
        flags=flags & ~PREVIEW,
    )
    return state.gaussians, edits


class StepImpacts:
    """Impacts of the steps of a document, one after the other, while it is replayed."""

    def __init__(self, document: Document, cameras: Sequence[Camera]) -> None:
        self._document, self._cameras = document, cameras
        self._before = document.gaussians, frozen(document.edits)
        self._pictures = self._draw(self._before)

    def after_step(self) -> Impact:
        """The impact of the steps since the last call. Raises InputError where there is no renderer."""
        now = self._document.gaussians, frozen(self._document.edits)
        pictures = self._draw(now)
        views = [compare(*one) for one in zip(self._cameras, self._pictures, pictures, strict=True)]
        impact = Impact.of(self._before, now, views)
        self._before, self._pictures = now, pictures
        return impact

    def _draw(self, scene: EditedScene) -> list[np.ndarray]:
        gaussians, edits = scene
        return [self._document.tools.picture(gaussians, camera, edits) for camera in self._cameras]


def _shown_less(before: EditedScene, after: EditedScene) -> int:
    """Number of splats shown in `before` and not in `after`; added splats come behind them."""
    were, are = shown(*before), shown(*after)
    return int(np.count_nonzero(were & ~are[: len(were)])) if len(are) >= len(were) else len(were) - len(are)


def in_words(impact: Impact) -> str:
    """The impact in one line."""
    if impact.largest_error == 0:
        return f"no pixel of {impact.views} views changes"
    return (
        f"pictures stay at {impact.mean:.1f} dB on average, {impact.worst:.1f} dB at worst, over "
        f"{impact.views} views; no pixel changes by more than {impact.largest_error * 255:.0f}/255"
    )
