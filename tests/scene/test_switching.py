"""Effects as settings have them: every switch does what it says, and can be taken back."""

from __future__ import annotations

from dataclasses import replace

import pytest

from splatview.scene import RenderSettings
from splatview.scene.effects.overrides import (
    as_settings_have_them,
    in_force,
    overridable,
    settings_for,
    switched,
)
from splatview.scene.effects.report import scene_effects
from splatview.scene.image_model import BLUR, DISC_BLUR


@pytest.fixture
def gaussians(random_gaussians):
    return random_gaussians(50)


def test_what_the_scene_calls_for_is_not_forced(gaussians) -> None:
    effects = scene_effects(gaussians)
    assert as_settings_have_them(effects, gaussians, settings_for(gaussians)) == effects
    now = in_force(gaussians, settings_for(gaussians))
    assert now == {effect.name: effect.on for effect in effects if effect.can_override}


@pytest.mark.parametrize(
    "name", ["SH band 1", "SH band 2", "SH band 3", "antialiased opacity", "flat 2D splats"]
)
def test_each_switch_changes_what_it_names_and_comes_back(gaussians, name) -> None:
    start = replace(settings_for(gaussians), background=(0.1, 0.2, 0.3), early_stop=0.25, blend="float32")
    now = in_force(gaussians, start)
    other = switched(gaussians, start, name, not now[name])
    assert in_force(gaussians, other)[name] is not now[name]
    forced = [
        e.name
        for e in as_settings_have_them(scene_effects(gaussians), gaussians, other)
        if e.forced is not None
    ]
    assert name in forced and all(each.startswith("SH band") for each in forced if each != name)
    assert (other.background, other.early_stop, other.blend) == (start.background, 0.25, "float32")
    assert in_force(gaussians, switched(gaussians, other, name, now[name]))[name] is now[name]
    assert set(now) == set(overridable(gaussians))


def test_bands_come_with_those_below_and_go_with_those_above(gaussians) -> None:
    none = switched(gaussians, settings_for(gaussians), "SH band 1", False)
    assert none.sh_degree == 0
    assert switched(gaussians, none, "SH band 2", True).sh_degree == 2
    assert switched(gaussians, none, "SH band 3", True).sh_degree is None, "all that is stored"


def test_discs_bring_the_blur_of_their_kind(gaussians) -> None:
    discs = switched(gaussians, settings_for(gaussians), "flat 2D splats", True)
    assert discs.model.footprint == "disc" and discs.model.blur == DISC_BLUR
    assert switched(gaussians, discs, "flat 2D splats", False).model.blur == BLUR


def test_what_cannot_be_switched_is_refused(gaussians) -> None:
    with pytest.raises(ValueError, match="cannot be switched by hand"):
        switched(gaussians, RenderSettings(), "sorting", False)
