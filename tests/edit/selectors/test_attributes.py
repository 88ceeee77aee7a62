"""Attributes of an edited scene are those of the scene that the edits make; ranges and histograms of them."""

from __future__ import annotations

import colorsys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from splatview.edit.selectors import AttributeRange
from splatview.edit.selectors.attributes import ATTRIBUTES, attribute_values, histogram, usual_span
from splatview.edit.tools import NoTools
from splatview.scene import look_at
from splatview.scene.edits import bake, shown
from splatview.scene.sh import SH_C0

GEOMETRIC = [name for name, attribute in ATTRIBUTES.items() if not attribute.renders]


@pytest.mark.parametrize("name", GEOMETRIC)
def test_edited_values_are_those_of_the_baked_scene(edit_helpers, edited, name):
    scene, edits = edit_helpers.make_scene(400, degree=2), edited.some(400)
    values = attribute_values(name, scene, edits, NoTools(), point=(0.1, 0.2, 0.3))
    assert values.dtype == np.float32
    assert values.shape == (400,)
    there = shown(scene, edits)
    baked = bake(scene, edits)
    expected = attribute_values(name, baked, edited.none(len(baked)), NoTools(), point=(0.1, 0.2, 0.3))
    difference = values[there] - expected
    if name == "hue":
        difference = (difference + 180) % 360 - 180
    relative = np.abs(difference / np.maximum(1, np.abs(expected)))
    # Of a colour that is nearly grey, rounding turns the hue.
    coloured = attribute_values("saturation", baked, edited.none(len(baked)), NoTools()) > 0.01
    assert (relative[coloured] if name == "hue" else relative).max() < 2e-5
    assert there.sum() > 100


def test_values_are_what_they_say(edit_helpers, edited):
    scene, none = edit_helpers.make_scene(50), edited.none(50)

    def values(name, **options):
        return attribute_values(name, scene, none, NoTools(), **options)

    sizes = np.sort(np.exp(scene.log_scales.astype(np.float64)), axis=1)
    rgb = 0.5 + SH_C0 * scene.sh[:, 0].astype(np.float64)
    hues = np.array([colorsys.rgb_to_hsv(*row) for row in np.clip(rgb, 0, 1)])
    expected = {
        "x": scene.means[:, 0],
        "y": scene.means[:, 1],
        "z": scene.means[:, 2],
        "distance": np.linalg.norm(scene.means.astype(np.float64), axis=1),
        "largest scale": sizes[:, 2],
        "smallest scale": sizes[:, 0],
        "volume": 4 / 3 * np.pi * sizes.prod(axis=1),
        "anisotropy": sizes[:, 2] / sizes[:, 0],
        "elongation": sizes[:, 2] / sizes[:, 1],
        "opacity": 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64))),
        "red": rgb[:, 0],
        "green": rgb[:, 1],
        "blue": rgb[:, 2],
        "luminance": rgb @ (0.2126, 0.7152, 0.0722),
        "hue": hues[:, 0] * 360,
        "saturation": hues[:, 1],
        "sh energy": np.sqrt((scene.sh[:, 1:].astype(np.float64) ** 2).sum(axis=(1, 2))),
    }
    assert set(expected) == set(GEOMETRIC)
    for name, numbers in expected.items():
        np.testing.assert_allclose(values(name), numbers, rtol=1e-4, atol=1e-5, err_msg=name)
    np.testing.assert_allclose(
        values("distance", point=(3, 4, 0)),
        np.linalg.norm(scene.means - np.array((3, 4, 0)), axis=1),
        rtol=1e-6,
    )


def test_contribution_is_measured_in_the_views_given(edit_helpers, edited, reference_tools):
    scene, edits = edit_helpers.make_scene(60), edited.none(60)
    cameras = (look_at((0, 0, -3), (0, 0, 0), width=24, height=18),)
    values = attribute_values("contribution", scene, edits, reference_tools, cameras=cameras)
    expected = reference_tools.contributions(scene, cameras, edits)
    np.testing.assert_allclose(values, expected, rtol=1e-6)
    mask = AttributeRange(attribute="contribution", high=0.5, cameras=cameras).mask(
        scene, edits, reference_tools
    )
    assert (mask == (expected.astype(np.float32) <= 0.5)).all()
    assert 0 < mask.sum() < 60


def test_an_unknown_attribute(edit_helpers, edited):
    with pytest.raises(ValueError, match="attribute must be one of x, y"):
        attribute_values("weight", edit_helpers.make_scene(1), edited.none(1), NoTools())


def test_ranges_hold_their_ends_and_no_nan(edit_helpers, edited):
    scene = edit_helpers.make_scene(5)
    logits = np.array([-np.inf, 0, np.inf, np.nan, 1], np.float32)
    scene, edits = replace(scene, opacity_logits=logits), edited.none(5)

    def chosen(**ends):
        return AttributeRange(attribute="opacity", **ends).mask(scene, edits, NoTools()).tolist()

    assert chosen(low=0.0, high=0.5) == [True, True, False, False, False]
    assert chosen(low=0.5) == [False, True, True, False, True]
    assert chosen(high=0.0) == [True, False, False, False, False]
    assert chosen() == [True, True, True, False, True]


numbers = st.floats(width=32)


@settings(max_examples=100, deadline=None)
@given(st.lists(numbers, max_size=60), st.integers(1, 20), st.booleans())
def test_every_value_is_in_one_bin_or_outside(values, bins, log):
    array = np.array(values, np.float32)
    found = histogram(array, bins=bins, log=log)
    usable = array[np.isfinite(array) & ((array > 0) | (not log))]
    assert found.counts.sum() == len(usable)
    assert found.outside == len(array) - len(usable)
    assert len(found.counts) == bins == len(found.edges) - 1
    if len(usable):
        assert found.edges[0] == usable.min()
        assert found.edges[-1] == usable.max()


def test_bins_are_numpys(rng):
    values = rng.normal(size=5000).astype(np.float32)
    mask = rng.uniform(size=5000) < 0.5
    found = histogram(values, mask, bins=40, span=(-1.0, 2.0))
    counts, edges = np.histogram(values[mask], bins=40, range=(-1.0, 2.0))
    assert np.abs(found.counts - counts).sum() <= 4  # values beside an edge, rounded otherwise
    np.testing.assert_allclose(found.edges, edges)
    assert found.outside == mask.sum() - counts.sum()
    spread = np.exp(values * 3)
    found = histogram(spread, bins=40, log=True)
    counts, _ = np.histogram(np.log(spread.astype(np.float64)), bins=40)
    assert np.abs(found.counts - counts).sum() <= 4


def test_bad_bins():
    with pytest.raises(ValueError, match="bins"):
        histogram(np.zeros(3, np.float32), bins=0)
    for span in ((2.0, 1.0), (np.nan, 1.0), (0.0, np.inf)):
        with pytest.raises(ValueError, match="span"):
            histogram(np.zeros(3, np.float32), span=span)
    with pytest.raises(ValueError, match="span"):
        histogram(np.ones(3, np.float32), span=(0.0, 1.0), log=True)


def test_the_usual_span_leaves_out_what_is_far_off(rng):
    values = rng.normal(size=10_000).astype(np.float32)
    values[:3] = 1e9, np.nan, np.inf
    low, high = usual_span(values)
    assert -5 < low < -2
    assert 2 < high < 5
    assert usual_span(np.array([np.nan], np.float32)) == (0.0, 1.0)
