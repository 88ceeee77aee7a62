"""The whole receipt: every effect, on or off, in a fixed order."""

from __future__ import annotations

from dataclasses import replace

from ..camera import Camera
from ..edits import SceneEdits
from ..gaussians import Gaussians
from ..health import Finding, check
from ..image_model import RenderSettings
from .edited import edit_effects
from .effect import Effect
from .light import (
    background_effect,
    brightest_colour,
    hidden_light_effect,
    left_out_effects,
    transparency_effect,
)
from .overriding import NOTHING_FORCED, Overrides
from .positions import centred_effect
from .sh_bands import band_effects, own_degrees_effect
from .shape import antialiased_effect, flat_effect
from .view import lens_effect, redrawing_effect, sorting_effect


def census(
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
    has forced on or off, by name; it is told, and changes nothing of what the census says. The rest is how
    the scene is looked at, as far as that is known: by which `camera` after which `previous` one, with which
    `edits` in force and which `settings`.
    """
    return scene_effects(gaussians, findings=findings, overrides=overrides) + view_effects(
        gaussians, camera=camera, previous=previous, edits=edits, settings=settings
    )


def scene_effects(
    gaussians: Gaussians, *, findings: list[Finding] | None = None, overrides: Overrides = NOTHING_FORCED
) -> list[Effect]:
    """What the scene alone decides, which takes time: a second for some millions of splats."""
    brightest = brightest_colour(gaussians)
    effects = [
        *band_effects(gaussians),
        own_degrees_effect(gaussians),
        antialiased_effect(gaussians),
        flat_effect(gaussians),
        centred_effect(gaussians),
        transparency_effect(gaussians, brightest),
        hidden_light_effect(gaussians, brightest),
        *left_out_effects(gaussians, check(gaussians) if findings is None else findings),
        sorting_effect(gaussians),
    ]
    return with_overrides(effects, overrides)


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
