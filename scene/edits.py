"""The edits in force on a scene, as every renderer reads them. Making and undoing them is `edit`'s work.

A splat's mark is one uint32: its low byte holds state flags, the rest is the index of its `Adjustment`
in the palette. The scene's own arrays are never written to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .adjustment import IDENTITY, Adjustment, quat_product
from .crop import Crop, cropped_in
from .gaussians import Gaussians
from .projection import sigmoid
from .sh import SH_C0
from .sh_rotation import sh_rotation

SELECTED, HIDDEN, DELETED, LOCKED, PREVIEW = 1, 2, 4, 8, 16
"""State flags of a mark. PREVIEW: what a tool would take, were it applied now; only ever lit up."""

NOT_SHOWN = HIDDEN | DELETED

PALETTE_SHIFT = 8
"""A mark is flags | palette index << PALETTE_SHIFT."""

MOST_ADJUSTMENTS = 1 << (32 - PALETTE_SHIFT)

LARGEST_LOGIT = 16.0
"""An opacity of 1 has no finite logit; this one is 1 - 1e-7. Only opacities that were edited come to it."""


@dataclass(frozen=True, eq=False, kw_only=True)
class SceneEdits:
    """What an editor has done to a scene of N splats so far.

    `marks` is the editor's own array, which later edits change in place: whoever keeps a `SceneEdits`
    sees them before their time, which is harmless for a picture that will be drawn anew. The versions
    grow with each change of what they name, so that renderers upload no more than what is new.
    """

    marks: np.ndarray
    """(N,) uint32."""
    palette: tuple[Adjustment, ...] = (IDENTITY,)
    """The first is the identity. It only grows, but for entries that no mark names any more."""
    crops: tuple[Crop, ...] = ()
    marks_version: int = 0
    palette_version: int = 0
    crops_version: int = 0
    changes: tuple[tuple[int, int, int], ...] = ()
    """(marks_version, start, stop) of the latest changes of `marks`, oldest first. Of changes before the
    first nothing is known: who has missed them reads all."""
    flags: int = 0
    """Every state flag that some mark may have: one that is not in it, none has."""

    @property
    def adjusts(self) -> bool:
        """Whether some splats may have an adjustment."""
        return len(self.palette) > 1

    @property
    def hides(self) -> bool:
        """Whether some splats may be hidden or deleted."""
        return bool(self.flags & NOT_SHOWN)

    @property
    def crops_in_force(self) -> tuple[Crop, ...]:
        return tuple(crop for crop in self.crops if crop.enabled)

    @property
    def in_force(self) -> bool:
        """Whether the picture differs from that of the scene itself, the tint of the selection aside."""
        return self.adjusts or self.hides or bool(self.crops_in_force)

    def changed_since(self, version: int) -> tuple[int, int] | None:
        """Run (start, stop) that holds all changes of `marks` after `version`; None: all may have changed."""
        newer = [change for change in self.changes if change[0] > version]
        if len(newer) != self.marks_version - version:
            return None
        return (min((c[1] for c in newer), default=0), max((c[2] for c in newer), default=0))


def adjusted_means(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """Where adjustments put the splats: (N, 3), float64 if any was moved, else the scene's own array."""
    return adjusted_points(gaussians.means, edits.marks, edits.palette)


def adjusted_points(means: np.ndarray, marks: np.ndarray, palette: tuple[Adjustment, ...]) -> np.ndarray:
    """As `adjusted_means`, of some splats' means (n, 3) and their marks (n,)."""
    if not any(adjustment.moves for adjustment in palette):
        return means
    means = means.astype(np.float64)
    entries = marks >> PALETTE_SHIFT
    with np.errstate(invalid="ignore", over="ignore"):
        for entry in np.unique(entries):
            adjustment = palette[entry]
            if adjustment.moves:
                chosen = entries == entry
                means[chosen] = means[chosen] @ adjustment.linear.T + np.array(adjustment.translation)
    return means


def shown(gaussians: Gaussians, edits: SceneEdits, *, hidden: bool = False) -> np.ndarray:
    """Which splats are neither deleted nor cropped away nor, unless `hidden`, hidden: (N,) bool."""
    flags = DELETED if hidden else NOT_SHOWN
    kept = (edits.marks & flags) == 0
    if edits.crops_in_force:
        kept &= cropped_in(edits.crops, adjusted_means(gaussians, edits))
    return kept


def bake(gaussians: Gaussians, edits: SceneEdits, *, hidden: bool = False) -> Gaussians:
    """The scene that the edits make, as a scene of its own: what is exported, and what renderers must show.

    Splats that are deleted or cropped away are left out; those that are hidden too, unless `hidden`. Of
    what was not adjusted, every byte stays. Adjusted values are computed in float64 and rounded once.
    """
    kept = np.flatnonzero(shown(gaussians, edits, hidden=hidden))
    scene = gaussians.take(kept)
    entries = edits.marks[kept] >> PALETTE_SHIFT
    if not entries.any():
        return scene
    means, quats, log_scales = scene.means.copy(), scene.quats.copy(), scene.log_scales.copy()
    opacity_logits, sh = scene.opacity_logits.copy(), scene.sh.copy()
    for entry in np.unique(entries):
        adjustment = edits.palette[entry]
        if adjustment == IDENTITY:
            continue
        at = np.flatnonzero(entries == entry)
        with np.errstate(invalid="ignore", over="ignore"):
            _adjust(adjustment, at, means, quats, log_scales, opacity_logits, sh)
    return replace(
        scene, means=means, quats=quats, log_scales=log_scales, opacity_logits=opacity_logits, sh=sh
    )


def _adjust(
    adjustment: Adjustment,
    at: np.ndarray,
    means: np.ndarray,
    quats: np.ndarray,
    log_scales: np.ndarray,
    opacity_logits: np.ndarray,
    sh: np.ndarray,
) -> None:
    """Applies one adjustment to rows `at` of the arrays, in place."""
    if adjustment.moves:
        means[at] = means[at].astype(np.float64) @ adjustment.linear.T + np.array(adjustment.translation)
        quats[at] = quat_product(np.array(adjustment.rotation), quats[at].astype(np.float64))
    factor = adjustment.scale * adjustment.size
    if factor != 1:
        log_scales[at] = log_scales[at].astype(np.float64) + np.log(factor)
    gain, offset, low, high = adjustment.opacity
    if adjustment.opacity != IDENTITY.opacity:
        opacity = np.clip(gain * sigmoid(opacity_logits[at].astype(np.float64)) + offset, low, high)
        with np.errstate(divide="ignore"):
            logits = np.log(opacity) - np.log1p(-opacity)
        opacity_logits[at] = np.clip(logits, -LARGEST_LOGIT, LARGEST_LOGIT)
    turned = adjustment.rotation != IDENTITY.rotation and sh.shape[1] > 1
    if turned or adjustment.colour != IDENTITY.colour:
        values = sh[at].astype(np.float64)
        if turned:
            degree = (1, 4, 9, 16).index(sh.shape[1])
            values = np.einsum("ij,njc->nic", sh_rotation(adjustment.R, degree), values)
        if adjustment.colour != IDENTITY.colour:
            colour = np.array(adjustment.colour)
            values = values @ colour[:, :3].T
            values[:, 0] += (colour[:, :3] @ np.full(3, 0.5) + colour[:, 3] - 0.5) / SH_C0
        sh[at] = values
