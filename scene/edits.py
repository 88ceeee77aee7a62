"""The edits in force on a scene, as every renderer reads them. Making and undoing them is `edit`'s work.

A splat's mark is one uint32: its low byte holds state flags, the rest is the index of its `Adjustment`
in the palette. The scene's own arrays are never written to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from splatview.scene.gaussians import SAYS_NEAR, Gaussians
from splatview.scene.projection import rotation_matrices, sigmoid
from splatview.scene.sh import SH_C0, sh_rotation

# ---- What editing does to the values of a splat: one similarity, one size, one opacity and one colour map.
#
# Each of the four is closed under composition, so however often a splat is edited, one `Adjustment` says
# what came of it: nothing accumulates rounding, and undoing one step leaves no trace.


IDENTITY_ROTATION = (1.0, 0.0, 0.0, 0.0)
IDENTITY_COLOUR = ((1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0), (0.0, 0.0, 1.0, 0.0))
IDENTITY_OPACITY = (1.0, 0.0, 0.0, 1.0)

ROW = 36
"""Numbers in a row of `adjustment_rows`."""

Vector = tuple[float, float, float]
Four = tuple[float, float, float, float]


@dataclass(frozen=True, kw_only=True)
class Adjustment:
    """How an edited splat differs from the one in the file. All numbers are finite.

    Raises:
        ValueError: a number makes no sense; the message names it.
    """

    rotation: Four = IDENTITY_ROTATION
    """wxyz, of length 1: R of mean' = scale·R·mean + translation. It turns quats and SH too."""
    scale: float = 1.0
    """Above 0; standard deviations grow by it too."""
    translation: Vector = (0.0, 0.0, 0.0)
    """World units."""
    size: float = 1.0
    """Above 0: factor on the standard deviations alone."""
    opacity: Four = IDENTITY_OPACITY
    """gain, offset, low, high: opacity' = min(max(gain·opacity + offset, low), high), gain at least 0."""
    colour: tuple[Four, Four, Four] = IDENTITY_COLOUR
    """A and b of rgb' = A·rgb + b, on display colours before they are cut at 0."""

    def __post_init__(self) -> None:
        numbers = np.array(
            [*self.rotation, self.scale, *self.translation, self.size, *self.opacity, *np.ravel(self.colour)]
        )
        if numbers.shape != (25,) or not np.isfinite(numbers).all():
            raise ValueError("an adjustment has 25 finite numbers")
        if not abs(float(np.linalg.norm(self.rotation)) - 1) <= 1e-6:
            raise ValueError(f"rotation must be a quaternion of length 1, got {self.rotation}")
        for name in ("scale", "size"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        gain, _, low, high = self.opacity
        if not (gain >= 0 and 0 <= low <= high <= 1):
            raise ValueError(f"opacity must have gain >= 0 and 0 <= low <= high <= 1, got {self.opacity}")

    @property
    def linear(self) -> np.ndarray:
        """scale·R, (3, 3) float64."""
        return self.scale * self.R

    @property
    def R(self) -> np.ndarray:
        """(3, 3) float64."""
        return rotation_matrices(np.array([self.rotation], np.float64))[0]

    def then(self, later: Adjustment) -> Adjustment:
        """This one first, `later` after it."""
        gain, offset, low, high = self.opacity
        gain2, offset2, low2, high2 = later.opacity
        low12, high12 = (min(max(gain2 * end + offset2, low2), high2) for end in (low, high))
        a = np.vstack([np.array(self.colour, np.float64), [0, 0, 0, 1]])
        b = np.vstack([np.array(later.colour, np.float64), [0, 0, 0, 1]])
        colour = (b @ a)[:3]
        translation = later.linear @ np.array(self.translation) + np.array(later.translation)
        rotation = quat_product(np.array(later.rotation), np.array(self.rotation))
        return Adjustment(
            rotation=_four(rotation / np.linalg.norm(rotation)),
            scale=self.scale * later.scale,
            translation=(float(translation[0]), float(translation[1]), float(translation[2])),
            size=self.size * later.size,
            opacity=(gain * gain2, gain2 * offset + offset2, low12, high12),
            colour=(_four(colour[0]), _four(colour[1]), _four(colour[2])),
        )

    @property
    def moves(self) -> bool:
        """Whether it places splats elsewhere."""
        return (self.rotation, self.scale, self.translation) != (IDENTITY_ROTATION, 1.0, (0.0, 0.0, 0.0))


IDENTITY = Adjustment()


def is_graded(palette: Sequence[Adjustment]) -> bool:
    """Whether splats may have other colours than in the file."""
    return any(entry.colour != IDENTITY_COLOUR for entry in palette)


def _four(values: np.ndarray) -> Four:
    w, x, y, z = (float(value) for value in values)
    return (w, x, y, z)


def quat_product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Hamilton product of quaternions wxyz, (..., 4) each: the rotation `second`, then `first`."""
    w1, x1, y1, z1 = np.moveaxis(first, -1, 0)
    w2, x2, y2, z2 = np.moveaxis(second, -1, 0)
    return np.stack(
        [
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
        ],
        axis=-1,
    )


def adjustment_rows(palette: tuple[Adjustment, ...], centre: np.ndarray | None = None) -> np.ndarray:
    """The palette as renderers read it: (P, ROW) float64, nine groups of four.

    Columns 0 to 11: scale·R beside the translation, 3x4 by rows; 12 to 15: R as wxyz; 16 to 27: the colour
    map, 3x4 by rows; 28 to 31: gain, offset, low, high of opacity; 32: scale·size, the factor on standard
    deviations; the rest is 0. Means are taken relative to `centre` (3,), before and after.
    """
    origin = np.zeros(3) if centre is None else np.asarray(centre, np.float64)
    rows = np.zeros((len(palette), ROW))
    for row, adjustment in zip(rows, palette, strict=True):
        linear = adjustment.linear
        shift = linear @ origin + np.array(adjustment.translation) - origin
        row[:12] = np.hstack([linear, shift[:, None]]).ravel()
        row[12:16] = adjustment.rotation
        row[16:28] = np.ravel(adjustment.colour)
        row[28:32] = adjustment.opacity
        row[32] = adjustment.scale * adjustment.size
    return rows


CROP_ROW = 16
"""Numbers in a row of `crop_rows`."""


@dataclass(frozen=True, kw_only=True)
class Crop:
    """A box or an ellipsoid, and whether it keeps what is inside or removes it.

    Raises:
        ValueError: a number makes no sense; the message names it.
    """

    name: str = "crop"
    shape: Literal["box", "sphere"] = "box"
    centre: Vector = (0.0, 0.0, 0.0)
    """World units."""
    half_extents: Vector = (1.0, 1.0, 1.0)
    """Above 0, world units, along its own axes; for a sphere its radii."""
    rotation: Four = IDENTITY_ROTATION
    """wxyz of length 1, from its own axes to the world's."""
    keep: Literal["inside", "outside"] = "inside"
    enabled: bool = True

    def __post_init__(self) -> None:
        if self.shape not in ("box", "sphere"):
            raise ValueError(f"shape must be box or sphere, got {self.shape!r}")
        if self.keep not in ("inside", "outside"):
            raise ValueError(f"keep must be inside or outside, got {self.keep!r}")
        for name, length in (("centre", 3), ("half_extents", 3), ("rotation", 4)):
            values = np.array(getattr(self, name), np.float64)
            if values.shape != (length,) or not np.isfinite(values).all():
                raise ValueError(f"{name} must be {length} finite numbers, got {getattr(self, name)}")
        if not min(self.half_extents) > 0:
            raise ValueError(f"half_extents must be above 0, got {self.half_extents}")
        # Not by its norm alone: squares of large numbers overflow.
        if not (max(map(abs, self.rotation)) <= 2 and abs(float(np.linalg.norm(self.rotation)) - 1) <= 1e-6):
            raise ValueError(f"rotation must be a quaternion of length 1, got {self.rotation}")

    @property
    def unit_from_world(self) -> np.ndarray:
        """(3, 4) float64: takes world points to axes in which the shape has half extents of 1."""
        R_world_own = rotation_matrices(np.array([self.rotation], np.float64))[0]
        linear = R_world_own.T / np.array(self.half_extents)[:, None]
        return np.hstack([linear, -(linear @ np.array(self.centre, np.float64))[:, None]])

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Which of `points` (N, 3) are inside, the surface included: (N,) bool. NaN is not."""
        unit = self.unit_from_world
        with np.errstate(invalid="ignore", over="ignore"):
            own = points.astype(np.float64) @ unit[:, :3].T + unit[:, 3]
            if self.shape == "box":
                return np.abs(own).max(axis=1, initial=0.0) <= 1
            return np.einsum("ni,ni->n", own, own) <= 1


def crops_about(crops: Sequence[Crop], origin: np.ndarray) -> tuple[Crop, ...]:
    """The same in a world whose origin is at `origin` (3,) of this one."""
    return tuple(replace(crop, centre=tuple((np.array(crop.centre) - origin).tolist())) for crop in crops)


def cropped_in(crops: tuple[Crop, ...], points: np.ndarray) -> np.ndarray:
    """Which of `points` (N, 3) the crops in force leave: (N,) bool.

    What is in any crop that keeps its inside stays (all, if there is none), but for what is in one
    that keeps its outside.
    """
    kept = np.ones(len(points), bool)
    insides = [crop for crop in crops if crop.enabled and crop.keep == "inside"]
    if insides:
        kept = np.logical_or.reduce([crop.contains(points) for crop in insides])
    for crop in crops:
        if crop.enabled and crop.keep == "outside":
            kept &= ~crop.contains(points)
    return kept


def crop_rows(crops: tuple[Crop, ...], centre: np.ndarray | None = None) -> np.ndarray:
    """The crops in force as renderers read them: (C, CROP_ROW) float64.

    Columns 0 to 11: `unit_from_world`, 3x4 by rows, of points relative to `centre` (3,); 12: 1 for a
    sphere, 0 for a box; 13: 1 where the inside is kept, 0 where the outside is; the rest is 0.
    """
    origin = np.zeros(3) if centre is None else np.asarray(centre, np.float64)
    enabled = [crop for crop in crops if crop.enabled]
    rows = np.zeros((len(enabled), CROP_ROW))
    for row, crop in zip(rows, enabled, strict=True):
        unit = crop.unit_from_world
        row[:12] = np.hstack([unit[:, :3], (unit[:, 3] + unit[:, :3] @ origin)[:, None]]).ravel()
        row[12] = crop.shape == "sphere"
        row[13] = crop.keep == "inside"
    return rows


SELECTED, HIDDEN, DELETED, LOCKED, PREVIEW = 1, 2, 4, 8, 16
"""State flags of a mark. PREVIEW: what a tool would take, were it applied now; only ever lit up."""

FILE_HIDDEN, FILE_LOCKED = 32, 64
"""State flags of a mark: the file that the splat came from is hidden, or locked. Crops leave a locked file's
splats in the picture."""

NOT_SHOWN = HIDDEN | DELETED | FILE_HIDDEN

ANY_LOCK = LOCKED | FILE_LOCKED

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
        """Whether flags may decide if a splat is shown: it is hidden or deleted, or its file is locked
        against crops."""
        return bool(self.flags & NOT_SHOWN) or bool(self.flags & FILE_LOCKED and self.crops_in_force)

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
        kept &= inside_crops(gaussians, edits)
    return kept


def inside_crops(gaussians: Gaussians, edits: SceneEdits) -> np.ndarray:
    """Which splats the crops in force leave, those of locked files among them: (N,) bool."""
    kept = cropped_in(edits.crops, adjusted_means(gaussians, edits))
    return kept | ((edits.marks & FILE_LOCKED) != 0) if edits.flags & FILE_LOCKED else kept


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
    comments = scene.comments
    if any(edits.palette[entry].scale != 1 for entry in np.unique(entries)):
        comments = tuple(one for one in comments if not SAYS_NEAR.match(one))  # of another scale
    arrays = {"means": means, "quats": quats, "log_scales": log_scales, "opacity_logits": opacity_logits}
    return replace(scene, **arrays, sh=sh, comments=comments)


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
