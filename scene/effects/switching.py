"""Effects and settings: which effects settings have on, and the same settings with one the other way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..gaussians import Gaussians
from ..image_model import RenderSettings
from .effect import Effect
from .overriding import overridable, settings_for
from .sh_bands import band_name
from .shape import ANTIALIASED, FLAT


def in_force(gaussians: Gaussians, settings: RenderSettings) -> dict[str, bool]:
    """Whether `settings` have each effect that can be forced (`overridable`), by its name."""
    degree = gaussians.sh_degree if settings.sh_degree is None else settings.sh_degree
    bands = {band_name(band): band <= degree for band in range(1, gaussians.sh_degree + 1)}
    others = {name: _has(name, settings) for name in overridable(gaussians) if name not in bands}
    return bands | others


def as_settings_have_them(
    effects: Sequence[Effect], gaussians: Gaussians, settings: RenderSettings
) -> list[Effect]:
    """`effects` of a census, with `forced` where `settings` have them otherwise."""
    now = in_force(gaussians, settings)
    return [
        replace(effect, forced=now[effect.name])
        if effect.can_override and now.get(effect.name, effect.on) != effect.on
        else effect
        for effect in effects
    ]


def switched(gaussians: Gaussians, settings: RenderSettings, name: str, on: bool) -> RenderSettings:
    """`settings` with the effect called `name` on or off. An SH band brings those below it, and takes those
    above it along; everything else stays as it is.

    Raises:
        ValueError: there is no such effect that can be switched.
    """
    wanted = in_force(gaussians, settings) | {name: on}
    if on:
        for band in range(1, gaussians.sh_degree + 1):
            if name == band_name(band):
                wanted.update({band_name(lower): True for lower in range(1, band)})
    forced = settings_for(gaussians, wanted)
    model = settings.model.with_footprint(forced.model.footprint)
    model = replace(model, antialiased=forced.model.antialiased)
    return replace(settings, model=model, sh_degree=forced.sh_degree)


def _has(name: str, settings: RenderSettings) -> bool:
    model = settings.model
    return {ANTIALIASED: model.antialiased, FLAT: model.footprint == "disc"}[name]
