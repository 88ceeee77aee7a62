"""From the scene analysis to settings, the user's word counting more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from splatview.scene.edits import Adjustment
from splatview.scene.effects.appearance import (
    ANTIALIASED,
    FLAT,
    antialiasing,
    early_stop_for,
    is_flat,
    quick_early_stop,
)
from splatview.scene.effects.effect import Effect
from splatview.scene.effects.sh_bands import band_name, used_sh_degree
from splatview.scene.gaussians import Gaussians, near_plane
from splatview.scene.image_model import NEAR, ImageModel, RenderSettings

Overrides = Mapping[str, bool | None]
"""By the name of an effect: on, off, or as the analysis decides (None, or not named)."""

NOTHING_FORCED: Overrides = MappingProxyType({})


def settings_for(
    gaussians: Gaussians, overrides: Overrides = NOTHING_FORCED, *, palette: Sequence[Adjustment] = ()
) -> RenderSettings:
    """The settings that the scene calls for: its image model, and SH as far as it can be seen.

    `overrides`: effects that the user forces on or off, by name; of an SH band that is off, those above are
    off too. `palette`: adjustments that splats may have.

    Raises:
        ValueError: an effect that this scene has not, or that cannot be forced, is named.
    """
    forced = {name: word for name, word in overrides.items() if word is not None}
    possible = overridable(gaussians)
    for name in forced:
        if name not in possible:
            raise ValueError(f"{name!r} cannot be switched by hand, only {', '.join(possible)}")
    stored = gaussians.sh_degree
    used = used_sh_degree(gaussians, palette)
    used = max([used, *(band for band in range(1, stored + 1) if forced.get(band_name(band)) is True)])
    used = min([used, *(band - 1 for band in range(1, stored + 1) if forced.get(band_name(band)) is False)])
    antialiased, blur, _ = antialiasing(gaussians.comments)
    flat = forced[FLAT] if FLAT in forced else is_flat(gaussians)
    model = ImageModel(near=near_plane(gaussians.comments), blur=blur).with_footprint(
        "disc" if flat else "ellipsoid"
    )
    return RenderSettings(
        model=replace(model, antialiased=forced.get(ANTIALIASED, antialiased)),
        sh_degree=used if used < stored else None,
        early_stop=early_stop_for(gaussians, palette),
    )


def all_in_sight(gaussians: Gaussians) -> RenderSettings:
    """Those of `settings_for` without a near plane of the file's: for what goes by views from anywhere, in
    which every splat counts, and for files of formats that cannot say where it is."""
    settings = settings_for(gaussians)
    return replace(settings, model=replace(settings.model, near=NEAR))


def quick_settings(gaussians: Gaussians) -> RenderSettings:
    """Settings that show the scene as those of `settings_for` do, found without looking at every splat's
    colour: all bands, and pixels that end no sooner."""
    antialiased, blur, _ = antialiasing(gaussians.comments)
    model = ImageModel(near=near_plane(gaussians.comments), blur=blur).with_footprint(
        "disc" if is_flat(gaussians) else "ellipsoid"
    )
    return RenderSettings(
        model=replace(model, antialiased=antialiased), early_stop=quick_early_stop(gaussians)
    )


def overridable(gaussians: Gaussians) -> tuple[str, ...]:
    """Names of the effects that `settings_for` takes the user's word for."""
    return (*(band_name(band) for band in range(1, gaussians.sh_degree + 1)), ANTIALIASED, FLAT)


def in_force(gaussians: Gaussians, settings: RenderSettings) -> dict[str, bool]:
    """Whether `settings` have each effect that can be forced (`overridable`), by its name."""
    degree = gaussians.sh_degree if settings.sh_degree is None else settings.sh_degree
    bands = {band_name(band): band <= degree for band in range(1, gaussians.sh_degree + 1)}
    others = {name: _has(name, settings) for name in overridable(gaussians) if name not in bands}
    return bands | others


def as_settings_have_them(
    effects: Sequence[Effect], gaussians: Gaussians, settings: RenderSettings
) -> list[Effect]:
    """`effects` of a report, with `forced` where `settings` have them otherwise."""
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


def followed(settings: RenderSettings, before: RenderSettings, after: RenderSettings) -> RenderSettings:
    """`settings` with everything that is as a scene called for `before` as it calls for `after`."""
    near = settings.model.near
    if settings.model == replace(before.model, near=near):
        near = after.model.near if near == before.model.near else near
        settings = replace(settings, model=replace(after.model, near=near))
    if settings.sh_degree == before.sh_degree:
        settings = replace(settings, sh_degree=after.sh_degree)
    if settings.early_stop == before.early_stop:
        settings = replace(settings, early_stop=after.early_stop)
    return settings
