"""Opacity and light: what has to be blended, what opaque pixels hide, what cannot be seen or drawn."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np

from splatview.scene.edits import Adjustment, is_graded
from splatview.scene.effects.effect import VISIBLE, Effect, Saving, grey_levels, short
from splatview.scene.effects.sh_bands import colour_reach
from splatview.scene.gaussians import SAYS_NEAR, Gaussians, near_plane
from splatview.scene.health import Finding
from splatview.scene.image_model import BLUR, DISC_BLUR, NEAR, RenderSettings
from splatview.scene.projection import sigmoid
from splatview.scene.sh import SH_C0

OPAQUE = 0.99
"""The cap on alpha: higher opacities make no difference."""

LEAST_LIGHT = 2e-4
"""The most light that renderers give up at the end of a pixel, where settings name no other limit."""

FOOTPRINT_OPERATIONS = 250
"""Additions and multiplications of a footprint, about."""


def brightness_bound(gaussians: Gaussians) -> float:
    """A brightness that surely no colour exceeds, at a glance; NaN where a number is NaN."""
    if not len(gaussians):
        return 0.5
    constant, rest = gaussians.sh[:, 0], gaussians.sh[:, 1:]
    most = max(float(rest.max(initial=0.0)), -float(rest.min(initial=0.0)))
    bands = sum(2 * band + 1 for band in range(1, gaussians.sh_degree + 1))
    return 0.5 + SH_C0 * (float(constant.max()) + most * bands)


def brightness_is_ordinary(gaussians: Gaussians) -> bool:
    """Whether the brightest colour surely is so low that LEAST_LIGHT of it cannot be seen, at a glance."""
    return bool(brightness_bound(gaussians) * LEAST_LIGHT <= VISIBLE)  # NaN fails it


def quick_early_stop(gaussians: Gaussians) -> float | None:
    """As `early_stop_for`, at a glance: no larger, so that a picture is as exact and may take longer."""
    bound = brightness_bound(gaussians)
    if bound * LEAST_LIGHT <= VISIBLE:
        return None
    return VISIBLE / bound if bound < math.inf else 0.0  # NaN: 0


def early_stop_for(gaussians: Gaussians, palette: Sequence[Adjustment] = ()) -> float | None:
    """The light below which pixels may end where splats may have the grades of `palette`, for
    `RenderSettings`; None: as renderers do by themselves."""
    if not is_graded(palette) and brightness_is_ordinary(gaussians):
        return None
    brightest = colour_reach(gaussians).graded(palette).brightest
    if brightest * LEAST_LIGHT <= VISIBLE:
        return None
    return VISIBLE / brightest if brightest < math.inf else 0.0


def hidden_light_effect(brightest: float) -> Effect:
    """The light that comes through nearly opaque pixels from what lies behind; `ColourReach.brightest`."""
    bound = brightest * LEAST_LIGHT
    why = (
        f"no colour exceeds {short(brightest)} from any side, so where less than {LEAST_LIGHT:g} of the "
        f"light gets through, what lies behind adds at most {grey_levels(bound)}"
    )
    if not bound <= VISIBLE:
        why += f"; pixels go on until it is below {short(VISIBLE / brightest)}"
    return Effect(
        name="light behind opaque pixels",
        on=not bound <= VISIBLE,
        why=why,
        saving=Saving(what="splats behind opaque pixels"),
        bound=bound,
    )


TRANSPARENCY = "transparency"


def transparency_effect(gaussians: Gaussians, brightest: float) -> Effect:
    with np.errstate(invalid="ignore"):
        translucent = int((sigmoid(gaussians.opacity_logits) < OPAQUE).sum())
    return Effect(
        name=TRANSPARENCY,
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


def near_plane_effect(gaussians: Gaussians, settings: RenderSettings | None) -> Effect:
    """Whether what is near the camera is left out, beyond what every picture does without."""
    said = near_plane(gaussians.comments)
    near = said if settings is None else settings.model.near
    if near <= NEAR:
        why = f"nothing nearer than {near:g} units is drawn; "
        why += f"the file's {said:g} is not in force" if said > NEAR else "the file asks for no more"
    elif said == near:
        why = f"the file says that no photo it was trained on shows anything nearer than {near:g} units"
    else:
        why = f"splats nearer than {near:g} units are out of sight"
        why += f", as asked for or as the view allows; the file says {said:g}" if said > NEAR else ""
    return Effect(
        name="near plane",
        on=near > NEAR,
        why=why,
        saving=Saving(what="one comparison per splat"),
        bound=math.inf if near > NEAR else 0.0,
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
            name="skip invalid splats",
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


SAYS_MODE = re.compile(r"\s*SplatRenderMode\s*[:=]\s*(\w+)", re.IGNORECASE)
SAYS_RASTERISER = re.compile(r"\s*rasteri[sz]e_mode\s*[:=]?\s*(antialiased|classic)\s*$", re.IGNORECASE)
SAYS_FLAG = re.compile(r"\s*antialias(?:ed|ing)\s*[:=]?\s*(1|true|0|false)\s*$", re.IGNORECASE)
SOUNDS_LIKE_IT = re.compile(r"rasteri[sz]e_mode|anti[-_ ]?alias|mip[-_ ]?splat", re.IGNORECASE)


def antialiasing(comments: tuple[str, ...]) -> tuple[bool, float, str]:
    """Whether the file says that it was trained antialiased; the kernel in px²; the comment that says so.

    Three tags are in use: ``SplatRenderMode: mip`` (Brush, with Mip-Splatting's kernel of 0.1),
    ``rasterize_mode antialiased`` (gsplat and nerfstudio) and ``antialiased 1`` (Postshot), both with the
    usual kernel of 0.3. The last tag counts.
    """
    result = False, BLUR, ""
    for comment in comments:
        if mode := SAYS_MODE.match(comment):
            mip = mode[1].lower() == "mip"
            result = mip, MIP_BLUR if mip else BLUR, comment.strip()
        elif flag := SAYS_RASTERISER.match(comment) or SAYS_FLAG.match(comment):
            result = flag[1].lower() in ("antialiased", "1", "true"), BLUR, comment.strip()
    return result


def is_tag(comment: str) -> bool:
    """Whether a comment is a tag, as `antialiasing`, `is_flat` and `near_plane` read them."""
    return any(said.match(comment) for said in (SAYS_MODE, SAYS_RASTERISER, SAYS_FLAG, SAYS_NEAR))


def antialiased_effect(gaussians: Gaussians) -> Effect:
    on, blur, comment = antialiasing(gaussians.comments)
    said = f"the file says {comment!r}" if comment else "the file does not say that it was trained so"
    unclear = [text.strip() for text in gaussians.comments if SOUNDS_LIKE_IT.search(text)]
    if unclear and not comment:
        said += f", unless {unclear[-1]!r} means that: then switch it on"
    kernel = f"{DISC_BLUR:g} px², the dot that a disc is at least" if is_flat(gaussians) else f"{blur:g} px²"
    return Effect(
        name=ANTIALIASED,
        on=on,
        why=f"{said}; kernel {kernel}",
        saving=Saving(operations=ANTIALIASED_OPERATIONS * len(gaussians)),
        # Of splats much smaller than a pixel nothing is left of the opacity.
        bound=1.0 if on else 0.0,
        can_override=True,
    )


def is_flat(gaussians: Gaussians) -> bool:
    """Whether splats are meant as planar discs: only the file can say so; of several tags the last counts.

    Not their shapes: a training of solid splats leaves flat ones too, which were fitted to the photos as
    ellipsoids are drawn, with their blur, and differ from discs wherever they are seen from the side.
    """
    said = [mode[1].lower() for mode in map(SAYS_MODE.match, gaussians.comments) if mode]
    return bool(said) and said[-1] == "2dgs"


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


def _thinner(gaussians: Gaussians, ratio: float) -> int:
    """Splats whose middle axis is so many times the shortest."""
    ordered = np.sort(gaussians.log_scales, axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        return int((ordered[:, 1] - ordered[:, 0] > math.log(ratio)).sum())


def _share(count: int, gaussians: Gaussians) -> float:
    return count / len(gaussians) if len(gaussians) else 0.0
