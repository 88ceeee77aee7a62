"""Opacity and light: what has to be blended, what opaque pixels hide, what cannot be seen or drawn."""

from __future__ import annotations

import math
import re

import numpy as np

from splatview.scene.effects.effect import VISIBLE, Effect, Saving, grey_levels, short
from splatview.scene.effects.sh_bands import SLICE
from splatview.scene.gaussians import Gaussians
from splatview.scene.health import Finding, sh_bound
from splatview.scene.image_model import BLUR, RenderSettings
from splatview.scene.projection import sigmoid
from splatview.scene.sh import SH_C0

OPAQUE = 0.99
"""The cap on alpha: higher opacities make no difference."""

LEAST_LIGHT = 2e-4
"""The most light that renderers give up at the end of a pixel, where settings name no other limit."""

FOOTPRINT_OPERATIONS = 250
"""Additions and multiplications of a footprint, about."""


def brightest_colour(gaussians: Gaussians) -> float:
    """An upper bound of every colour that a drawn splat can have from any side, at least 1 for backgrounds.

    What is not finite is culled, and does not count.
    """
    brightest = 1.0
    for start in range(0, len(gaussians), SLICE):
        sh = gaussians.sh[start : start + SLICE]
        with np.errstate(over="ignore", invalid="ignore"):
            colours = 0.5 + SH_C0 * sh[:, 0] + sh_bound(sh)[:, 1:].sum(axis=1)
            drawn = np.isfinite(sh).all(axis=(1, 2))
        brightest = max(brightest, float(colours[drawn].max(initial=0.0)))
    return brightest


def brightness_is_ordinary(gaussians: Gaussians) -> bool:
    """Whether `brightest_colour` surely is so low that LEAST_LIGHT of it cannot be seen, at a glance."""
    if not len(gaussians):
        return True
    constant, rest = gaussians.sh[:, 0], gaussians.sh[:, 1:]
    most = max(float(rest.max(initial=0.0)), -float(rest.min(initial=0.0)))
    bands = sum(2 * band + 1 for band in range(1, gaussians.sh_degree + 1))
    # NaN fails it.
    return bool((0.5 + SH_C0 * (float(constant.max()) + most * bands)) * LEAST_LIGHT <= VISIBLE)


def early_stop_for(gaussians: Gaussians) -> float | None:
    """The light below which pixels may end, for `RenderSettings`; None: as renderers do by themselves."""
    if brightness_is_ordinary(gaussians):
        return None
    brightest = brightest_colour(gaussians)
    if brightest * LEAST_LIGHT <= VISIBLE:
        return None
    return VISIBLE / brightest if brightest < math.inf else 0.0


def hidden_light_effect(gaussians: Gaussians, brightest: float) -> Effect:
    """The light that comes through nearly opaque pixels from what lies behind; `brightest_colour`."""
    bound = brightest * LEAST_LIGHT
    with np.errstate(invalid="ignore"):
        opaque = int((sigmoid(gaussians.opacity_logits) >= 0.5).sum())
    why = (
        f"no colour exceeds {short(brightest)} from any side, so where less than {LEAST_LIGHT:g} of the "
        f"light gets through, what lies behind adds at most {grey_levels(bound)}"
    )
    if not bound <= VISIBLE:
        why += f"; pixels go on until it is below {short(VISIBLE / brightest)}"
    return Effect(
        name="light behind opaque pixels",
        on=not bound <= VISIBLE,
        why=f"{why}; {opaque:,} of {len(gaussians):,} splats have an opacity of at least 0.5",
        saving=Saving(what="splats behind opaque pixels"),
        bound=bound,
    )


def transparency_effect(gaussians: Gaussians, brightest: float) -> Effect:
    with np.errstate(invalid="ignore"):
        translucent = int((sigmoid(gaussians.opacity_logits) < OPAQUE).sum())
    return Effect(
        name="transparency",
        on=len(gaussians) > 0,
        why=f"{translucent:,} of {len(gaussians):,} splats have an opacity below {OPAQUE:g}, and every splat "
        "fades to its edge: all are blended in depth order",
        saving=Saving(what="blending, at every splat of a pixel"),
        bound=brightest if len(gaussians) else 0.0,
    )


def background_effect(settings: RenderSettings | None) -> Effect:
    background = (0.0, 0.0, 0.0) if settings is None else settings.background
    if isinstance(background, tuple):
        bound = max(abs(value) for value in background)
        what = f"RGB {', '.join(f'{value:g}' for value in background)}"
    else:
        bound, what = 1.0, f"a {type(background).__name__.lower()}, looked up along the ray of every pixel"
    return Effect(
        name="background",
        on=bound > VISIBLE,
        why=f"{what}: where all light comes through it adds {grey_levels(bound) if bound else 'nothing'}",
        saving=Saving(what="one product and sum a pixel"),
        bound=bound,
    )


def left_out_effects(gaussians: Gaussians, health: list[Finding]) -> list[Effect]:
    """Splats that no picture shows: they are skipped before anything else is computed."""
    findings = {finding.name: finding for finding in health}
    invisible = findings["invisible"].count
    culled = [finding for finding in findings.values() if finding.culled and finding.name != "invisible"]
    undrawable = len(np.unique(np.concatenate([finding.indices for finding in culled])))
    kinds = ", ".join(f"{finding.count:,} {finding.name}" for finding in culled if finding.count)
    return [
        Effect(
            name="skip faint splats",
            on=invisible > 0,
            why=f"{invisible:,} of {len(gaussians):,} splats have an opacity below 1/255 and are never drawn",
            saving=_skipped(invisible),
        ),
        Effect(
            name="skip ill splats",
            on=undrawable > 0,
            why=f"{undrawable:,} of {len(gaussians):,} splats cannot be drawn"
            + (f": {kinds}" if kinds else ""),
            saving=_skipped(undrawable),
        ),
    ]


def _skipped(splats: int) -> Saving:
    if not splats:
        return Saving()
    operations = splats * FOOTPRINT_OPERATIONS
    return Saving(what=f"nothing: having it saves {operations:,} operations a picture")


MIP_BLUR = 0.1
"""px²: the kernel of Mip-Splatting (Yu et al. 2024), for files that say they were trained so."""

FLAT_RATIO = 100.0
"""Middle to shortest axis, from which on a splat is a disc."""

FLAT = "flat 2D splats"

ANTIALIASED = "antialiased opacity"

ANTIALIASED_OPERATIONS = 3
"""A division, a root and a product per splat."""


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
    """Whether the file says so; of several tags the last counts."""
    modes = [re.match(r"\s*SplatRenderMode\s*[:=]\s*(\w+)", text, re.IGNORECASE) for text in comments]
    said = [mode[1].lower() for mode in modes if mode]
    return bool(said) and said[-1] == "2dgs"


def _thinner(gaussians: Gaussians, ratio: float) -> int:
    """Splats whose middle axis is so many times the shortest."""
    ordered = np.sort(gaussians.log_scales, axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        return int((ordered[:, 1] - ordered[:, 0] > math.log(ratio)).sum())


def _share(count: int, gaussians: Gaussians) -> float:
    return count / len(gaussians) if len(gaussians) else 0.0
