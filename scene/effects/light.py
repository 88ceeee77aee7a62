"""Opacity and light: what has to be blended, what opaque pixels hide, what cannot be seen or drawn."""

from __future__ import annotations

import math

import numpy as np

from ..gaussians import Gaussians
from ..health import Finding, sh_reach
from ..image_model import RenderSettings
from ..projection import sigmoid
from ..sh import SH_C0
from .effect import VISIBLE, Effect, Saving, grey_levels, short
from .sh_storage import SLICE

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
            colours = 0.5 + SH_C0 * sh[:, 0] + sh_reach(sh)[:, 1:].sum(axis=1)
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
    ill = [finding for finding in findings.values() if finding.culled and finding.name != "invisible"]
    ill_splats = len(np.unique(np.concatenate([finding.indices for finding in ill])))
    kinds = ", ".join(f"{finding.count:,} {finding.name}" for finding in ill if finding.count)
    return [
        Effect(
            name="skip faint splats",
            on=invisible > 0,
            why=f"{invisible:,} of {len(gaussians):,} splats have an opacity below 1/255 and are never drawn",
            saving=_skipped(invisible),
        ),
        Effect(
            name="skip ill splats",
            on=ill_splats > 0,
            why=f"{ill_splats:,} of {len(gaussians):,} splats cannot be drawn"
            + (f": {kinds}" if kinds else ""),
            saving=_skipped(ill_splats),
        ),
    ]


def _skipped(splats: int) -> Saving:
    if not splats:
        return Saving()
    operations = splats * FOOTPRINT_OPERATIONS
    return Saving(what=f"nothing: having it saves {operations:,} operations a picture")
