"""Footprints: whether opacity is scaled by their area, and whether splats are flat."""

from __future__ import annotations

import math
import re

import numpy as np

from ..gaussians import Gaussians
from ..image_model import BLUR
from .effect import Effect, Saving

MIP_BLUR = 0.1
"""px²: the kernel of Mip-Splatting (Yu et al. 2024), for files that say they were trained so."""

FLAT_RATIO = 100.0
"""Middle to shortest axis, from which on a splat is a disc."""

FLAT = "flat 2D splats"

ANTIALIASED = "antialiased opacity"

ANTIALIASED_OPERATIONS = 3
"""A division, a root and a product a splat."""


def antialiasing(comments: tuple[str, ...]) -> tuple[bool, float, str]:
    """Whether the file says that it was trained antialiased; the kernel in px²; the comment that says so.

    Two tags are in use: ``SplatRenderMode: mip`` (Brush, with Mip-Splatting's kernel of 0.1) and
    ``antialiased 1`` (Postshot, with the usual kernel of 0.3). The last tag counts.
    """
    result = False, BLUR, ""
    for comment in comments:
        if mode := re.match(r"\s*SplatRenderMode\s*[:=]\s*(\w+)", comment, re.IGNORECASE):
            mip = mode[1].lower() == "mip"
            result = mip, MIP_BLUR if mip else BLUR, comment.strip()
        elif flag := re.match(r"\s*antialiased\s*[:=]?\s*(\w+)\s*$", comment, re.IGNORECASE):
            result = flag[1].lower() in ("1", "true"), BLUR, comment.strip()
    return result


def antialiased_effect(gaussians: Gaussians) -> Effect:
    on, blur, comment = antialiasing(gaussians.comments)
    said = f"the file says {comment!r}" if comment else "the file does not say that it was trained so"
    return Effect(
        name=ANTIALIASED,
        on=on,
        why=f"{said}; kernel {blur:g} px²",
        saving=Saving(operations=ANTIALIASED_OPERATIONS * len(gaussians)),
        # Of splats much smaller than a pixel nothing is left of the opacity.
        bound=1.0 if on else 0.0,
        can_override=True,
    )


def is_flat(gaussians: Gaussians) -> bool:
    """Whether splats are meant as planar discs: only the file can say so.

    Not their shapes: a training of solid splats leaves flat ones too, which were fitted to the photos as
    ellipsoids are drawn, with their blur, and differ from discs wherever they are seen from the side.
    """
    return _said_flat(gaussians.comments)


def flat_effect(gaussians: Gaussians) -> Effect:
    discs = _thinner(gaussians, FLAT_RATIO)
    on, share = is_flat(gaussians), _share(discs, gaussians)
    why = f"{discs:,} of {len(gaussians):,} splats ({share:.0%}) are thinner than 1:{FLAT_RATIO:g}"
    if on:
        why += "; the file says SplatRenderMode: 2dgs: each is a disc that rays meet"
    elif discs:
        why += "; the file does not say that it was trained with discs: each is solid, as it was trained"
    else:
        why += ": each is solid"
    return Effect(
        name=FLAT,
        on=on,
        why=why,
        saving=Saving(what="meeting the plane of each splat, at every pixel"),
        bound=math.inf if on else 0.0,
        can_override=True,
    )


def _said_flat(comments: tuple[str, ...]) -> bool:
    """Of several tags the last counts."""
    modes = [re.match(r"\s*SplatRenderMode\s*[:=]\s*(\w+)", text, re.IGNORECASE) for text in comments]
    said = [mode[1].lower() for mode in modes if mode]
    return bool(said) and said[-1] == "2dgs"


def _thinner(gaussians: Gaussians, ratio: float) -> int:
    """Splats whose middle axis is so many times the shortest."""
    ordered = np.sort(gaussians.log_scales, axis=1)
    with np.errstate(invalid="ignore"):
        return int((ordered[:, 1] - ordered[:, 0] > math.log(ratio)).sum())


def _share(count: int, gaussians: Gaussians) -> float:
    return count / len(gaussians) if len(gaussians) else 0.0
