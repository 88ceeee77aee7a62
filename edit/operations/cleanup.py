"""Operations that delete what detectors find, or all but the splats that matter most."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from splatview.edit import detectors as detecting
from splatview.edit.changes import Change, Part, Rewrite, splats_in_words
from splatview.edit.operations.base import Operation, deleting
from splatview.edit.operations.select import kind_of, one_of
from splatview.edit.serialization import to_json
from splatview.edit.state import SplatSet
from splatview.scene import Camera, InputError
from splatview.scene.edits import DELETED, HIDDEN, LARGEST_LOGIT, LOCKED
from splatview.scene.health import BRIGHT, EXTREME_LOG_SCALE, NEEDLE_RATIO, check, sh_bound
from splatview.scene.progress import NO_PROGRESS, Progress

if TYPE_CHECKING:
    from splatview.edit.document import Document


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

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        scores = document.scores(self.by, self.cameras, progress=progress)
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

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        return deleting(
            document, self.doomed(document, progress), f"Decimate to {splats_in_words(self.keep)}"
        )

    def doomed(self, document: Document, progress: Progress = NO_PROGRESS) -> np.ndarray:
        """Which splats it would delete, (N,) bool: of equal contributions the later ones.

        Raises:
            InputError: too many cannot be deleted, or there is no renderer.
            Cancelled: nobody waits for it any more.
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
            worth = document.contributions(self.cameras, progress=progress)[at]
            doomed[at[np.argsort(worth, kind="stable")[:excess]]] = True
        return doomed


def editable(document: Document) -> np.ndarray:
    """(N,) bool: in sight and not locked."""
    free = (document.marks & (HIDDEN | DELETED | LOCKED)) == 0
    visible = document.cropped_in()
    return free & visible if len(visible) else free


# ---- Repairing splats with bad numbers, where there is a repair; deleting them where there is none.


REPAIRS = {
    "quaternion lengths": "quaternions are divided by their lengths, which changes no picture",
    "non-finite quaternions": "the rotation becomes none",
    "zero quaternions": "the rotation becomes none",
    "non-finite scales": f"log-scales are cut at ±{EXTREME_LOG_SCALE:g}; NaN becomes the splat's smallest",
    "extreme scales": f"log-scales are cut at ±{EXTREME_LOG_SCALE:g}",
    "opacity at its limit": f"logits are cut at ±{LARGEST_LOGIT:g}",
    "needles": f"the shorter axes grow to 1/{NEEDLE_RATIO:g} of the longest",
    "rods": f"the longest axis shrinks to {NEEDLE_RATIO:g} times the middle one",
    "non-finite SH": "the coefficients in question become 0",
    "SH out of range": f"coefficients shrink until no colour is further than {BRIGHT:g} from mid-grey",
    "non-finite means": "the splats are deleted",
    "NaN opacities": "the splats are deleted",
    "invisible": "the splats are deleted",
    "giants": "the splats are deleted",
    "duplicates": "the copies are deleted",
}
"""Finding -> what is done; "quaternion lengths" is no finding, but what some programs insist on."""

UNIT = 1e-6
"""Lengths of quaternions closer to 1 than this stay as they are."""


@dataclass(frozen=True, kw_only=True)
class Repair(Operation):
    op: ClassVar[str] = "repair"
    summary: ClassVar[str] = "Repair or delete the splats of one finding of the health report"

    finding: str
    """A key of REPAIRS."""

    def __post_init__(self) -> None:
        if self.finding not in REPAIRS:
            raise ValueError(f"finding must be one of {', '.join(REPAIRS)}, got {self.finding!r}")

    def plan(self, document: Document, progress: Progress = NO_PROGRESS) -> Change:
        progress.step(0.0)
        ill = self._ill(document) & ((document.marks & (DELETED | LOCKED)) == 0)
        title = f"Repair {self.finding}: {splats_in_words(int(np.count_nonzero(ill)))}"
        if REPAIRS[self.finding].endswith("deleted"):
            return deleting(document, ill, title)
        at = np.flatnonzero(ill)
        attribute, values = self._repaired(document, at)
        before = getattr(document.gaussians, attribute)[at]
        parts: tuple[Part, ...] = ()
        if len(at):
            parts = (Rewrite(attribute, SplatSet.of_mask(ill), before, values.astype(before.dtype)),)
        return Change(title=title, count=len(at), parts=parts)

    def _ill(self, document: Document) -> np.ndarray:
        gaussians = document.gaussians
        mask = np.zeros(len(gaussians), bool)
        if self.finding == "quaternion lengths":
            with np.errstate(invalid="ignore", over="ignore"):
                lengths = np.linalg.norm(gaussians.quats.astype(np.float64), axis=1)
                # Zero and non-finite ones have no length to divide by.
                return (np.abs(lengths - 1) > UNIT) & (lengths > 0) & (lengths < np.inf)
        for finding in check(gaussians):
            if finding.name == self.finding:
                mask[finding.indices] = True
        return mask

    def _repaired(self, document: Document, at: np.ndarray) -> tuple[str, np.ndarray]:
        """Which attribute, and its better values for the splats `at`, float64."""
        gaussians = document.gaussians
        match self.finding:
            case "quaternion lengths":
                quats = gaussians.quats[at].astype(np.float64)
                return "quats", quats / np.linalg.norm(quats, axis=1, keepdims=True)
            case "non-finite quaternions" | "zero quaternions":
                return "quats", np.tile([1.0, 0.0, 0.0, 0.0], (len(at), 1))
            case "opacity at its limit":
                logits = gaussians.opacity_logits[at].astype(np.float64)
                return "opacity_logits", np.clip(logits, -LARGEST_LOGIT, LARGEST_LOGIT)
            case "non-finite SH":
                return "sh", np.nan_to_num(gaussians.sh[at].astype(np.float64), posinf=0.0, neginf=0.0)
            case "SH out of range":
                sh = gaussians.sh[at].astype(np.float64)
                # A hair below, so that the rounded values are found no more.
                reach = sh_bound(gaussians.sh[at]).sum(axis=1).astype(np.float64).max(axis=1) * (1 + 1e-6)
                return "sh", sh * (BRIGHT / reach)[:, None, None]
            case _:
                return "log_scales", self._repaired_scales(gaussians.log_scales[at].astype(np.float64))

    def _repaired_scales(self, scales: np.ndarray) -> np.ndarray:
        ratio = math.log(NEEDLE_RATIO) * (1 - 1e-6)
        if self.finding == "needles":
            return np.maximum(scales, scales.max(axis=1, keepdims=True) - ratio)
        if self.finding == "rods":
            return np.minimum(scales, np.sort(scales, axis=1)[:, 1:2] + ratio)
        cut = np.clip(scales, -EXTREME_LOG_SCALE, EXTREME_LOG_SCALE)
        smallest = np.nanmin(
            np.where(np.isnan(cut).all(axis=1, keepdims=True), -EXTREME_LOG_SCALE, cut), axis=1, keepdims=True
        )
        return np.where(np.isnan(cut), smallest, cut)
