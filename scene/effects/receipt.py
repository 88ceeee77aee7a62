"""The whole receipt: every effect, on or off, in a fixed order."""

from __future__ import annotations

from dataclasses import replace

from ..gaussians import Gaussians
from ..health import Finding, check
from .effect import Effect
from .opacity import left_out_effects, sorting_effect, transparency_effect
from .overriding import NOTHING_FORCED, Overrides
from .positions import centred_effect
from .sh_bands import band_effects, own_degrees_effect
from .shape import antialiased_effect, flat_effect


def census(
    gaussians: Gaussians, *, findings: list[Finding] | None = None, overrides: Overrides = NOTHING_FORCED
) -> list[Effect]:
    """All effects, in a fixed order; SH bands only as far as the file has them.

    `findings`: what `health.check` said of the scene, where that is known already. `overrides`: what the user
    has forced on or off, by name; it is told, and changes nothing of what the census says.
    """
    effects = [
        *band_effects(gaussians),
        own_degrees_effect(gaussians),
        antialiased_effect(gaussians),
        flat_effect(gaussians),
        centred_effect(gaussians),
        transparency_effect(gaussians),
        *left_out_effects(gaussians, check(gaussians) if findings is None else findings),
        sorting_effect(gaussians),
    ]
    return [
        replace(effect, forced=overrides.get(effect.name)) if effect.can_override else effect
        for effect in effects
    ]
