"""Which effects a scene calls for, with the evidence: nothing is computed that cannot be seen."""

from .effect import GREY_LEVEL, VISIBLE, Effect, Saving, grey_levels
from .overriding import Overrides, overridable, settings_for
from .receipt import census
from .sh_bands import sh_degrees, used_sh_degree
from .shape import antialiasing

__all__ = [
    "GREY_LEVEL",
    "VISIBLE",
    "Effect",
    "Overrides",
    "Saving",
    "antialiasing",
    "census",
    "grey_levels",
    "overridable",
    "settings_for",
    "sh_degrees",
    "used_sh_degree",
]
