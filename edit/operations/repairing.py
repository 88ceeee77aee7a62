"""Repairing splats with bad numbers, where there is a repair; deleting them where there is none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...scene.edits import DELETED, LARGEST_LOGIT, LOCKED
from ...scene.health import BRIGHT, EXTREME_LOG_SCALE, NEEDLE_RATIO, check, sh_reach
from ..changes import Change, Part, Rewrite, splats_in_words
from ..runs import SplatSet
from ..watch import UNWATCHED, Watch
from .operation import Operation
from .scope import deleting

if TYPE_CHECKING:
    from ..document import Document

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

    def plan(self, document: Document, watch: Watch = UNWATCHED) -> Change:
        watch.step(0.0)
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
                reach = sh_reach(gaussians.sh[at]).sum(axis=1).astype(np.float64).max(axis=1) * (1 + 1e-6)
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
