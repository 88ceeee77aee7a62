"""Which effects a scene calls for, with the evidence: nothing is computed that cannot be seen."""

from splatview.scene.effects.appearance import antialiasing
from splatview.scene.effects.effect import GREY_LEVEL, VISIBLE, Effect, Saving, grey_levels
from splatview.scene.effects.overrides import Overrides, overridable, settings_for
from splatview.scene.effects.report import effects_report, scene_effects, view_effects, with_overrides
from splatview.scene.effects.sh_bands import (
    degree_in_use,
    own_degrees,
    sh_degrees,
    used_sh_degree,
    visible_degrees,
)

__all__ = [
    "GREY_LEVEL",
    "VISIBLE",
    "Effect",
    "Overrides",
    "Saving",
    "antialiasing",
    "degree_in_use",
    "effects_report",
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
