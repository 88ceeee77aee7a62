"""Opacity: what has to be blended, what is never seen, and what cannot be drawn."""

from __future__ import annotations

import numpy as np

from ..gaussians import Gaussians
from ..health import Finding
from ..projection import sigmoid
from .effect import Effect, Saving

OPAQUE = 0.99
"""The cap on alpha: higher opacities make no difference."""


def transparency_effect(gaussians: Gaussians) -> Effect:
    with np.errstate(invalid="ignore"):
        translucent = int((sigmoid(gaussians.opacity_logits) < OPAQUE).sum())
    return Effect(
        name="transparency",
        on=len(gaussians) > 0,
        why=f"{translucent:,} of {len(gaussians):,} splats have an opacity below {OPAQUE:g}, and every splat "
        "fades to its edge: all are blended in depth order",
    )


def left_out_effects(gaussians: Gaussians, health: list[Finding]) -> list[Effect]:
    """Splats that no picture shows: they are skipped before anything else is computed."""
    findings = {finding.name: finding for finding in health}
    invisible = findings["invisible"].count
    ill = [finding for finding in findings.values() if finding.culled and finding.name != "invisible"]
    ill_splats = len(np.unique(np.concatenate([finding.indices for finding in ill])))
    kinds = ", ".join(f"{finding.count:,} {finding.name}" for finding in ill if finding.count)
    return [
        Effect(
            name="skip faint splats",
            on=invisible > 0,
            why=f"{invisible:,} of {len(gaussians):,} splats have an opacity below 1/255 and are never drawn",
            saving=Saving(what="nothing; having it saves their footprints" if invisible else ""),
        ),
        Effect(
            name="skip ill splats",
            on=ill_splats > 0,
            why=f"{ill_splats:,} of {len(gaussians):,} splats cannot be drawn"
            + (f": {kinds}" if kinds else ""),
        ),
    ]


def sorting_effect(gaussians: Gaussians) -> Effect:
    return Effect(
        name="sorting",
        on=len(gaussians) > 1,
        why=f"{len(gaussians):,} splats; they are sorted anew only when camera, scene or settings change",
    )
