"""Operations that delete what detectors find or what contributes least, and that repair invalid splats."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from splatview.edit import detectors as detecting
from splatview.edit.changes import Change, Part, Rewrite, splats_in_words
from splatview.edit.operations.base import Operation, deleting, require_rewrite
from splatview.edit.operations.select import MODES, VERBS, Mode, kind_of, one_of, selection
from splatview.edit.selectors.base import finding_mask
from splatview.edit.serialization import to_json
from splatview.edit.state import SplatSet, State
from splatview.scene import Camera, InputError
from splatview.scene.edits import ANY_LOCK, DELETED, LARGEST_LOGIT
from splatview.scene.health import BRIGHT, EXTREME_LOG_SCALE, NEEDLE_RATIO, sh_bound
from splatview.scene.progress import NO_PROGRESS, Progress


@dataclass(frozen=True, kw_only=True)
class _ByDetector(Operation):
    """In JSON `by` is an object whose ``kind`` is a name in DETECTORS, its other keys the fields of that
    detector."""

    by: Any
    """One of DETECTORS."""
    threshold: float
    """Splats that score above it are meant."""
    cameras: tuple[Camera, ...] = ()
    """Views, for detectors that render; none: views from around the scene."""

    def found(self, state: State, progress: Progress) -> np.ndarray:
        """(N,) bool."""
        scores = state.scores(self.by, self.cameras, progress=progress)
        return self.by.mask(scores, self.threshold) & state.editable

    def to_json(self) -> dict[str, Any]:
        return {**super().to_json(), "by": {"kind": kind_of(self.by), **to_json(self.by)}}

    @classmethod
    def from_json(cls, data: dict[str, Any]) -> Self:
        return super().from_json({**data, **one_of(detecting.DETECTORS, data, "by")})


class Prune(_ByDetector):
    op = "prune"
    summary = "Delete floaters, needles, giants, faint or unseen splats above a threshold"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        to_delete = self.found(state, progress)
        title = f"Prune {splats_in_words(int(np.count_nonzero(to_delete)))} by {kind_of(self.by)}"
        return deleting(state, to_delete, title)


@dataclass(frozen=True, kw_only=True)
class SelectDetected(_ByDetector):
    op: ClassVar[str] = "select_detected"
    alters_file: ClassVar[bool] = False
    summary: ClassVar[str] = "Select floaters, needles, giants, faint or unseen splats above a threshold"

    mode: Mode = "set"

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        title = f"{VERBS[self.mode]} by {kind_of(self.by)}"
        return selection(state, self.found(state, progress), MODES[self.mode], title)


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

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        return deleting(state, self.to_delete(state, progress), f"Decimate to {splats_in_words(self.keep)}")

    def to_delete(self, state: State, progress: Progress = NO_PROGRESS) -> np.ndarray:
        """Splats to be deleted, (N,) bool: of equal contributions the later ones.

        Raises:
            InputError: too many cannot be deleted, or there is no renderer.
            Cancelled: nobody waits for it any more.
        """
        at = np.flatnonzero(state.editable)[::-1]
        excess = state.counts.kept - self.keep
        if excess > len(at):
            raise InputError(
                f"keep {self.keep:,}: {state.counts.kept - len(at):,} splats are hidden, locked or "
                "cropped away and cannot be deleted"
            )
        to_delete = np.zeros(len(state.marks), bool)
        if excess > 0:
            worth = state.contributions(self.cameras, progress=progress)[at]
            to_delete[at[np.argsort(worth, kind="stable")[:excess]]] = True
        return to_delete


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
"""Repair by finding; "quaternion lengths" is no finding, but a demand of some programs."""

UNIT = 1e-6
"""Deviation from 1 up to which the length of a quaternion is left as it is."""


@dataclass(frozen=True, kw_only=True)
class Repair(Operation):
    op: ClassVar[str] = "repair"
    summary: ClassVar[str] = "Repair or delete the splats of one finding of the health report"

    finding: str
    """A key of REPAIRS."""

    def __post_init__(self) -> None:
        if self.finding not in REPAIRS:
            raise ValueError(f"finding must be one of {', '.join(REPAIRS)}, got {self.finding!r}")

    def plan(self, state: State, progress: Progress = NO_PROGRESS) -> Change:
        progress.step(0.0)
        invalid = self._invalid(state) & ((state.marks & (DELETED | ANY_LOCK)) == 0)
        title = f"Repair {self.finding}: {splats_in_words(int(np.count_nonzero(invalid)))}"
        if REPAIRS[self.finding].endswith("deleted"):
            return deleting(state, invalid, title)
        at = np.flatnonzero(invalid)
        require_rewrite(state, "sh" if "SH" in self.finding else "quats", len(at))
        attribute, values = self._repaired(state, at)
        before = getattr(state.gaussians, attribute)[at]
        parts: tuple[Part, ...] = ()
        if len(at):
            parts = (Rewrite(attribute, SplatSet.of_mask(invalid), before, values.astype(before.dtype)),)
        return Change(title=title, count=len(at), parts=parts)

    def _invalid(self, state: State) -> np.ndarray:
        gaussians = state.gaussians
        if self.finding == "quaternion lengths":
            with np.errstate(invalid="ignore", over="ignore"):
                lengths = np.linalg.norm(gaussians.quats.astype(np.float64), axis=1)
                # Zero and non-finite ones have no length to divide by.
                return (np.abs(lengths - 1) > UNIT) & (lengths > 0) & (lengths < np.inf)
        return finding_mask(gaussians, lambda finding: finding.name == self.finding)

    def _repaired(self, state: State, at: np.ndarray) -> tuple[str, np.ndarray]:
        """The attribute to repair, and its new values for the splats `at`, float64."""
        gaussians = state.gaussians
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
                # A hair below, so that the rounded values are no finding any more.
                extreme = sh_bound(gaussians.sh[at]).sum(axis=1).astype(np.float64).max(axis=1) * (1 + 1e-6)
                return "sh", sh * (BRIGHT / extreme)[:, None, None]
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
