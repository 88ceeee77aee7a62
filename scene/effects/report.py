"""The effects report: every effect of a scene and a view, on or off, in a fixed order."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from splatview.scene.camera import Camera
from splatview.scene.edits import (
    IDENTITY_COLOUR,
    IDENTITY_OPACITY,
    NOT_SHOWN,
    PALETTE_SHIFT,
    SELECTED,
    Adjustment,
    SceneEdits,
    inside_crops,
)
from splatview.scene.effects.appearance import (
    TRANSPARENCY,
    antialiased_effect,
    background_effect,
    flat_effect,
    hidden_light_effect,
    left_out_effects,
    near_plane_effect,
    transparency_effect,
)
from splatview.scene.effects.effect import Effect, Saving
from splatview.scene.effects.overrides import NOTHING_FORCED, Overrides
from splatview.scene.effects.sh_bands import band_effects, colour_reach, own_degrees_effect
from splatview.scene.framing import SPLAT_SIGMAS, robust_bounds
from splatview.scene.gaussians import Gaussians
from splatview.scene.health import FAR_SPACING, Finding, check
from splatview.scene.image_model import RenderSettings
from splatview.scene.projection import FLOAT32_MAX

GRID = 17
"""Pixels along each side of a picture where it is looked how far a lens moves them."""

SORT_OPERATIONS = 4 * 3
"""A splat: four passes of a radix sort, each counting, adding up and moving."""


FRAMED = 2.0
"""Radii of a scene from its centre to an eye that sees all of it, about."""


def sorting_effect(gaussians: Gaussians) -> Effect:
    n = len(gaussians)
    why = f"{n:,} splats; they are sorted anew only when camera, scene or settings change"
    if tied := tied_in_float32(gaussians):
        why += (
            f"; {tied:,} overlapping pairs, where all of it is seen along an axis, lie in an order that "
            "only float64 tells: cpu keeps it, OpenGL sorts by float32 and takes them by index"
        )
    return Effect(
        name="sorting",
        on=n > 1,
        why=why,
        saving=Saving(operations=n * SORT_OPERATIONS, bytes=8 * n),
        # One splat over another, each of any colour.
        bound=math.inf if n > 1 else 0.0,
    )


def tied_in_float32(gaussians: Gaussians) -> int:
    """Pairs of a scene of float64 that overlap, the one just before the other as seen along an axis, whose
    depths are one number of float32; of the axis with most."""
    if gaussians.means.dtype != np.float64:
        return 0
    centre, radius = robust_bounds(gaussians.means)
    with np.errstate(over="ignore", invalid="ignore"):
        offsets, sizes = gaussians.means - centre, np.exp(gaussians.log_scales.max(axis=1, initial=-np.inf))
        seen = np.flatnonzero((np.abs(offsets).max(axis=1) < FRAMED * radius) & (sizes <= FLOAT32_MAX))
    most = 0
    for axis in range(3):
        order = seen[np.argsort(offsets[seen, axis], kind="stable")]
        depths = offsets[order, axis] + FRAMED * radius
        tied = (np.diff(depths) > 0) & (np.diff(depths.astype(np.float32)) == 0)
        front, back = order[:-1][tied], order[1:][tied]
        beside = np.delete(offsets[front] - offsets[back], axis, axis=1)
        reach = SPLAT_SIGMAS * (sizes[front] + sizes[back])
        most = max(most, int((np.linalg.norm(beside, axis=1) < reach).sum()))
    return most


def redrawing_effect(camera: Camera | None, previous: Camera | None) -> Effect:
    """`previous`: the camera of the picture that is on the screen, of the same scene in the same state."""
    same = camera is not None and previous is not None and camera.same_view(previous)
    if camera is None:
        why = "a view that is at rest is neither projected, sorted nor drawn again"
    elif previous is None:
        why = "nothing has been drawn yet"
    else:
        why = "the camera has not moved" if same else "the camera has moved"
    return Effect(
        name="redrawing",
        on=camera is not None and not same,
        why=why,
        saving=Saving(what="the whole picture"),
        bound=math.inf if camera is not None and not same else 0.0,
    )


def lens_effect(camera: Camera | None) -> Effect:
    lens = None if camera is None else camera.lens
    if camera is None:
        why = "there is no camera yet: a pinhole"
    elif lens is None:
        why = "the camera is a pinhole" if not camera.orthographic else "the camera's rays are parallel"
    else:
        why = f"{lens.model}: it moves what is seen by up to {largest_displacement(camera):.3g} px"
    return Effect(
        name="lens distortion",
        on=lens is not None,
        why=why,
        saving=Saving(what="the lens's formula and its derivative, at every splat"),
        bound=math.inf if lens is not None else 0.0,
    )


def largest_displacement(camera: Camera) -> float:
    """How far the lens moves anything that the picture shows from where a pinhole has it, px."""
    x, y = np.meshgrid(np.linspace(0, camera.width, GRID), np.linspace(0, camera.height, GRID))
    pixels = np.stack([x, y], axis=-1)
    pinhole = camera.points_at(pixels, 1.0)[..., :2] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    moved = np.linalg.norm(pinhole - pixels, axis=-1)
    return float(moved[np.isfinite(moved)].max(initial=0.0))


def centred_effect(gaussians: Gaussians) -> Effect:
    """Whether positions are kept relative to a centre in float64, or may be single numbers of float32.

    A file of float64 needs it wherever a position is no number of float32: then `bound` is not 0 but unknown,
    as by an eye that is near enough any step can be seen. One of float32 has lost its digits already; but far
    from the origin the camera and the edits would lose them too.
    """
    centre, radius = robust_bounds(gaussians.means)
    furthest = float(np.abs(centre).max()) + radius
    with np.errstate(over="ignore", invalid="ignore"):
        sizes = np.exp(gaussians.log_scales.max(axis=1, initial=-np.inf))
        spacing = float(np.spacing(np.float32(furthest)))
        single = gaussians.means.astype(np.float32)
        rounded = int((single.astype(np.float64) != gaussians.means).any(axis=1).sum())
    if gaussians.means.dtype == np.float32:
        rounded = 0
    sizes = sizes[(sizes > 0) & (sizes <= FLOAT32_MAX)]
    size = float(np.median(sizes)) if len(sizes) else 1.0
    on = bool(spacing > FAR_SPACING * size) or rounded > 0
    stored = gaussians.means.dtype.name
    why = (
        f"positions are {stored} and reach {furthest:.4g}, where float32 has steps of {spacing:.2g}; "
        f"the median splat measures {size:.2g}"
    )
    if gaussians.means.dtype == np.float64:
        why += f"; {rounded:,} of {len(gaussians):,} are no numbers of float32"
    return Effect(
        name="float64-centred positions",
        on=on,
        why=why,
        saving=Saving(what="one difference per splat"),
        bound=math.inf if on else 0.0,
    )


MARK_BYTES = 4
"""A splat, for its state and its adjustment."""

GRADE_OPERATIONS = 18
"""A 3x3 matrix and a sum."""

MOVE_OPERATIONS = 18 + 28
"""A similarity of the mean, and a product of quaternions."""

CROP_OPERATIONS = 21
"""A 3x4 matrix and a comparison of each axis, a crop."""


def edit_effects(gaussians: Gaussians, edits: SceneEdits | None) -> list[Effect]:
    """Effects of the edits in force; all off where there are none."""
    n = len(gaussians)
    if edits is None:
        edits = SceneEdits(marks=np.zeros(n, np.uint32))
    moved = [entry.moves or entry.size != 1 or entry.opacity != IDENTITY_OPACITY for entry in edits.palette]
    graded = [entry.colour != IDENTITY_COLOUR for entry in edits.palette]

    def counted(name: str, count: int, what: str, none: str, saving: Saving) -> Effect:
        """An effect that is needed where it concerns a splat."""
        why = f"{count:,} of {n:,} splats {what}" if count else none
        return Effect(name=name, on=count > 0, why=why, saving=saving, bound=math.inf if count else 0.0)

    return [
        counted(
            "selection",
            _flagged(edits, SELECTED),
            "are selected and lit up",
            "nothing is selected",
            Saving(what="looking up a tint, at every splat"),
        ),
        counted(
            "hidden splats",
            _flagged(edits, NOT_SHOWN),
            "are hidden or deleted",
            "no splat is hidden or deleted",
            Saving(bytes=n * MARK_BYTES),
        ),
        _crop(gaussians, edits),
        counted(
            "adjusted splats",
            _adjusted(edits, moved),
            "are moved, resized or more or less opaque than in the file",
            "no splat is moved, resized or faded",
            Saving(operations=n * MOVE_OPERATIONS, bytes=n * MARK_BYTES),
        ),
        counted(
            "colour grade",
            _adjusted(edits, graded),
            "have another colour than in the file",
            "no colour is changed",
            Saving(operations=n * GRADE_OPERATIONS, bytes=n * MARK_BYTES),
        ),
    ]


def _flagged(edits: SceneEdits, flags: int) -> int:
    return int(np.count_nonzero(edits.marks & flags)) if edits.flags & flags else 0


def _adjusted(edits: SceneEdits, entries: list[bool]) -> int:
    """Splats whose adjustment is one of these entries of the palette."""
    return int(np.array(entries)[edits.marks >> PALETTE_SHIFT].sum()) if any(entries) else 0


def _crop(gaussians: Gaussians, edits: SceneEdits) -> Effect:
    n, crops = len(gaussians), edits.crops_in_force
    if not crops:
        return Effect(name="crop", on=False, why="there is no crop")
    outside = n - int(inside_crops(gaussians, edits).sum())
    # One that cuts nothing off is computed all the same: what lies outside it is known only then.
    return Effect(
        name="crop",
        on=True,
        why=f"{len(crops):,} in force, which leave {outside:,} of {n:,} splats out",
        saving=Saving(operations=n * len(crops) * CROP_OPERATIONS),
        bound=math.inf if outside else 0.0,
    )


def effects_report(
    gaussians: Gaussians,
    *,
    findings: list[Finding] | None = None,
    overrides: Overrides = NOTHING_FORCED,
    camera: Camera | None = None,
    previous: Camera | None = None,
    edits: SceneEdits | None = None,
    settings: RenderSettings | None = None,
) -> list[Effect]:
    """All effects, in a fixed order; SH bands only as far as the file has them.

    `findings`: what `health.check` said of the scene, where that is known already. `overrides`: what the user
    has forced on or off, by name; it is told, and changes nothing of what the analysis says. The rest is how
    the scene is looked at, as far as that is known: by which `camera` after which `previous` one, with which
    `edits` in force and which `settings`.
    """
    own = scene_effects(gaussians, findings=findings, overrides=overrides)
    return with_grade(own, gaussians, edits.palette if edits else ()) + view_effects(
        gaussians, camera=camera, previous=previous, edits=edits, settings=settings
    )


def scene_effects(
    gaussians: Gaussians, *, findings: list[Finding] | None = None, overrides: Overrides = NOTHING_FORCED
) -> list[Effect]:
    """What the scene alone decides, which takes time: a second for some millions of splats."""
    colours = colour_reach(gaussians)
    effects = [
        *band_effects(gaussians, colours),
        own_degrees_effect(gaussians),
        antialiased_effect(gaussians),
        flat_effect(gaussians),
        centred_effect(gaussians),
        transparency_effect(gaussians, colours.brightest),
        hidden_light_effect(colours.brightest),
        *left_out_effects(gaussians, check(gaussians) if findings is None else findings),
        sorting_effect(gaussians),
    ]
    return with_overrides(effects, overrides)


def with_grade(
    effects: Sequence[Effect], gaussians: Gaussians, palette: Sequence[Adjustment]
) -> list[Effect]:
    """`scene_effects`, as they are where splats may have the colour maps of `palette`."""
    colours = colour_reach(gaussians).graded(palette)
    anew = [*band_effects(gaussians, colours), hidden_light_effect(colours.brightest)]
    anew += [replace(e, bound=colours.brightest) for e in effects if e.name == TRANSPARENCY and e.on]
    by_name = {effect.name: effect for effect in anew}
    return [replace(by_name.get(effect.name, effect), forced=effect.forced) for effect in effects]


def view_effects(
    gaussians: Gaussians,
    *,
    camera: Camera | None = None,
    previous: Camera | None = None,
    edits: SceneEdits | None = None,
    settings: RenderSettings | None = None,
) -> list[Effect]:
    """What changes from picture to picture."""
    return [
        lens_effect(camera),
        near_plane_effect(gaussians, settings),
        background_effect(settings),
        *edit_effects(gaussians, edits),
        redrawing_effect(camera, previous),
    ]


def with_overrides(effects: list[Effect], overrides: Overrides) -> list[Effect]:
    """The same effects with the user's word on those that take it."""
    return [
        replace(effect, forced=overrides.get(effect.name)) if effect.can_override else effect
        for effect in effects
    ]
