"""Which effects a scene calls for, with the evidence: nothing is computed that cannot be seen."""

from .effect import GREY_LEVEL, VISIBLE, Effect, Saving, grey_levels
from .overriding import Overrides, overridable, settings_for
from .receipt import census, scene_effects, view_effects, with_overrides
from .sh_bands import used_sh_degree, visible_degrees
from .sh_storage import degree_in_use, own_degrees, sh_degrees
from .shape import antialiasing

__all__ = [
    "GREY_LEVEL",
    "VISIBLE",
    "Effect",
    "Overrides",
    "Saving",
    "antialiasing",
    "census",
    "degree_in_use",
    "grey_levels",
    "overridable",
    "own_degrees",
    "scene_effects",
    "settings_for",
    "sh_degrees",
    "used_sh_degree",
    "view_effects",
    "visible_degrees",
    "with_overrides",
]
