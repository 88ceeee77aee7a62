"""From the census to settings, the user's word counting more."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from ..gaussians import Gaussians
from ..image_model import ImageModel, RenderSettings
from .light import early_stop_for
from .sh_bands import band_name, used_sh_degree
from .shape import ANTIALIASED, FLAT, antialiasing, is_flat

Overrides = Mapping[str, bool | None]
"""By the name of an effect: on, off, or as the census decides (None, or not named)."""

NOTHING_FORCED: Overrides = MappingProxyType({})


def settings_for(gaussians: Gaussians, overrides: Overrides = NOTHING_FORCED) -> RenderSettings:
    """The settings that the scene calls for: its image model, and SH as far as it can be seen.

    `overrides`: effects that the user forces on or off, by name; of an SH band that is off, those above are
    off too.

    Raises:
        ValueError: an effect that this scene has not, or that cannot be forced, is named.
    """
    forced = {name: word for name, word in overrides.items() if word is not None}
    possible = overridable(gaussians)
    for name in forced:
        if name not in possible:
            raise ValueError(f"{name!r} cannot be switched by hand, only {', '.join(possible)}")
    stored = gaussians.sh_degree
    used = used_sh_degree(gaussians)
    used = max([used, *(band for band in range(1, stored + 1) if forced.get(band_name(band)) is True)])
    used = min([used, *(band - 1 for band in range(1, stored + 1) if forced.get(band_name(band)) is False)])
    antialiased, blur, _ = antialiasing(gaussians.comments)
    flat = forced[FLAT] if FLAT in forced else is_flat(gaussians)
    model = ImageModel(blur=blur).with_footprint("disc" if flat else "ellipsoid")
    return RenderSettings(
        model=replace(model, antialiased=forced.get(ANTIALIASED, antialiased)),
        sh_degree=used if used < stored else None,
        early_stop=early_stop_for(gaussians),
    )


def overridable(gaussians: Gaussians) -> tuple[str, ...]:
    """Names of the effects that `settings_for` takes the user's word for."""
    return (*(band_name(band) for band in range(1, gaussians.sh_degree + 1)), ANTIALIASED, FLAT)
