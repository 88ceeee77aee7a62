"""Knobs are declared once, and a renderer that does not have one says so."""

from __future__ import annotations

import pytest

from splatview.measure.knobs import KNOBS, Plan, apply_choices, knob
from splatview.scene import InputError, RenderSettings


def test_names_are_options_and_values_are_told_apart():
    assert len({k.name for k in KNOBS}) == len(KNOBS)
    for k in KNOBS:
        assert k.option == f"--{k.name}"
        assert len({value.text for value in k.values}) == len(k.values) >= 2
        assert k.renderers and k.changes


@pytest.mark.parametrize("k", KNOBS, ids=lambda k: k.name)
def test_the_values_of_a_knob_draw_by_different_plans(k):
    plans = [value.apply(Plan()) for value in k.values]
    assert all(a != b for i, a in enumerate(plans) for b in plans[:i])


def test_a_degree_is_at_most_what_the_scene_calls_for():
    called_for = Plan(settings=RenderSettings(sh_degree=1))
    assert knob("sh-degree").value("2").apply(called_for) == called_for
    assert knob("sh-degree").value("0").apply(called_for).settings.sh_degree == 0


def test_choices_add_up():
    plan = apply_choices(Plan(), {"sh-degree": "1", "resolution": "1/2"}, "cpu")
    assert (plan.settings.sh_degree, plan.resolution) == (1, 0.5)


@pytest.mark.parametrize(
    ("choices", "renderer", "words"),
    [
        ({"blend": "float32"}, "cpu", "--blend is not for --renderer cpu: quads"),
        ({"resolution": "1/3"}, "quads", "--resolution 1/3: choose from 1, 1/2, 1/4"),
        ({"speed": "fast"}, "quads", "no knob 'speed'"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(choices, renderer, words):
    with pytest.raises(InputError, match=r"^.+$") as caught:
        apply_choices(Plan(), choices, renderer)
    assert words in str(caught.value)
