"""Which effects a scene calls for, with the evidence: nothing is computed that cannot be seen."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from .framing import robust_bounds
from .gaussians import Gaussians
from .health import FAR_SPACING, Finding, check, sh_reach
from .image_model import BLUR, ImageModel, RenderSettings
from .projection import FLOAT32_MAX, sigmoid

GREY_LEVEL = 1 / 255

VISIBLE = GREY_LEVEL / 2
"""Colour changes up to half a level of an 8-bit picture are not computed."""

MIP_BLUR = 0.1
"""px²: the kernel of Mip-Splatting (Yu et al. 2024), for files that say they were trained so."""

FLAT_RATIO = 100.0
"""Middle to shortest axis, from which on a splat is a disc."""

FLAT_SHARE = 0.99
"""A scene is flat where all but a stray few of its splats are discs."""

OPAQUE = 0.99
"""The cap on alpha: higher opacities make no difference."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """Part of the image model, and whether this scene needs it."""

    name: str
    on: bool
    why: str
    """The evidence, with numbers, and what it means."""


def census(gaussians: Gaussians, *, findings: list[Finding] | None = None) -> list[Effect]:
    """All effects, in a fixed order; SH bands only as far as the file has them.

    `findings`: what `health.check` said of the scene, where that is known already.
    """
    return [
        *_sh_bands(gaussians),
        _antialiased(gaussians),
        _flat(gaussians),
        _centred(gaussians),
        _transparency(gaussians),
        *_left_out(gaussians, check(gaussians) if findings is None else findings),
        _sorting(gaussians),
    ]


def settings_for(gaussians: Gaussians) -> RenderSettings:
    """The settings that the scene calls for: its image model, and SH as far as it can be seen."""
    antialiased, blur, _ = antialiasing(gaussians.comments)
    used = used_sh_degree(gaussians)
    return RenderSettings(
        model=ImageModel(antialiased=antialiased, blur=blur),
        sh_degree=used if used < gaussians.sh_degree else None,
    )


def used_sh_degree(gaussians: Gaussians) -> int:
    """The lowest SH degree that shows the scene as the stored one does, to within VISIBLE in every pixel.

    All bands above it together cannot move the colour of any splat by more; blending is a weighted mean
    of colours, so no pixel moves by more either.
    """
    return _used_degree(_largest_reach(gaussians))


def _largest_reach(gaussians: Gaussians) -> list[float]:
    """Per degree d: how far bands d and up together can move the colour of any splat.

    A coefficient that is not finite culls its splat, and leaving out its band would bring the splat back:
    that gives inf or NaN, unless a lower band culls the splat all the same.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        reach = sh_reach(gaussians.sh)
        # From the highest band down: what dropping this band and all above it would cost.
        dropped = np.cumsum(reach[:, ::-1], axis=1)[:, ::-1].max(axis=2)
        finite = np.abs(gaussians.sh) <= FLOAT32_MAX
    degree = gaussians.sh_degree
    culled = np.zeros(len(gaussians), dtype=bool)
    for band in range(degree + 1):
        dropped[culled, band] = 0
        culled |= ~finite[:, band * band : (band + 1) ** 2].all(axis=(1, 2))
    return [float(dropped[:, band].max(initial=0.0)) for band in range(degree + 1)]


def _used_degree(reach: list[float]) -> int:
    for degree in range(len(reach) - 1, 0, -1):
        # Negated, so that an overflow to inf or NaN counts as visible. 1e-5: float32 sums.
        if not reach[degree] * (1 + 1e-5) <= VISIBLE:
            return degree
    return 0


def _short(value: float) -> str:
    """Two digits of a small number, all of a large one: 0.031, 2.4, 748."""
    return f"{value:,.0f}" if value >= 10 else f"{value:.2g}"


def _sh_bands(gaussians: Gaussians) -> list[Effect]:
    reach = _largest_reach(gaussians)
    used = _used_degree(reach)
    effects = []
    for band in range(1, len(reach)):
        change = (
            f"the coefficients from this band up move a colour by at most {reach[band]:.2g} "
            f"({_short(reach[band] / GREY_LEVEL)} grey levels)"
        )
        if not math.isfinite(reach[band]):
            change = "a coefficient from this band up is infinite, NaN or nearly so"
        limit = "below half a grey level: not computed" if band > used else "above half a grey level"
        effects.append(Effect(name=f"SH band {band}", on=band <= used, why=f"{change}, {limit}"))
    return effects


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


def _antialiased(gaussians: Gaussians) -> Effect:
    on, blur, comment = antialiasing(gaussians.comments)
    said = f"the file says {comment!r}" if comment else "the file does not say that it was trained so"
    return Effect(name="antialiased opacity", on=on, why=f"{said}; kernel {blur:g} px²")


def _flat(gaussians: Gaussians) -> Effect:
    said = any(
        re.match(r"\s*SplatRenderMode\s*[:=]\s*2dgs", text, re.IGNORECASE) for text in gaussians.comments
    )
    ordered = np.sort(gaussians.log_scales, axis=1)
    with np.errstate(invalid="ignore"):
        discs = int((ordered[:, 1] - ordered[:, 0] > math.log(FLAT_RATIO)).sum())
    share = discs / len(gaussians) if len(gaussians) else 0.0
    why = f"{discs:,} of {len(gaussians):,} splats ({share:.0%}) are thinner than 1:{FLAT_RATIO:g}"
    if said:
        why += "; the file says SplatRenderMode: 2dgs"
    on = said or share >= FLAT_SHARE
    return Effect(name="flat 2D splats", on=on, why=f"{why}; they are drawn as very thin 3D Gaussians")


def _centred(gaussians: Gaussians) -> Effect:
    centre, radius = robust_bounds(gaussians.means)
    furthest = float(np.abs(centre).max()) + radius
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(gaussians.log_scales.max(axis=1, initial=-np.inf))
        spacing = float(np.spacing(np.float32(furthest)))
    sizes = sizes[(sizes > 0) & (sizes <= FLOAT32_MAX)]
    size = float(np.median(sizes)) if len(sizes) else 1.0
    stored = gaussians.means.dtype.name
    return Effect(
        name="float64-centred positions",
        on=bool(spacing > FAR_SPACING * size) or gaussians.means.dtype == np.float64,
        why=f"positions are {stored} and reach {furthest:.4g}, where float32 has steps of {spacing:.2g}; "
        f"the median splat measures {size:.2g}",
    )


def _transparency(gaussians: Gaussians) -> Effect:
    with np.errstate(invalid="ignore"):
        translucent = int((sigmoid(gaussians.opacity_logits) < OPAQUE).sum())
    return Effect(
        name="transparency",
        on=len(gaussians) > 0,
        why=f"{translucent:,} of {len(gaussians):,} splats have an opacity below {OPAQUE:g}, and every splat "
        "fades to its edge: all are blended in depth order",
    )


def _left_out(gaussians: Gaussians, health: list[Finding]) -> list[Effect]:
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
        ),
        Effect(
            name="skip ill splats",
            on=ill_splats > 0,
            why=f"{ill_splats:,} of {len(gaussians):,} splats cannot be drawn"
            + (f": {kinds}" if kinds else ""),
        ),
    ]


def _sorting(gaussians: Gaussians) -> Effect:
    return Effect(
        name="sorting",
        on=len(gaussians) > 1,
        why=f"{len(gaussians):,} splats; they are sorted anew only when camera, scene or settings change",
    )
